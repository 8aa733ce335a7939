"""Cars as TOML files of `[vehicle]` keys: those that ship, one of your own, and what follows from their parameters."""

import math
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from emran_sumo import locate
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.plant.records import GRAVITY, VehicleParams
from emran_sumo.plant.tire import tire_forces
from emran_sumo.scenario import checked, values_in

GYRATION = (0.2, 0.45)  # yaw radius of gyration over the length, of anything that is called a car
FASTEST = 40.0  # m/s for which the plant is made
SLIP_ANGLES = np.radians(np.linspace(0.0, 25.0, 251))
SLIP_RATIOS = np.linspace(0.0, 0.6, 241)


class Figure(NamedTuple):
    """One figure that follows from the parameters."""

    name: str
    value: str


def shipped_vehicles() -> dict[str, str]:
    """Name and title of every shipped vehicle."""
    found = {}
    for file in sorted((locate.folder("scenarios") / "vehicles").glob("*.toml")):
        with file.open("rb") as stream:
            found[file.stem] = str(tomllib.load(stream).get("title", ""))
    return found


def vehicle_values(name: str) -> tuple[Path, dict[str, Any]]:
    """File and dotted `vehicle.*` keys of a shipped vehicle or of a TOML file.

    Raises:
        UserError: there is none, it is no TOML, or it has other keys.
    """
    file = Path(name)
    if file.suffix != ".toml":
        known = shipped_vehicles()
        if name not in known:
            raise UserError(f'Unknown vehicle "{name}". {nearest_name(name, list(known))} Or name a TOML file.')
        file = locate.folder("scenarios") / "vehicles" / f"{name}.toml"
    values = {key: value for key, value in values_in(file).items() if key != "title"}
    for key in values:
        if not key.startswith("vehicle."):
            raise UserError(f"{file}: {key}: found in a vehicle; accepted are keys of [vehicle] and title.")
    return file, values


def load_vehicle(name: str) -> tuple[Path, VehicleParams]:
    """Parameters of a shipped vehicle or of a TOML file, checked for physical sense.

    Raises:
        UserError: one sentence with file, key, what was found and what is accepted.
    """
    file, values = vehicle_values(name)
    params = checked(values, dict.fromkeys(values, str(file)), str(file)).vehicle
    check_sense(params, str(file))
    return file, params


def vehicle_overrides(name: str) -> dict[str, tuple[Any, str]]:
    """Keys of a vehicle as `scenario.load` takes them, after the checks of load_vehicle."""
    file, _ = load_vehicle(name)
    return {key: (value, str(file)) for key, value in vehicle_values(name)[1].items()}


def check_sense(v: VehicleParams, file: str) -> None:
    """Refuse what no car can be.

    Raises:
        UserError: the first contradiction.
    """
    wheelbase = v.front_axle + v.rear_axle
    if wheelbase + v.front_overhang > v.length:
        raise UserError(
            f"{file}: vehicle.length: found {v.length:g} m; accepted is more than wheelbase and front overhang, "
            f"{wheelbase + v.front_overhang:g} m."
        )
    low, high = (v.mass * (share * v.length) ** 2 for share in GYRATION)
    if not low < v.yaw_inertia < high:
        raise UserError(
            f"{file}: vehicle.yaw_inertia: found {v.yaw_inertia:g} kg m^2; accepted for this mass and length is "
            f"{low:.0f} to {high:.0f} kg m^2."
        )
    if v.cog_height > 0.5 * wheelbase:
        raise UserError(
            f"{file}: vehicle.cog_height: found {v.cog_height:g} m; accepted is up to half of the wheelbase, "
            f"{0.5 * wheelbase:g} m, or the rear lifts when it brakes."
        )
    critical = critical_speed(v)
    if critical < FASTEST:
        raise UserError(
            f"{file}: vehicle.tire: found an oversteering car that spins by itself above {critical:.1f} m/s; "
            f"accepted is a critical speed above {FASTEST:g} m/s: more stiffness at the rear."
        )


def axle_loads(v: VehicleParams) -> tuple[float, float]:
    """Static load of the front and the rear axle [N]."""
    weight, wheelbase = v.mass * GRAVITY, v.front_axle + v.rear_axle
    return weight * v.rear_axle / wheelbase, weight * v.front_axle / wheelbase


