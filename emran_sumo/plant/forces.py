"""Slips, tire forces, axle loads and accelerations of one instant, as they are recorded."""

import math
from typing import NamedTuple

from emran_sumo.kernels import njit
from emran_sumo.plant.contact import contact
from emran_sumo.plant.records import GRAVITY
from emran_sumo.plant.standstill import holding_force, stands


class Forces(NamedTuple):
    """Slips and forces of one instant; tire forces in wheel axes."""

    slip_ratio_front: float
    slip_ratio_rear: float
    slip_angle_front: float  # [rad]
    slip_angle_rear: float  # [rad]
    force_long_front: float  # [N]
    force_long_rear: float  # [N]
    force_lat_front: float  # [N]
    force_lat_rear: float  # [N]
    load_front: float  # [N]
    load_rear: float  # [N]
    friction_use_front: float  # |force| / (friction * load)
    friction_use_rear: float
    accel_long: float  # [m/s^2] specific force: dv_x/dt - v_y r + g sin(grade)
    accel_lat: float  # [m/s^2] specific force: dv_y/dt + v_x r


@njit
def _friction_use(force_long, force_lat, load, friction):
    grip = load * friction
    return math.sqrt(force_long * force_long + force_lat * force_lat) / grip if grip > 0.0 else 0.0


@njit
def forces(params, state, environment):
    """Slips, tire forces, loads and accelerometer readings of one instant.

    A car at rest shows the forces that hold it, shared by axle load.

    Args:
        params: VehicleParams.
        state: VehicleState.
        environment: Environment.

    Returns:
        Forces.
    """
    mass = params.mass * environment.mass_factor
    weight = mass * GRAVITY
    c = contact(params, state, weight * math.cos(environment.grade), mass, environment)
    fx_front, fx_rear = c.force_long_front, c.force_long_rear
    fy_front, fy_rear = c.force_lat_front, c.force_lat_rear
    accel_long = c.body_long / mass
    accel_lat = c.body_lat / mass
    if stands(state):
        needed, lateral, held = holding_force(params, state.torque, environment)
        if held:
            share = c.load_front / (c.load_front + c.load_rear)
            fx_front, fx_rear = share * needed, (1.0 - share) * needed
            fy_front, fy_rear = -share * lateral, -(1.0 - share) * lateral
            accel_long = weight * math.sin(environment.grade) / mass
            accel_lat = 0.0
    return Forces(
        c.slip_ratio_front,
        c.slip_ratio_rear,
        math.atan(c.tan_slip_front),
        math.atan(c.tan_slip_rear),
        fx_front,
        fx_rear,
        fy_front,
        fy_rear,
        c.load_front,
        c.load_rear,
        _friction_use(fx_front, fy_front, c.load_front, environment.friction),
        _friction_use(fx_rear, fy_rear, c.load_rear, environment.friction),
        accel_long,
        accel_lat,
    )
