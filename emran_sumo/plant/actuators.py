"""From the commands to the wheels: limits, torque split, slip control, brakes; decided once per step."""

import math
from typing import NamedTuple

from emran_sumo.kernels import njit
from emran_sumo.plant.contact import clip, contact
from emran_sumo.plant.records import GRAVITY

_SHARE_LEAST, _SHARE_MOST = 0.15, 0.9  # front share of the torque


class Held(NamedTuple):
    """What stays the same during one step: targets, slip control, brake direction, road."""

    steer_target: float
    torque_target: float
    grip_front: float  # share of the torque that slip control lets through
    grip_rear: float
    spin_front: float  # rotation that brakes oppose, +-1
    spin_rear: float
    locked_front: bool
    locked_rear: bool
    mass: float
    yaw_inertia: float
    weight_normal: float  # [N]
    weight_long: float  # [N], positive pulls back


@njit
def front_share(params, accel_long, weight_normal, mass):
    """Front share of the torque, that of the load: q = (l_r - h f_x / f_z) / L from the specific forces."""
    base = params.front_axle + params.rear_axle
    share = (params.rear_axle - params.cog_height * accel_long * mass / weight_normal) / base
    return clip(share, _SHARE_LEAST, _SHARE_MOST)


@njit
def drive_limit(params, state, share):
    """Largest total drive torque [N m] that torque and power limits allow."""
    spin = share * state.wheel_speed_front + (1.0 - share) * state.wheel_speed_rear
    return min(params.drive_torque, params.power / max(abs(spin), 1.0))


@njit
def _slip_control(params, slip_ratio, torque_sign):
    """Share of the torque let through: fades to 0 at the slip limit where slip and torque have one sign."""
    if params.slip_limit <= 0.0 or slip_ratio * torque_sign <= 0.0:
        return 1.0
    return clip((params.slip_limit - abs(slip_ratio)) / params.slip_window, 0.0, 1.0)


@njit
def _spin(wheel_speed, force_long):
    """Rotation that a brake opposes: the wheel's own, or the one the road would give a standing wheel."""
    if wheel_speed != 0.0:
        return math.copysign(1.0, wheel_speed)
    return -math.copysign(1.0, force_long)


@njit
def hold(params, state, actuation, environment):
    """Sample what is decided once per step, at 1 kHz; also the contact it was decided on."""
    mass = params.mass * environment.mass_factor
    weight = mass * GRAVITY
    weight_normal = weight * math.cos(environment.grade)
    touch = contact(params, state, weight_normal, mass, environment)
    share = front_share(params, state.accel_long, weight_normal, mass)

    spin_front = _spin(state.wheel_speed_front, touch.force_long_front)
    spin_rear = _spin(state.wheel_speed_rear, touch.force_long_rear)
    brakes = state.torque < 0.0
    grip_front = _slip_control(params, touch.slip_ratio_front, -spin_front if brakes else 1.0)
    grip_rear = _slip_control(params, touch.slip_ratio_rear, -spin_rear if brakes else 1.0)
    brake_front = -state.torque * share * grip_front
    brake_rear = -state.torque * (1.0 - share) * grip_rear
    radius = params.wheel_radius
    steer = environment.steer_effectiveness * actuation.steer
    torque = environment.torque_effectiveness * actuation.torque
    held = Held(
        clip(steer, -params.steer_limit, params.steer_limit),
        clip(torque, -params.brake_torque, drive_limit(params, state, share)),
        grip_front,
        grip_rear,
        spin_front,
        spin_rear,
        brakes and state.wheel_speed_front == 0.0 and radius * abs(touch.force_long_front) <= brake_front,
        brakes and state.wheel_speed_rear == 0.0 and radius * abs(touch.force_long_rear) <= brake_rear,
        mass,
        params.yaw_inertia * environment.inertia_factor,
        weight_normal,
        weight * math.sin(environment.grade),
    )
    return held, touch


@njit
def stopped(wheel_speed, spin, torque):
    """Wheel speed after a step: a brake stops a wheel, it does not turn it backward."""
    return 0.0 if torque < 0.0 and wheel_speed * spin < 0.0 else wheel_speed
