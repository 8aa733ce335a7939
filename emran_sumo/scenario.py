"""A scenario: TOML file + controller + command line -> one validated record, or one sentence about what is wrong."""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from annotated_types import Ge, Gt, Le, Lt, MinLen
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from emran_sumo import locate, shipped
from emran_sumo.control.cruise import CruiseParams
from emran_sumo.control.steering import SteeringParams, compiled_view
from emran_sumo.controllers import CONTROLLERS, DEFAULT, is_own, preset
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.loop import DELAYS, Clock, ControlParams
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.plant.sensors import SensorParams
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.units import Unit
from emran_sumo.world.demand import TrafficParams
from emran_sumo.world.track import TrackParams

FILE = "scenario.toml"
CONFIG = ".sumocfg"


class RateParams(NamedTuple):
    """Steps of the clocks; each is a whole multiple of the one below it. command_delay: whole control steps.

    driver_step: how often the drivers of the other vehicles decide (SUMO's action step length).
    """

    driver_step: Annotated[float, Field(ge=0.01, le=2), Unit("s")] = 0.2
    sumo_step: Annotated[float, Field(ge=0.01, le=1), Unit("s")] = 0.05
    control_step: Annotated[float, Field(ge=0.001, le=0.1), Unit("s")] = 0.01
    plant_step: Annotated[float, Field(ge=0.0001, le=0.002), Unit("s")] = 0.001
    command_delay: Annotated[float, Field(ge=0, le=0.15), Unit("s")] = 0.0


class RoadParams(NamedTuple):
    """friction of the road; speed_limit of all lanes outside ramps, 0 to keep the network's own.

    curve_accel: lateral acceleration up to which bends are driven, at most half of what friction gives; curve_decel:
    deceleration before them.
    """

    friction: Annotated[float, Field(ge=0.05, le=2), Unit("-")] = 1.0
    speed_limit: Annotated[float, Field(ge=0, le=70), Unit("m/s")] = 0.0
    curve_accel: Annotated[float, Field(gt=0, le=12), Unit("m/s^2")] = 3.0
    curve_decel: Annotated[float, Field(gt=0, le=9), Unit("m/s^2")] = 2.0


class EgoParams(NamedTuple):
    """Which vehicles are driven, where `ego` names none.

    ids; or type: all of this vType; or penetration: this share of all passenger cars as they depart, drawn by the seed;
    or none of these: the first car that travels far enough. lane_changes: SUMO's wishes to change lanes are followed.
    """

    ids: tuple[str, ...] = ()
    type: str = ""
    penetration: Annotated[float, Field(ge=0, le=1), Unit("-")] = 0.0
    lane_changes: Annotated[bool, Unit("on/off")] = True


class Scenario(NamedTuple):
    """Everything a run needs; sections are records of their own."""

    title: str = ""
    world: Literal["sumo", "track"] = "sumo"
    network: str = ""
    routes: tuple[str, ...] = ()
    additional: tuple[str, ...] = ()
    config: str = ""
    ego: str = "ego"
    controller: str = DEFAULT
    seed: Annotated[int, Field(ge=0, le=2**31 - 1), Unit("-")] = 1
    duration: Annotated[float, Field(gt=0, le=86_400), Unit("s")] = 60.0
    warm_up: Annotated[float, Field(ge=0, le=3600), Unit("s")] = 20.0
    egos: EgoParams = EgoParams()
    rates: RateParams = RateParams()
    road: RoadParams = RoadParams()
    traffic: TrafficParams = TrafficParams()
    track: TrackParams = TrackParams()
    vehicle: VehicleParams = VehicleParams()
    longitudinal: CruiseParams = CruiseParams()
    lateral: SteeringParams = SteeringParams()
    sensors: SensorParams = SensorParams()
    disturbance: DisturbanceParams = DisturbanceParams()

    @property
    def control(self) -> ControlParams:
        """Parameters of both halves of the controller, as kernels take them."""
        return ControlParams(self.longitudinal, compiled_view(self.lateral), self.sensors)

    def clock(self, tick: int = 0) -> Clock:
        """Clock at control period `tick`."""
        r = self.rates
        delay = round(r.command_delay / r.control_step)
        return Clock(tick, r.control_step, round(r.control_step / r.plant_step), r.plant_step, delay)


class Located(NamedTuple):
    """A validated scenario with the folder its files are relative to and its name.

    controller: the user's own class, factory or object, where it was given as such; command: that drives it.
    """

    name: str
    folder: Path
    values: Scenario
    controller: Any = None
    command: str = ""


_ADAPTER = TypeAdapter(Scenario, config=ConfigDict(allow_inf_nan=False))


