"""Where the car meets road and air: axle loads, slips, tire forces, drag, side wind (Eq. 5, 6, 9, 10)."""

import math
from typing import NamedTuple

from emran_sumo.kernels import njit
from emran_sumo.plant.tire import tire_forces

_WHEEL_RATE = 2000.0  # [1/s] fastest wheel spin RK4 may meet: it is stable up to 2785/s at 1 ms
_LATERAL_FLOOR = 0.5  # [m/s] below it the slip angle fades, so that steering a standing car gives no force
_ROLLING_SPEED = 0.3  # [m/s] below it rolling resistance fades


class Contact(NamedTuple):
    """Tires and air at one instant."""

    slip_ratio_front: float
    slip_ratio_rear: float
    tan_slip_front: float
    tan_slip_rear: float
    load_front: float
    load_rear: float
    force_long_front: float
    force_long_rear: float
    force_lat_front: float
    force_lat_rear: float
    body_long: float  # [N] sum of all forces but gravity, body axes
    body_lat: float
    moment_yaw: float


@njit
def clip(value, low, high):
    return min(max(value, low), high)


@njit
def drag(params, speed_long, wind_long):
    """Air drag [N], positive against forward motion."""
    relative = speed_long + wind_long
    return 0.5 * params.air_density * params.drag_area * relative * abs(relative)


@njit
def side_wind(params, speed_long, wind_long, wind_lat):
    """Side force [N] of a crosswind: linear in the flow angle, then saturating; v_y is neglected."""
    if wind_lat == 0.0:
        return 0.0
    along = speed_long + wind_long
    flow_angle = math.atan2(wind_lat, abs(along))
    limit = params.side_area_limit
    area = limit * math.tanh(params.side_area_coefficient * flow_angle / limit)
    return 0.5 * params.air_density * (along * along + wind_lat * wind_lat) * area


@njit
def rolling_resistance(params, speed_long, weight_normal):
    """Rolling resistance [N], positive against forward motion."""
    return params.rolling_resistance * weight_normal * math.tanh(speed_long / _ROLLING_SPEED)


@njit
def _slip_floor(params, longitudinal_stiffness):
    """Speed [m/s] below which slip no longer grows: it limits the wheel's own rate."""
    radius = params.wheel_radius
    return radius * radius * longitudinal_stiffness / (params.wheel_inertia * _WHEEL_RATE)


@njit
def _slip_ratio(params, wheel_speed, speed_wheel, longitudinal_stiffness):
    """kappa = (R omega - v) / max(|R omega|, |v|, floor)                                         (10)"""
    rolling = params.wheel_radius * wheel_speed
    floor = _slip_floor(params, longitudinal_stiffness)
    return (rolling - speed_wheel) / max(abs(rolling), abs(speed_wheel), floor, 0.1)


@njit
def _loads(params, accel_long, drag_force, weight_normal, mass):
    """Load [N] of the front and the rear axle, quasi-static."""
    base = params.front_axle + params.rear_axle
    transfer = params.cog_height * (mass * accel_long + drag_force) / base
    front = clip(weight_normal * params.rear_axle / base - transfer, 0.0, weight_normal)
    return front, weight_normal - front


@njit
def _wheel_velocities(params, state):
    """Velocities [m/s] along and across the front, then the rear wheels; across / along = tan(alpha) (9)."""
    sin_steer = math.sin(state.steer)
    cos_steer = math.cos(state.steer)
    lat_front = state.speed_lat + params.front_axle * state.yaw_rate
    lat_rear = state.speed_lat - params.rear_axle * state.yaw_rate
    along_front = state.speed_long * cos_steer + lat_front * sin_steer
    across_front = lat_front * cos_steer - state.speed_long * sin_steer
    return along_front, across_front, state.speed_long, lat_rear


@njit
def _axle(params, cornering_stiffness, wheel_speed, along, across, load, friction):
    """Slip ratio, tan(slip angle) and tire forces [N] of one axle, wheel axes."""
    tire = params.tire
    stiffness = tire.slip_stiffness * load
    kappa = _slip_ratio(params, wheel_speed, along, stiffness)
    tan_slip = across / max(abs(along), _LATERAL_FLOOR)
    force_long, force_lat = tire_forces(
        stiffness, cornering_stiffness, tire.sliding_gain, tire.sliding_decay, kappa, tan_slip, load, friction
    )
    return kappa, tan_slip, force_long, force_lat


@njit
def contact(params, state, weight_normal, mass, environment):
    """Loads, slips and forces of both axles, and their sum with air and rolling resistance, as Contact."""
    drag_force = drag(params, state.speed_long, environment.wind_long)
    load_front, load_rear = _loads(params, state.accel_long, drag_force, weight_normal, mass)
    along_front, across_front, along_rear, across_rear = _wheel_velocities(params, state)
    tire = params.tire
    cornering_front = tire.tires_per_axle * tire.cornering_stiffness_front * environment.stiffness_front_factor
    cornering_rear = tire.tires_per_axle * tire.cornering_stiffness_rear * environment.stiffness_rear_factor
    kappa_front, tan_front, fx_front, fy_front = _axle(
        params, cornering_front, state.wheel_speed_front, along_front, across_front, load_front, environment.friction
    )
    kappa_rear, tan_rear, fx_rear, fy_rear = _axle(
        params, cornering_rear, state.wheel_speed_rear, along_rear, across_rear, load_rear, environment.friction
    )
    rolling = rolling_resistance(params, state.speed_long, weight_normal)
    side = side_wind(params, state.speed_long, environment.wind_long, environment.wind_lat)
    sin_steer = math.sin(state.steer)
    cos_steer = math.cos(state.steer)
    lat_body_front = fx_front * sin_steer + fy_front * cos_steer
    return Contact(
        kappa_front,
        kappa_rear,
        tan_front,
        tan_rear,
        load_front,
        load_rear,
        fx_front,
        fx_rear,
        fy_front,
        fy_rear,
        fx_front * cos_steer - fy_front * sin_steer + fx_rear - drag_force - rolling,
        lat_body_front + fy_rear + environment.force_lat + side,
        params.front_axle * lat_body_front
        - params.rear_axle * fy_rear
        + environment.moment_yaw
        + params.wind_yaw_arm * params.length * side,
    )


@njit
def trim_wheel_speed(params, speed, slip_ratio, load):
    """Wheel speed [rad/s] that has a slip ratio >= 0 at a speed."""
    floor = _slip_floor(params, params.tire.slip_stiffness * load)
    rolling = speed / (1.0 - slip_ratio)
    return (rolling if rolling >= floor else speed + slip_ratio * floor) / params.wheel_radius
