"""The car at rest: when it has come to a stop, and what holds it there."""

import math

from emran_sumo.kernels import njit
from emran_sumo.plant.contact import drag, side_wind
from emran_sumo.plant.records import GRAVITY

_REST_SPEED = 0.05  # [m/s] below it a car that brakes or friction can hold is at rest


@njit
def stands(state):
    """Whether nothing moves at all."""
    return (
        state.speed_long == 0.0
        and state.speed_lat == 0.0
        and state.yaw_rate == 0.0
        and state.wheel_speed_front == 0.0
        and state.wheel_speed_rear == 0.0
    )


@njit
def slow(params, state):
    """Whether the car and its wheels move slower than the rest speed."""
    return (
        abs(state.speed_long) < _REST_SPEED
        and abs(state.speed_lat) < _REST_SPEED
        and abs(state.yaw_rate) < _REST_SPEED
        and params.wheel_radius * abs(state.wheel_speed_front) < _REST_SPEED
        and params.wheel_radius * abs(state.wheel_speed_rear) < _REST_SPEED
    )


@njit
def holding_force(params, torque, environment):
    """Forces [N] on a car at rest, pulling back and to the left, and whether it can be held against them.

    Brakes and rolling resistance hold against what a drive torque leaves over, in either direction.
    """
    weight = params.mass * environment.mass_factor * GRAVITY
    normal = weight * math.cos(environment.grade)
    needed = weight * math.sin(environment.grade) + drag(params, 0.0, environment.wind_long)
    lateral = environment.force_lat + side_wind(params, 0.0, environment.wind_long, environment.wind_lat)
    holding = max(-torque, 0.0) / params.wheel_radius + params.rolling_resistance * normal
    grip = environment.friction * normal
    held = abs(needed - max(torque, 0.0) / params.wheel_radius) <= holding
    return needed, lateral, held and needed * needed + lateral * lateral <= grip * grip