def axle_stiffness(v: VehicleParams) -> tuple[float, float]:
    """Cornering stiffness of the front and the rear axle [N/rad]."""
    t = v.tire
    return t.tires_per_axle * t.cornering_stiffness_front, t.tires_per_axle * t.cornering_stiffness_rear


def understeer_gradient(v: VehicleParams) -> float:
    """Steering angle per lateral acceleration beyond that of the curvature [rad s2/m]: (F_f/C_f - F_r/C_r) / g."""
    (load_front, load_rear), (front, rear) = axle_loads(v), axle_stiffness(v)
    return (load_front / front - load_rear / rear) / GRAVITY


def critical_speed(v: VehicleParams) -> float:
    """Speed above which the car is unstable [m/s]: sqrt(-L / K) of an oversteering one; inf of any other."""
    gradient = understeer_gradient(v)
    return math.sqrt((v.front_axle + v.rear_axle) / -gradient) if gradient < 0.0 else math.inf


def peak_lateral_acceleration(v: VehicleParams, friction: float) -> float:
    """Steady lateral acceleration [m/s2] at which the first axle slides, without load transfer."""
    shares = []
    for load, stiffness in zip(axle_loads(v), axle_stiffness(v), strict=True):
        shares.append(lateral_forces(v, stiffness, load, friction).max() / load)
    return GRAVITY * min(shares)


def lateral_forces(v: VehicleParams, stiffness: float, load: float, friction: float) -> np.ndarray:
    """Lateral force of an axle [N] over SLIP_ANGLES, freely rolling."""
    t, kappa = v.tire, v.tire.slip_stiffness * load
    call = (kappa, stiffness, t.sliding_gain, t.sliding_decay, 0.0)
    return np.array([-tire_forces(*call, math.tan(a), load, friction)[1] for a in SLIP_ANGLES])


def longitudinal_forces(v: VehicleParams, stiffness: float, load: float, friction: float) -> np.ndarray:
    """Longitudinal force of an axle [N] over SLIP_RATIOS, straight ahead."""
    t, kappa = v.tire, v.tire.slip_stiffness * load
    call = (kappa, stiffness, t.sliding_gain, t.sliding_decay)
    return np.array([tire_forces(*call, s, 0.0, load, friction)[0] for s in SLIP_RATIOS])


def figures(v: VehicleParams) -> list[Figure]:
    """What follows from the parameters, in words."""
    loads, wheelbase = axle_loads(v), v.front_axle + v.rear_axle
    gradient, critical = understeer_gradient(v), critical_speed(v)
    turns = "understeers" if gradient > 0.0 else "oversteers" if gradient < 0.0 else "is neutral"
    drive = min(v.drive_torque / (v.wheel_radius * v.mass), GRAVITY)
    brake = min(v.brake_torque / (v.wheel_radius * v.mass), GRAVITY)
    speed = f"{critical:.1f} m/s" if math.isfinite(critical) else "none"
    found = [
        Figure("mass, wheelbase", f"{v.mass:g} kg, {wheelbase:.2f} m"),
        Figure("load, front and rear", f"{100 * loads[0] / sum(loads):.1f} %, {100 * loads[1] / sum(loads):.1f} %"),
        Figure("understeer gradient", f"{math.degrees(gradient * GRAVITY):+.3f} deg per g: {turns}"),
        Figure("critical speed", speed),
    ]
    if gradient > 0.0:
        found.append(Figure("characteristic speed", f"{math.sqrt(wheelbase / gradient):.1f} m/s"))
    peaks = ", ".join(f"{peak_lateral_acceleration(v, mu):.2f} m/s² at friction {mu:g}" for mu in (1.0, 0.5))
    return [
        *found,
        Figure("peak lateral acceleration", peaks),
        Figure("yaw radius of gyration", f"{math.sqrt(v.yaw_inertia / v.mass):.2f} m"),
        Figure("turning radius at full lock", f"{wheelbase / math.tan(v.steer_limit):.1f} m"),
        Figure("torque of drive and brakes", f"{drive:.1f} and {brake:.1f} m/s² at most"),
        Figure("power", f"{v.power / 1e3:g} kW, {v.power / v.mass:.0f} W/kg"),
    ]
