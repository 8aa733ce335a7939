"""Traffic of a given density and mix: a road that is full at t = 0 and stays so.

The result is an ordinary SUMO route file, to be loaded after the file that declares vehicle types and routes.
Vehicles are on the main line from the first instant, since flows alone saturate at 13 to 16 vehicles/km/lane
and need minutes; flows at the entries then replace what leaves.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.errors import UserError
from emran_sumo.units import Unit
from emran_sumo.world.network import Piece, main_lanes
from emran_sumo.world.routes import Departure, VehicleType, read, route_edges, vehicle_types

_JITTER = 0.5  # free gaps vary by this share of their mean
_EXIT_ROOM = 300.0  # a vehicle that exits has at least this far per lane to cross [m]
_STEP = 0.1  # reaction time beyond tau that keeps the first steps free of hard braking [s]


class TrafficParams(NamedTuple):
    """Density and mix of the traffic around the egos.

    density: on the main line; share_exit: of its vehicles that leave by `exit`; share_enter: vehicles that
    come by `enter`, relative to those of the main line; gap_ego: free road before and behind an ego at t = 0,
    in its lane; type: a vType or vTypeDistribution; through, exit, enter: route ids.
    """

    density: Annotated[float, Field(ge=0.0, le=80.0), Unit("vehicles/km/lane")] = 15.0
    share_exit: Annotated[float, Field(ge=0.0, le=0.5), Unit("")] = 0.05
    share_enter: Annotated[float, Field(ge=0.0, le=0.5), Unit("")] = 0.05
    gap_ego: Annotated[float, Field(ge=0.0, le=500.0), Unit("m")] = 30.0
    type: Annotated[str, Field(min_length=1)] = "traffic"
    through: Annotated[str, Field(min_length=1)] = "through"
    exit: Annotated[str, Field(min_length=1)] = "exit"
    enter: Annotated[str, Field(min_length=1)] = "enter"


class Placed(NamedTuple):
    """A vehicle of the fill; `front` is its arc length along the chain [m]."""

    type: VehicleType
    front: float
    speed: float
    speed_factor: float


def write_demand(
    file: Path,
    network_file: Path,
    route_files: Sequence[Path],
    params: TrafficParams,
    speed_limit: float,
    seed: int,
    ego_departures: Sequence[Departure] = (),
) -> int:
    """Write a SUMO route file that fills the main line at t = 0 and feeds its entries.

    Args:
        file: route file to write; list it after `route_files` in SUMO's --route-files.
        network_file: SUMO network, plain or .gz.
        route_files: files that declare the types and routes which `params` names.
        params: TrafficParams.
        speed_limit: that holds on the main line when the simulation starts [m/s].
        seed: of positions, types and speed factors; what the flows draw depends on SUMO's own seed.
        ego_departures: places to keep free, see `routes.departures`.

    Returns:
        Number of vehicles placed at t = 0.

    Raises:
        ValueError: a type or route is not declared, or the vehicles do not fit on the road.
    """
    root = ET.Element("routes")
    count = 0
    if params.density > 0.0:
        declared = read(route_files)
        types = vehicle_types(declared, params.type)
        through = route_edges(declared, params.through)
        leave = route_edges(declared, params.exit) if params.share_exit > 0.0 else []
        if params.share_enter > 0.0:
            route_edges(declared, params.enter)
        rng = np.random.default_rng(seed)
        try:
            chains = main_lanes(network_file, through)
        except ValueError as error:
            files = ", ".join(map(str, route_files))
            raise UserError(f'{files}: route "{params.through}": {error} of {network_file}.') from None
        for index, chain in enumerate(chains):
            placed = _fill(chain, _for_lane(types, index, len(chains)), params.density, speed_limit, rng)
            for vehicle in placed:
                route = _choose_route(vehicle, chain, index, leave, params, rng)
                if not _in_the_way(vehicle, chain, ego_departures, params.gap_ego):
                    _append_vehicle(root, f"fill.{count}", vehicle, chain, route)
                    count += 1
        _append_flows(root, types, params, speed_limit, len(chains))
    ET.indent(root)
    Path(file).write_text(ET.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    return count


def _fill(
    chain: tuple[Piece, ...],
    types: list[VehicleType],
    density: float,
    speed_limit: float,
    rng: np.random.Generator,
) -> list[Placed]:
    """Vehicles on one chain from its end to its start: jittered gaps, speeds that the gaps allow."""
    total = chain[-1].start + chain[-1].length
    n = int(density * total / 1000.0 + rng.random())
    weights = np.array([t.probability for t in types])
    drawn = [types[k] for k in rng.choice(len(types), size=n, p=weights / weights.sum())]
    free = total - sum(t.length + t.min_gap for t in drawn)
    if free <= 0.0:
        raise ValueError(f"{density:g} vehicles/km/lane of these lengths do not fit on the road")
    gaps = 1.0 + _JITTER * rng.uniform(-1.0, 1.0, n)
    gaps *= free / max(gaps.sum(), 1.0)
    placed: list[Placed] = []
    back, speed_ahead = total + 0.5 * free / max(n, 1), np.inf  # the first gap lies half beyond the end
    for vehicle, gap in zip(drawn, gaps, strict=True):
        factor = _draw_factor(vehicle.speed_factor, rng)
        front = _on_a_lane(chain, min(back - gap - vehicle.min_gap, total))
        if front < vehicle.length:
            break
        desired = min(factor * speed_limit, vehicle.max_speed, free / n / vehicle.tau)
        speed = min(desired, _safe_speed(vehicle, back - front - vehicle.min_gap, speed_ahead))
        placed.append(Placed(vehicle, front, speed, factor))
        back, speed_ahead = front - vehicle.length, speed
    return placed


def _safe_speed(vehicle: VehicleType, gap: float, speed_ahead: float) -> float:
    """Krauss: the speed from which braking after the reaction time ends behind an equally braking leader."""
    b, t = vehicle.decel, vehicle.tau + _STEP
    return float(np.sqrt((b * t) ** 2 + speed_ahead**2 + 2.0 * b * gap) - b * t)


def _on_a_lane(chain: tuple[Piece, ...], front: float) -> float:
    """The same place, or the end of the lane before it if that is inside a junction: nobody departs there."""
    piece = _piece(chain, front)
    return min(front, piece.start + piece.length - 0.1)


def _piece(chain: tuple[Piece, ...], front: float) -> Piece:
    return next((p for p in reversed(chain) if p.start <= front), chain[0])


def _choose_route(
    vehicle: Placed,
    chain: tuple[Piece, ...],
    index: int,
    leave: list[str],
    params: TrafficParams,
    rng: np.random.Generator,
) -> str:
    """The exit for a share of those who can still reach it from their lane in peace."""
    exits = rng.random() < params.share_exit  # always drawn: the same seed then places the same traffic
    common = [p for p in chain if p.edge in leave]
    if not exits or not common:
        return params.through
    room = common[-1].start - vehicle.front
    return params.exit if room >= _EXIT_ROOM * (index + 1) else params.through


def _in_the_way(vehicle: Placed, chain: tuple[Piece, ...], egos: Sequence[Departure], gap: float) -> bool:
    """Whether a vehicle would be within `gap` or the unsafe distance of an ego in the same lane."""
    for ego in egos:
        start = next((p.start for p in chain if (p.edge, p.lane) == (ego.edge, ego.lane)), None)
        if start is None:
            continue
        ahead = vehicle.front - vehicle.type.length - (start + ego.position)
        behind = start + ego.position - ego.length - vehicle.front
        if ahead < max(gap, _stopping_gap(ego.speed, vehicle.speed)) and behind < max(
            gap, _stopping_gap(vehicle.speed, ego.speed)
        ):
            return True
    return False


def _stopping_gap(speed: float, speed_ahead: float) -> float:
    """Bumper distance [m] that SUMO wants for inserting a passenger car, with some margin."""
    return 5.0 + 1.2 * speed + max(speed**2 - speed_ahead**2, 0.0) / (2.0 * 4.0)


def _append_vehicle(root: ET.Element, name: str, v: Placed, chain: tuple[Piece, ...], route: str) -> None:
    piece = _piece(chain, v.front)
    attributes = {
        "id": name,
        "type": v.type.id,
        "route": route,
        "depart": "0",
        "departEdge": str(chain.index(piece)),
        "departLane": str(piece.lane),
        "departPos": f"{v.front - piece.start:.2f}",
        "departSpeed": f"{v.speed:.2f}",
        "speedFactor": f"{v.speed_factor:.4f}",
        "insertionChecks": "none",
    }
    ET.SubElement(root, "vehicle", attributes)


def _append_flows(
    root: ET.Element, types: list[VehicleType], params: TrafficParams, speed_limit: float, lanes: int
) -> None:
    """Random arrivals, density * speed * lanes, split among routes and types; heavy ones on the right."""
    rate = params.density / 1000.0 * mean_speed(types, params.density, speed_limit) * lanes  # [vehicles/s]
    rate /= sum(t.probability for t in types)
    routes = (
        (params.through, 1.0 - params.share_exit),
        (params.exit, params.share_exit),
        (params.enter, params.share_enter),
    )
    for route, share in routes:
        for t in types:
            if (arrivals := rate * share * t.probability) > 0.0:
                flow = {
                    "id": f"flow.{route}.{t.id}",
                    "type": t.id,
                    "route": route,
                    "begin": "0",
                    "end": "86400",
                }
                flow |= {"period": f"exp({arrivals:.9f})", "departLane": "first" if t.heavy else "best"}
                ET.SubElement(root, "flow", flow | {"departPos": "last", "departSpeed": "max"})


def mean_speed(types: list[VehicleType], density: float, speed_limit: float) -> float:
    """Mean speed [m/s] of a homogeneous stream: what drivers want, or what the mean gap over tau allows."""
    p = np.array([t.probability for t in types])
    spacing = 1000.0 / density
    allowed = (spacing - p @ [t.length + t.min_gap for t in types] / p.sum()) / (p @ [t.tau for t in types] / p.sum())
    wanted = p @ [min(t.speed_factor[0] * speed_limit, t.max_speed) for t in types] / p.sum()
    return float(max(min(allowed, wanted), 0.0))


def _for_lane(types: list[VehicleType], index: int, lanes: int) -> list[VehicleType]:
    """The mix of one lane: heavy vehicles keep right, twice as often in the first lane as in the second."""
    share = sum(t.probability for t in types if t.heavy) / sum(t.probability for t in types)
    weights = np.array([2.0, 1.0, *np.zeros(lanes)])[:lanes]
    here = min(share * lanes * weights[index] / weights.sum(), 1.0)
    if share in (0.0, 1.0):
        return types
    scale = {True: here / share, False: (1.0 - here) / (1.0 - share)}
    return [t._replace(probability=t.probability * scale[t.heavy]) for t in types]


def _draw_factor(distribution: tuple[float, float, float, float], rng: np.random.Generator) -> float:
    mean, deviation, low, high = distribution
    for _ in range(100):
        if low <= (value := rng.normal(mean, deviation)) <= high:
            return float(value)
    return float(np.clip(mean, low, high))
