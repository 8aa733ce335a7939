"""Stanley path tracking: the two terms of Eq. 22, and the full law of Hoffmann et al."""

import math
from typing import Annotated, NamedTuple

from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.plant.tire import axle_stiffness
from emran_sumo.units import Unit


@njit
def stanley(gain, softening, cross_track_error, heading_error, speed):
    """Steer toward the path.

        delta = psi_e + atan(k e / (k_s + v))                                                        (22)

    Args:
        gain: k [1/s].
        softening: k_s [m/s], keeps the angle finite at low speed.
        cross_track_error: e [m] at the reference point, positive when the path lies to the left.
        heading_error: psi_e [rad], path minus vehicle, in [-pi, pi).
        speed: v [m/s]; at least 0.1 m/s is assumed.

    Returns:
        Road-wheel angle [rad], positive to the left, not yet limited.

    Source: paper, Eq. 22; Hoffmann et al. 2007.  Differs: k_s added for low speed.
    """
    return heading_error + math.atan(gain * cross_track_error / (softening + max(speed, 0.1)))


class HoffmannParams(NamedTuple):
    """The full Stanley law: k, k_s, and how much yaw rate and steering rate are damped (k_d,yaw, k_d,steer)."""

    gain: Annotated[float, Field(ge=0, le=50), Unit("1/s")] = 1.3408
    softening: Annotated[float, Field(ge=0, le=50), Unit("m/s")] = 3.9883
    yaw_damping: Annotated[float, Field(ge=0, le=2), Unit("s")] = 0.013866
    steer_damping: Annotated[float, Field(ge=0, le=20), Unit("-")] = 0.00042139


class HoffmannMemory(NamedTuple):
    """Road-wheel angle measured at the last call [rad]."""

    steer: float


@njit
def full_stanley(params, memory, vehicle, state, cross_track_error, heading_error, curvature):
    """Stanley with steady-state yaw and the damping of yaw rate and steering.

        delta = psi_e + psi_ss + atan(k e / (k_s + v)) + k_yaw (kappa v - r) + k_steer (delta_i - delta_i+1)
        psi_ss = m v^2 kappa / (C_f (1 + l_f / l_r))

    Args:
        params: HoffmannParams.
        memory: HoffmannMemory of the last call.
        vehicle: VehicleParams the law believes in.
        state: VehicleState (speed, yaw rate and measured steering angle are used).
        cross_track_error, heading_error: at the front axle [m], [rad].
        curvature: kappa [1/m] of the path there.

    Returns:
        (road-wheel angle [rad], not yet limited; HoffmannMemory)

    Source: Hoffmann, Tomlin, Montemerlo, Thrun 2007.  Differs: signs for errors path minus vehicle, where psi_ss is
    the slip angle of the front axle in the bend and adds; k_s + v in place of v, as there for low speed.
    """
    v = max(state.speed_long, 0.0)
    slip = vehicle.mass * v * v * curvature / axle_stiffness(vehicle.tire, False)
    slip /= 1.0 + vehicle.front_axle / vehicle.rear_axle
    angle = stanley(params.gain, params.softening, cross_track_error, heading_error + slip, v)
    angle += params.yaw_damping * (curvature * v - state.yaw_rate)
    angle += params.steer_damping * (memory.steer - state.steer)
    return angle, HoffmannMemory(state.steer)
