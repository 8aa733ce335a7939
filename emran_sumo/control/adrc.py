"""Active disturbance rejection (Han): tracking differentiator, extended state observer, nonlinear error feedback.

For the car the output is the place of its front center of percussion beside the path.  A force at the rear axle does
not move that point sideways, so that it is a flat output of the front axle: its acceleration follows from the slip
angle of the front wheels alone, and the steering that gives a wanted acceleration can be written down.
"""

import math
from typing import Annotated, NamedTuple

from pydantic import Field

from emran_sumo.control.bicycle import steady_turn
from emran_sumo.control.stanley import stanley
from emran_sumo.kernels import njit
from emran_sumo.plant.tire import axle_stiffness
from emran_sumo.units import Unit

CREEPING, ROLLING = 1.0, 3.0  # m/s: below the first Stanley steers alone, above the second it does not


class AdrcParams(NamedTuple):
    """Bandwidths w_c and w_o of control and observer, and the shape of their nonlinear gains.

    Within the zones the gains are those of the linear law with these bandwidths; beyond, errors count with the power
    `error_power` or `rate_power`, estimation errors with 1/2 and 1/4.  transition: acceleration with which the
    tracking differentiator leads an offset back to the path.  preview: how far ahead the curvature is read.
    """

    control_bandwidth: Annotated[float, Field(gt=0, le=50), Unit("1/s")] = 3.9697
    observer_bandwidth: Annotated[float, Field(gt=0, le=90), Unit("1/s")] = 10.337
    error_power: Annotated[float, Field(gt=0, le=1), Unit("-")] = 0.79625
    rate_power: Annotated[float, Field(gt=0, le=2), Unit("-")] = 1.4758
    error_zone: Annotated[float, Field(gt=0, le=10), Unit("m")] = 0.11097
    rate_zone: Annotated[float, Field(gt=0, le=10), Unit("m/s")] = 0.010005
    estimate_zone: Annotated[float, Field(gt=0, le=10), Unit("m")] = 0.048052
    transition: Annotated[float, Field(gt=0, le=100), Unit("m/s^2")] = 3.0
    preview: Annotated[float, Field(ge=0, le=1), Unit("s")] = 1.2926e-05


class AdrcMemory(NamedTuple):
    """Tracking differentiator: place [m] and speed [m/s] that the output is to have; observer: place [m], speed
    [m/s] and acceleration that is not accounted for [m/s2]; begun: whether they have been started."""

    wanted: float
    wanted_rate: float
    place: float
    rate: float
    disturbance: float
    begun: bool


def blank_adrc() -> AdrcMemory:
    """Memory of a law that has not been called."""
    return AdrcMemory(0.0, 0.0, 0.0, 0.0, 0.0, False)


@njit
def _sign(x):
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


@njit
def fhan(x1, x2, accel, period):
    """Time-optimal acceleration that brings a sampled double integrator (x1, x2) to rest at 0.

        d = r h^2,  a_0 = h x_2,  y = x_1 + a_0,  a_1 = sqrt(d (d + 8 |y|)),  a_2 = a_0 + sign(y) (a_1 - d) / 2
        s_y = (sign(y + d) - sign(y - d)) / 2,  a = (a_0 + y - a_2) s_y + a_2
        s_a = (sign(a + d) - sign(a - d)) / 2,  fhan = -r (a / d - sign(a)) s_a - r sign(a)

    Args:
        x1, x2: state.
        accel: r, the bound of the result.
        period: h [s]; longer than the sampling period smooths.

    Source: Han 2009, From PID to active disturbance rejection control.
    """
    d = accel * period * period
    a0 = period * x2
    y = x1 + a0
    a1 = math.sqrt(d * (d + 8.0 * abs(y)))
    a2 = a0 + _sign(y) * (a1 - d) / 2.0
    near_y = (_sign(y + d) - _sign(y - d)) / 2.0
    a = (a0 + y - a2) * near_y + a2
    near_a = (_sign(a + d) - _sign(a - d)) / 2.0
    return -accel * (a / d - _sign(a)) * near_a - accel * _sign(a)


@njit
def fal(error, power, zone):
    """|e|^p sign(e), and linear where |e| is within the zone w: e / w^(1-p).  Source: Han 2009."""
    if abs(error) <= zone:
        return error / zone ** (1.0 - power)
    return abs(error) ** power * _sign(error)


@njit
def _scaled(error, power, zone):
    """fal with the gain 1 inside the zone."""
    return zone ** (1.0 - power) * fal(error, power, zone)