def find(name: str) -> Path:
    """The TOML file of a shipped scenario, of a folder that holds one, or the file itself."""
    known = shipped.scenarios()
    given = Path(name)
    if name in known and not (given / FILE).is_file():  # a folder of that name may hold anything, such as old runs
        return locate.folder("scenarios") / name / FILE
    if name and (given.suffix in (".toml", CONFIG) or given.is_dir()):
        file = given / FILE if given.is_dir() else given
        if not file.is_file():
            raise UserError(f"{file}: no such scenario file.")
        return file
    raise UserError(f'Unknown scenario "{name}". {nearest_name(name, list(known))}')


def load(name: str, overrides: dict[str, tuple[object, str]] | None = None) -> Located:
    """Read, merge and validate a scenario.

    Args:
        name: shipped scenario, folder or TOML file.
        overrides: dotted key -> (value, where it came from, e.g. "--set"); they win over the file, which wins over
            the values of the controller.

    Raises:
        UserError: one sentence with file, key, what was found and what is accepted.
    """
    file = find(name)
    given = _of_config(file) if file.suffix == CONFIG else values_in(file)
    origin = dict.fromkeys(given, str(file))
    for name_given, (value, where) in (overrides or {}).items():
        changed = flat({name_given: value})
        given |= changed
        origin |= dict.fromkeys(changed, where)
    scenario = checked(given, origin, str(file))
    if scenario.world == "sumo" and not scenario.config and not (scenario.network and scenario.routes):
        missing = "network" if not scenario.network else "routes"
        raise UserError(f'{file}: key "{missing}" is missing; it names the file of the {missing}.')
    return Located(file.parent.name if file.name == FILE else file.stem, file.parent, scenario)


def values_in(file: Path) -> dict[str, Any]:
    """Dotted keys of a TOML file with their values; lists as tuples.

    Raises:
        UserError: the file cannot be read or is not TOML.
    """
    return flat(_read(file))


def _of_config(file: Path) -> dict[str, Any]:
    """A SUMO configuration as a scenario: its own traffic, its first car that travels far enough, to its arrival."""
    return {
        "title": file.name,
        "config": file.name,
        "ego": "",
        "traffic.density": 0.0,
        "warm_up": 0.0,
        "duration": 3600.0,
        "rates.driver_step": 0.05,
    }


def checked(given: dict[str, Any], origin: dict[str, str], file: str) -> Scenario:
    """Scenario of dotted keys over the values of their controller.

    Args:
        given: dotted keys with their values.
        origin: where each of them came from, for the message.
        file: where to look for what is in none of them.

    Raises:
        UserError: one sentence with file, key, what was found and what is accepted.
    """
    controller = given.get("controller", DEFAULT)
    if not isinstance(controller, str) or not (controller in CONTROLLERS or is_own(controller)):
        hint = nearest_name(str(controller), list(CONTROLLERS))
        own = " Accepted is one of these, or your own: module:factory." if str(controller).endswith(".py") else ""
        raise UserError(f"{origin['controller']}: controller: found {_shown(controller)}. {hint}{own}")
    known = dict.fromkeys(_leaves(Scenario))
    for key in given:
        if key not in known:
            raise UserError(f"{origin[key]}: {_unknown(key, given[key], list(known))}")
    try:
        scenario = build(given)
    except ValidationError as error:
        raise UserError(_sentence(error, origin, file)) from None
    _check_rates(scenario.rates, origin, file)
    return scenario


def build(given: dict[str, Any]) -> Scenario:
    """Scenario of dotted keys over the values of the controller that they name, over the defaults.

    Raises:
        pydantic.ValidationError: a value is not accepted.
    """
    values = _tree({**flat(to_dict(Scenario())), **preset(given.get("controller", DEFAULT)), **given})
    return _ADAPTER.validate_python(values, strict=True)


def to_dict(record: Any) -> dict[str, Any]:
    """Nested dict of a record of records."""
    return {key: to_dict(value) if hasattr(value, "_asdict") else value for key, value in record._asdict().items()}


def chosen_egos(ids: list[str] | None, kind: str | None, share: str | None) -> dict[str, tuple[Any, str]]:
    """The command line's choice of egos as overrides of a scenario.

    Raises:
        UserError: more than one way to choose, or a share that is none.
    """
    given = [name for name, value in (("--ego", ids), ("--ego-type", kind), ("--penetration", share)) if value]
    if len(given) > 1:
        raise UserError(f"{given[0]} and {given[1]}: accepted is one way to choose the egos.")
    nobody = {"ego": ("", given[0])} if given else {}
    if ids:
        return nobody | {"egos.ids": (tuple(ids), "--ego")}
    if kind:
        return nobody | {"egos.type": (kind, "--ego-type")}
    if share:
        try:
            value = float(share.removesuffix("%")) / (100.0 if share.endswith("%") else 1.0)
        except ValueError:
            value = math.nan
        if not 0.0 < value <= 1.0:
            raise UserError(f'--penetration: found "{share}"; accepted is a share above 0 to 1, or above 0% to 100%.')
        return nobody | {"egos.penetration": (value, "--penetration")}
    return {}


