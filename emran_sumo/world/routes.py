"""What SUMO route files declare: vehicle types, routes, and where a vehicle of the scenario appears."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from emran_sumo.errors import UserError, nearest_name
from emran_sumo.world.config import seconds
from emran_sumo.world.files import content

# params of a vehicle that declare its double lane change
DOUBLE_LANE_CHANGE = tuple(f"double_lane_change.{key}" for key in ("start", "length_out", "length_back", "direction"))
_HEAVY = frozenset({"truck", "trailer", "bus", "coach"})


class VehicleType(NamedTuple):
    """What the fill needs of a SUMO vType; `speed_factor` is (mean, deviation, lowest, highest)."""

    id: str
    probability: float
    length: float
    min_gap: float
    tau: float
    decel: float
    max_speed: float
    speed_factor: tuple[float, float, float, float]
    heavy: bool


class Departure(NamedTuple):
    """Where a vehicle of the scenario appears at t = 0: front bumper at `position` on a lane [m]."""

    edge: str
    lane: int
    position: float
    speed: float
    length: float


def check_ego(ego: str, route_files: Sequence[Path]) -> None:
    """Refuse an ego that none of the route files declares, or with a misspelled double lane change.

    Raises:
        UserError: with the nearest id.
    """
    found: list[str] = []
    for file in route_files:
        try:
            root = ET.parse(file).getroot()
        except ET.ParseError as error:
            raise UserError(f"{file}: not valid XML: {error}.") from None
        except OSError:
            raise UserError(f"{file}: no such route file.") from None
        vehicles = [element for element in root if element.tag in ("vehicle", "trip")]
        found += [element.get("id", "") for element in vehicles]
        for element in vehicles:
            if element.get("id") == ego:
                _check_params(ego, element)
    if ego not in found:
        names = ", ".join(str(file) for file in route_files)
        hint = nearest_name(ego, found) if found else "They declare no single vehicle."
        raise UserError(f'ego: found "{ego}", which is no vehicle of {names}. {hint}')


def why_missing(ego: str, files: Sequence[Path], begin: float, time: float) -> str:
    """Why a vehicle of a configuration is not on the road, as a sentence; "" where its files do not tell.

    Args:
        files: that may declare it; begin: of the configuration, time: until which it was waited for [s].
    """
    single: dict[str, str] = {}
    flows: list[str] = []
    for file in files:
        try:
            root = ET.fromstring(content(file))
        except (ET.ParseError, OSError, EOFError):
            return ""
        single |= {e.get("id", ""): e.get("depart", "") for e in root.iter() if e.tag in ("vehicle", "trip")}
        flows += [e.get("id", "") for e in root.iter("flow")]
    if ego not in single:
        if ego.rpartition(".")[0] in flows:
            return ""
        return f'ego: vehicle "{ego}" is declared in none of the files. {nearest_name(ego, [*single, *flows])}'
    try:
        depart = seconds(single[ego], files[0])
    except UserError:  # "triggered" and the like
        return ""
    if depart < begin:
        return (
            f'ego: vehicle "{ego}" departs at {depart:g} s, and SUMO leaves out who departs before the '
            f"configuration's begin of {begin:g} s; accepted is one that departs later."
        )
    return f'ego: vehicle "{ego}" departs after {time:g} s, at {depart:g} s.' if depart > time else ""


def _check_params(ego: str, element: ET.Element) -> None:
    """SUMO accepts any `<param>`; one meant for the double lane change must be one that is read."""
    for key in (param.get("key", "") for param in element.iter("param")):
        if key.startswith("double_lane_change.") and key not in DOUBLE_LANE_CHANGE:
            hint = nearest_name(key, list(DOUBLE_LANE_CHANGE))
            raise UserError(f'vehicle "{ego}": unknown param "{key}". {hint}')


def read(route_files: Sequence[Path]) -> list[ET.Element]:
    """Roots of the route files."""
    return [ET.parse(file).getroot() for file in route_files]


def departures(route_files: Sequence[Path], ids: Sequence[str], speed_limit: float) -> tuple[Departure, ...]:
    """Departures at t = 0 of the vehicles `ids`; those that come later need no free place and are left out.

    Raises:
        ValueError: a vehicle is missing, or its departLane or departPos is not a number.
    """
    declared = read(route_files)
    found = {v.get("id"): v for root in declared for v in root.iter("vehicle")}
    lengths = {t.get("id"): float(t.get("length", 5.0)) for root in declared for t in root.iter("vType")}
    result = []
    for name in ids:
        if name not in found:
            raise ValueError(f"vehicle {name!r} is in none of the route files")
        vehicle = found[name]
        if float(vehicle.get("depart", 0.0)) <= 0.0:
            length = lengths.get(vehicle.get("type"), 5.0)
            result.append(_departure(vehicle, declared, length, speed_limit))
    return tuple(result)


def _departure(vehicle: ET.Element, declared: list[ET.Element], length: float, speed_limit: float) -> Departure:
    inline = vehicle.find("route")
    edges = _edges(inline) if inline is not None else route_edges(declared, vehicle.get("route", ""))
    try:
        lane, position = int(vehicle.get("departLane", "")), float(vehicle.get("departPos", ""))
    except ValueError:
        raise ValueError(f"vehicle {vehicle.get('id')!r} needs numbers as departLane and departPos") from None
    try:
        speed = float(vehicle.get("departSpeed", 0.0))
    except ValueError:  # "max", "desired", ...
        speed = speed_limit
    begin = vehicle.get("departEdge", "0")
    if not begin.isdecimal() or int(begin) >= len(edges):
        many = f"0 to {len(edges) - 1}" if edges else "a route with edges"
        raise UserError(f'vehicle "{vehicle.get("id")}": departEdge: found "{begin}"; accepted is {many}.')
    return Departure(edges[int(begin)], lane, position, speed, length)


def vehicle_types(declared: list[ET.Element], name: str) -> list[VehicleType]:
    """Types of the vTypeDistribution `name`, or the one vType of that name.

    Raises:
        UserError: neither is declared, or an attribute is not a number.
    """
    for root in declared:
        for d in root.iter("vTypeDistribution"):
            if d.get("id") == name and len(d):
                return [_type(t) for t in d.iter("vType")]
        for t in root.iter("vType"):
            if t.get("id") == name:
                return [_type(t)]
    known = [t.get("id", "") for root in declared for t in (*root.iter("vTypeDistribution"), *root.iter("vType"))]
    raise UserError(f'traffic.type: found "{name}", which no route file declares. {nearest_name(name, known)}')


def _type(t: ET.Element) -> VehicleType:
    """Read a vType; what it leaves out takes SUMO's value for passenger cars."""
    get = t.get

    def number(key: str, default: float) -> float:
        try:
            return float(get(key, default))
        except ValueError:
            raise UserError(f'vType "{get("id")}": {key}: found "{get(key)}"; accepted is a number.') from None

    factor = get("speedFactor", "1.0")
    try:
        inside = factor[factor.index("(") + 1 : factor.index(")")].split(",") if "(" in factor else [factor]
        numbers = [float(x) for x in inside]
    except ValueError:
        raise UserError(
            f'vType "{get("id")}": speedFactor: found "{factor}"; accepted is a number or norm(c)(mean,deviation,...).'
        ) from None
    if len(numbers) < 2:
        numbers.append(number("speedDev", 0.1))
    mean, deviation, low, high = (numbers + [0.2, 2.0][len(numbers) - 2 :])[:4]
    return VehicleType(
        id=get("id", ""),
        probability=number("probability", 1.0),
        length=number("length", 5.0),
        min_gap=number("minGap", 2.5),
        tau=number("tau", 1.0),
        decel=number("decel", 4.5),
        max_speed=number("maxSpeed", 55.55),
        speed_factor=(mean, deviation, low, high),
        heavy=get("vClass", "passenger") in _HEAVY,
    )


def route_edges(declared: list[ET.Element], name: str) -> list[str]:
    """Edges of the route `name`.

    Raises:
        UserError: it is not declared.
    """
    for root in declared:
        for route in root.iter("route"):
            if route.get("id") == name:
                if not _edges(route):
                    raise UserError(f'route "{name}": edges: found none; accepted is one edge at least.')
                return _edges(route)
    known = [route.get("id", "") for root in declared for route in root.iter("route")]
    raise UserError(f'traffic: found the route "{name}", which no route file declares. {nearest_name(name, known)}')


def _edges(route: ET.Element) -> list[str]:
    return route.get("edges", "").split()