@njit
def adrc(params, memory, output, known, period):
    """Acceleration that brings the output of a double integrator y'' = known + f to 0, whatever f.

        TD    v_1' = v_2,  v_2' = fhan(v_1, v_2)
        ESO   z_1' = z_2 - 3 w_o e,  z_2' = z_3 - 3 w_o^2 fal(e, 1/2) + known,  z_3' = -w_o^3 fal(e, 1/4),  e = z_1 - y
        NLSEF u_0 = w_c^2 fal(v_1 - z_1) + 2 w_c fal(v_2 - z_2)

    Args:
        params: AdrcParams.
        memory: AdrcMemory of the last call.
        output: y.
        known: the acceleration that the input and what else is known give now.
        period: h [s].

    Returns:
        (u_0 - z_3: acceleration to ask for, AdrcMemory)

    Source: Han 2009; bandwidths: Gao 2003.  Differs: fal is scaled to the gain 1 at small errors, so that w_c and w_o
    are bandwidths there.
    """
    h = period
    v1, v2, z1, z2, z3, begun = memory
    if not begun:
        v1, v2, z1, z2, z3 = output, 0.0, output, 0.0, 0.0
    a = fhan(v1, v2, params.transition, 5.0 * h)
    v1, v2 = v1 + h * v2, v2 + h * a
    w, zone = params.observer_bandwidth, params.estimate_zone
    e = z1 - output
    z1, z2, z3 = (
        z1 + h * (z2 - 3.0 * w * e),
        z2 + h * (z3 - 3.0 * w * w * _scaled(e, 0.5, zone) + known),
        z3 - h * w * w * w * _scaled(e, 0.25, zone),
    )
    w = params.control_bandwidth
    asked = w * w * _scaled(v1 - z1, params.error_power, params.error_zone)
    asked += 2.0 * w * _scaled(v2 - z2, params.rate_power, params.rate_zone)
    return asked - z3, AdrcMemory(v1, v2, z1, z2, z3, True)


@njit
def percussion_arm(vehicle):
    """Distance [m] of the front center of percussion ahead of the center of gravity: I_z / (m l_r)."""
    return vehicle.yaw_inertia / (vehicle.mass * vehicle.rear_axle)


@njit
def flat_adrc(params, memory, vehicle, state, cross_track_error, heading_error, curvature, ahead, period):
    """Steering for the acceleration that ADRC asks of the front center of percussion.

        y'' = b_0 (delta - theta_f) - v^2 kappa + f,   b_0 = C_f L / (m l_r),   theta_f = atan2(v_y + l_f r, v)
        y_r = -(d beta + d^2 / 2) kappa      the place of that point while the center of gravity is on the path
        a = u_0 - z_3 + v^2 kappa
        delta = theta_f + a / b_0 + tau (a / v - r)

    The last term is the rate at which that angle will change, over the lag tau of the steering.

    Args:
        params: AdrcParams.
        memory: AdrcMemory of the last call.
        vehicle: VehicleParams the law believes in.
        state: VehicleState (speeds, yaw rate and measured steering angle are used).
        cross_track_error, heading_error: at the front center of percussion, path minus vehicle [m], [rad].
        curvature: kappa [1/m] of the path there.
        ahead: kappa [1/m] that the law is to follow, read ahead by `preview`.
        period: control period [s].

    Returns:
        (road-wheel angle [rad], not yet limited; AdrcMemory)

    Source: Xia, Pu, Li, Gao 2016 (idea: ADRC with differential flatness; their gains are not public).  Differs: the
    observer takes the measured wheel angle for its input, in which limits, lag and network are contained; the course
    of the front axle is measured, not estimated; the slip angle says nothing at standstill, so that Stanley (Eq. 22
    with k = w_c) takes over between 3 and 1 m/s.
    """
    v = state.speed_long
    slow = stanley(params.control_bandwidth, 1.0, cross_track_error, heading_error, v)
    if v < CREEPING:
        return slow, AdrcMemory(0.0, 0.0, 0.0, 0.0, 0.0, False)
    gain = axle_stiffness(vehicle.tire, False) * (vehicle.front_axle + vehicle.rear_axle)
    gain /= vehicle.mass * vehicle.rear_axle
    course = math.atan2(state.speed_lat + vehicle.front_axle * state.yaw_rate, v)
    known = gain * (state.steer - course) - v * v * curvature
    arm, side_slip = percussion_arm(vehicle), steady_turn(vehicle, v)[0]
    wanted = -arm * (side_slip + 0.5 * arm) * curvature
    asked, memory = adrc(params, memory, -cross_track_error - wanted, known, period)
    accel = asked + v * v * ahead
    angle = course + accel / gain + vehicle.steer_lag * (accel / v - state.yaw_rate)
    share = min((v - CREEPING) / (ROLLING - CREEPING), 1.0)
    return slow + share * (angle - slow), memory