def parse_value(text: str) -> object:
    """A value as TOML would read it; bare words are strings."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _read(file: Path) -> dict[str, Any]:
    try:
        with file.open("rb") as stream:
            return tomllib.load(stream)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{file}: not valid TOML: {error}.") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{file}: cannot be read: {error}.") from None


def flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted key -> value of nested tables; lists become tuples."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            found.update(flat(value, f"{prefix}{key}."))
        else:
            found[prefix + key] = tuple(value) if isinstance(value, list) else value
    return found


def _tree(dotted: dict[str, Any]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in dotted.items():
        *sections, leaf = key.split(".")
        node = tree
        for section in sections:
            node = node.setdefault(section, {})
        node[leaf] = value
    return tree


def _leaves(record: type, prefix: str = "") -> dict[str, Any]:
    """Dotted key -> annotation of every scalar key of a record type."""
    found: dict[str, Any] = {}
    for key, annotation in get_type_hints(record, include_extras=True).items():
        if hasattr(annotation, "_fields"):
            found.update(_leaves(annotation, f"{prefix}{key}."))
        else:
            found[prefix + key] = annotation
    return found


def _unknown(key: str, value: object, known: list[str]) -> str:
    """Sentence about a key that is none: the name of a section, or misspelled."""
    inside = [name.removeprefix(f"{key}.") for name in known if name.startswith(f"{key}.")]
    if inside:
        return f"{key}: found {_shown(value)}; accepted is a table of keys: {_firsts(inside)}."
    section = key.rpartition(".")[0]
    beside = [name.removeprefix(f"{section}.") for name in known if not section or name.startswith(f"{section}.")]
    return f'unknown key "{key}". {nearest_name(key, known, _firsts(beside or known))}'


def _firsts(names: list[str]) -> str:
    """The first parts of dotted keys, each once."""
    return ", ".join(dict.fromkeys(name.partition(".")[0] for name in names))


def _shown(value: object) -> str:
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown, value))}]"
    return str(value).lower() if isinstance(value, bool) else str(value)


def keys() -> dict[str, str]:
    """Every dotted key with what it accepts."""
    return {key: accepted(annotation) for key, annotation in _leaves(Scenario).items()}


def accepted(annotation: Any) -> str:
    """What an annotated field accepts, in words: kind, range and unit."""
    kind, *notes = get_args(annotation) if get_origin(annotation) is Annotated else (annotation,)
    words = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
    text = words.get(kind, "a list of numbers" if kind == tuple[float, ...] else "a list of texts")
    if get_origin(kind) is Literal:
        text = " or ".join(get_args(kind))
    unit = next((note.symbol for note in notes if isinstance(note, Unit)), "")
    low, high = None, None
    for note in notes:
        for bound in getattr(note, "metadata", [note]):
            if isinstance(bound, Ge | Gt):
                low = f"from {bound.ge:.10g}" if isinstance(bound, Ge) else f"above {bound.gt:.10g}"
            if isinstance(bound, Le | Lt):
                high = f"to {bound.le:.10g}" if isinstance(bound, Le) else f"below {bound.lt:.10g}"
            if isinstance(bound, MinLen):
                low = "that is not empty"
    text = " ".join(part for part in (text, low, high) if part)
    return f"{text} {unit}" if unit not in ("", "-", "on/off") else text


def _sentence(error: ValidationError, origin: dict[str, str], file: str) -> str:
    first = error.errors()[0]
    key = ".".join(part for part in first["loc"] if isinstance(part, str))  # without the place in a list
    wanted = accepted(_leaves(Scenario)[key])
    return f"{origin.get(key, file)}: {key}: found {_shown(first['input'])}; accepted is {wanted}."


def _check_rates(rates: RateParams, origin: dict[str, str], file: str) -> None:
    for key, slow, fast_key, fast in (
        ("rates.driver_step", rates.driver_step, "rates.sumo_step", rates.sumo_step),
        ("rates.sumo_step", rates.sumo_step, "rates.control_step", rates.control_step),
        ("rates.control_step", rates.control_step, "rates.plant_step", rates.plant_step),
    ):
        ratio = slow / fast
        if ratio < 1 or not math.isclose(ratio, round(ratio), rel_tol=1e-9):
            where = origin.get(key, origin.get(fast_key, file))
            raise UserError(
                f"{where}: {key}: found {slow:g} s; accepted is a whole multiple of {fast_key} ({fast:g} s)."
            )
    periods = rates.command_delay / rates.control_step
    if not math.isclose(periods, round(periods), abs_tol=1e-9) or round(periods) >= DELAYS:
        key = "rates.command_delay"
        raise UserError(
            f"{origin.get(key, file)}: {key}: found {rates.command_delay:g} s; accepted is a whole multiple of "
            f"rates.control_step ({rates.control_step:g} s), at most {DELAYS - 1} of them."
        )
