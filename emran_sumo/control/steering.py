"""Path tracking: Stanley alone or in the full scheme with feed-forward and preview, other laws, EMRAN beside any."""

import math
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.control.adrc import AdrcMemory, AdrcParams, blank_adrc, flat_adrc, percussion_arm
from emran_sumo.control.emran import EmranParams, fade, learn, learn_bias, predict, prune
from emran_sumo.control.fuzzy import FuzzyMemory, FuzzyParams, blank_fuzzy, fuzzy_pid
from emran_sumo.control.lqr import LqPreviewParams, LqrGains, LqrParams, lqr, lqr_gains
from emran_sumo.control.stanley import HoffmannMemory, HoffmannParams, full_stanley, stanley
from emran_sumo.kernels import njit
from emran_sumo.path import interpolate, mean_curvature, nearest, tracking_errors
from emran_sumo.plant.records import GRAVITY, VehicleParams, VehicleState
from emran_sumo.plant.tire import axle_stiffness, slip_angle_for_force
from emran_sumo.units import Unit

INPUTS = 4  # cross-track error, heading error, lateral speed, yaw rate
LEARNING_SPEED = 2.0  # m/s: below it the course is not defined well enough to learn from
SLOWEST_SCALED = 7.5  # m/s: learning rates grow no further below this speed

Law = Literal["stanley", "hoffmann", "adrc", "lqr", "lq_preview", "t2fnn"]


class SteeringParams(NamedTuple):
    """The lateral law and its network.

    `law` says who steers; the section of its name holds its parameters, and those of this section are for Stanley, the
    network and the guards.  With `feedforward` off Eq. 22 acts alone, on the errors of the front axle: the paper's
    baseline. Its network then learns the paper's own signal delta_s + K_2 e_y + K_3 e_psi from the raw inputs y, psi,
    v_y and r. Other laws do not read `feedforward`.
    """

    law: Law = "stanley"
    feedforward: Annotated[bool, Unit("on/off")] = True
    K_2: Annotated[float, Field(ge=-5, le=5), Unit("rad/m")] = 0.0
    K_3: Annotated[float, Field(ge=-5, le=5), Unit("-")] = 0.0
    gain: Annotated[float, Field(ge=0, le=50), Unit("1/s")] = 3.7253
    softening: Annotated[float, Field(ge=0, le=50), Unit("m/s")] = 2.3275
    yaw_damping: Annotated[float, Field(ge=0, le=2), Unit("s")] = 0.068423
    reference_ahead: Annotated[float, Field(ge=-5, le=5), Unit("m")] = 0.003091
    preview_feedforward: Annotated[float, Field(ge=0, le=2), Unit("s")] = 0.024136
    preview_feedback: Annotated[float, Field(ge=0, le=2), Unit("s")] = 0.063113
    preview_slope: Annotated[float, Field(ge=0, le=2), Unit("s per 10 m/s")] = 0.069454
    preview_window: Annotated[float, Field(ge=0, le=2), Unit("s")] = 3.1133e-06
    friction_estimate: Annotated[float, Field(gt=0, le=2), Unit("-")] = 1.0
    slip_cap: Annotated[float, Field(gt=0, le=1), Unit("rad")] = 0.14
    slip_limit: Annotated[float, Field(gt=0, le=2), Unit("rad")] = 0.15
    guard: Annotated[float, Field(gt=0, le=1), Unit("rad")] = 0.035
    guard_decay: Annotated[float, Field(ge=0, le=90), Unit("1/s")] = 2.0
    smoothing: Annotated[float, Field(gt=0, le=1), Unit("-")] = 0.99985
    rate_exponent: Annotated[float, Field(ge=0, le=5), Unit("-")] = 2.43
    cross_track_scale: Annotated[float, Field(ge=0, le=1000), Unit("1/m")] = 5.65
    heading_scale: Annotated[float, Field(ge=0, le=1000), Unit("1/rad")] = 12.91
    speed_lat_scale: Annotated[float, Field(ge=0, le=1000), Unit("s/m")] = 10.432
    yaw_rate_scale: Annotated[float, Field(ge=0, le=1000), Unit("s/rad")] = 14.016
    conditioning: Annotated[bool, Unit("on/off")] = False
    cut_sigma: Annotated[float, Field(gt=0, le=10), Unit("m")] = 0.065
    cut_heading_sigma: Annotated[float, Field(gt=0, le=1), Unit("rad")] = 0.01
    cut_smoothness: Annotated[float, Field(ge=0, le=1e4), Unit("m^2")] = 100.0
    cut_max: Annotated[float, Field(ge=0, le=1), Unit("m at 10 m/s")] = 0.04
    emran: EmranParams = EmranParams()
    hoffmann: HoffmannParams = HoffmannParams()
    adrc: AdrcParams = AdrcParams()
    lqr: LqrParams = LqrParams()
    lq_preview: LqPreviewParams = LqPreviewParams()
    t2fnn: FuzzyParams = FuzzyParams()


class SteeringMemory(NamedTuple):
    """Smoothed output of the network [rad], and what the law remembers.

    The one that is not None says which law steers; Stanley remembers nothing.  Kernels know it when they are compiled:
    a law costs nothing in runs under another one.
    """

    smoothed: float = 0.0
    hoffmann: HoffmannMemory | None = None
    adrc: AdrcMemory | None = None
    lqr: LqrGains | None = None
    t2fnn: FuzzyMemory | None = None


class SteeringCommand(NamedTuple):
    """Road-wheel angle asked [rad] with its parts from the law and the network, and the learning signal [rad]."""

    angle: float
    law: float
    network: float
    signal: float
    learned: bool


def blank_steering(
    params: SteeringParams, vehicle: VehicleParams, state: VehicleState, period: float
) -> SteeringMemory:
    """Memory of a law that takes over a vehicle: what it knows before its first step.

    Args:
        params: SteeringParams.
        vehicle: VehicleParams the law believes in.
        state: VehicleState at the take-over.
        period: control period [s].
    """
    match params.law:
        case "stanley":
            return SteeringMemory()
        case "hoffmann":
            return SteeringMemory(hoffmann=HoffmannMemory(state.steer))
        case "adrc":
            return SteeringMemory(adrc=blank_adrc())
        case "lqr":
            return SteeringMemory(lqr=lqr_gains(params.lqr, vehicle, period))
        case "lq_preview":
            return SteeringMemory(lqr=lqr_gains(params.lq_preview, vehicle, period))
        case "t2fnn":
            return SteeringMemory(t2fnn=blank_fuzzy(params.t2fnn))
    raise AssertionError(f"no law {params.law}: the record is one that was made for kernels")


def compiled_view(params: SteeringParams) -> SteeringParams:
    """The record as kernels take it: without text and without the sections that they do not read, which cost time."""
    unread = {"hoffmann", "adrc", "t2fnn"} - {params.law} | {"lqr", "lq_preview"}
    return params._replace(law=None, **dict.fromkeys(unread))


@njit
def static_load(vehicle, rear):
    """Load of one axle at rest on the flat [N]."""
    wheelbase = vehicle.front_axle + vehicle.rear_axle
    arm = vehicle.front_axle if rear else vehicle.rear_axle
    return vehicle.mass * GRAVITY * arm / wheelbase


@njit
def cornering_slip(params, vehicle, lateral_accel, rear):
    """Slip angle magnitude, signed like `lateral_accel` [m/s2], with which an axle carries its share of the turn.

    The inverse of the tire model at zero slip ratio, static load and the estimated friction; held at `slip_cap`.
    """
    load = static_load(vehicle, rear)
    tire = vehicle.tire
    return slip_angle_for_force(
        load / GRAVITY * lateral_accel,
        load,
        axle_stiffness(tire, rear),
        tire.sliding_gain,
        tire.sliding_decay,
        params.friction_estimate,
        params.slip_cap,
    )


@njit
def _preview(params, speed, time):
    return max(time + params.preview_slope * (speed - 10.0) / 10.0, 0.0) * speed


@njit
def track(params, network, vehicle, memory, state, path, point, cross_track_error, heading_error, period):
    """Steering command that makes the vehicle follow the path.

    Under Stanley; the other laws stand in modules of their own.

        delta = delta_ff + delta_fb + delta_nn                                                       (21)
        delta_ff = L kappa + alpha_f*(v^2 kappa) - alpha_r*(v^2 kappa)     tire inverse alpha*, previewed kappa
        delta_fb = Eq. 22 on the errors that remain beyond the side slip of the bend, plus yaw damping
        y_e = psi_e - atan2(v_y + a r, v_x) + atan(k e / (k_s + v))        course error: zero on the path

    Args:
        params: SteeringParams.
        network: EmranMemory with 4 inputs, changed in place.
        vehicle: VehicleParams the law believes in.
        memory: SteeringMemory of the last call.
        state: VehicleState (speeds, yaw rate and steering angle are used).
        path: Path.
        point: Point of the path nearest to the center of gravity.
        cross_track_error, heading_error: at the center of gravity [m], [rad].
        period: control period [s].

    Returns:
        (SteeringCommand, SteeringMemory)

    Source: paper, section III-C, Eq. 21-22.  Differs: the paper learns delta_s + K e, which is not zero on a bent path
    (the heading error must carry the side slip), so that learning trades path for heading error; the course error is.
    """
    return _by_law(
        params, network, vehicle, memory, state, path, point, cross_track_error, heading_error, period,
        memory.hoffmann, memory.adrc, memory.lqr, memory.t2fnn,
    )  # fmt: skip


@njit
def _by_law(
    params, network, vehicle, memory, state, path, point, cross_track_error, heading_error, period,
    hoffmann, adrc, gains, t2fnn,
):  # fmt: skip
    """The law whose memory is not None; the other branches are not compiled."""
    cross_track, heading, kappa = cross_track_error, heading_error, point.curvature
    if hoffmann is not None:
        front, e, psi = _beside(vehicle.front_axle, state, path, point)
        law, after = full_stanley(params.hoffmann, hoffmann, vehicle, state, e, psi, front.curvature)
        memory = SteeringMemory(memory.smoothed, after, None, None, None)
        return aided(params, network, vehicle, memory, state, cross_track, heading, law, period)
    if adrc is not None:
        there, e, psi = _beside(percussion_arm(vehicle), state, path, point)
        ahead = there.position + params.adrc.preview * max(state.speed_long, 0.0)
        ahead = interpolate(path.curvature, path, ahead)
        law, after = flat_adrc(params.adrc, adrc, vehicle, state, e, psi, there.curvature, ahead, period)
        memory = SteeringMemory(memory.smoothed, None, after, None, None)
        return aided(params, network, vehicle, memory, state, cross_track, heading, law, period)
    if gains is not None:
        law = lqr(gains, vehicle, state, path, point.position, cross_track, heading, kappa, period)
        return aided(params, network, vehicle, memory, state, cross_track, heading, law, period)
    if t2fnn is not None:
        _, slip = _slip(vehicle, state)
        law, after = fuzzy_pid(
            params.t2fnn, t2fnn, vehicle, state, cross_track, heading, kappa, slip, params.guard, period
        )
        memory = SteeringMemory(memory.smoothed, None, None, None, after)
        return aided(params, network, vehicle, memory, state, cross_track, heading, law, period)
    if params.feedforward:
        law = _law(params, vehicle, state, path, point, cross_track, heading)
        return aided(params, network, vehicle, memory, state, cross_track, heading, law, period)
    return _plain(params, network, vehicle, memory, state, path, point, period)


@njit
def _slip(vehicle, state):
    """Course of the front axle against the body, and the larger slip angle of both axles [rad]."""
    safe = max(state.speed_long, 0.1)
    front = math.atan2(state.speed_lat + vehicle.front_axle * state.yaw_rate, safe)
    rear = math.atan2(state.speed_lat - vehicle.rear_axle * state.yaw_rate, safe)
    return front, max(abs(front - state.steer), abs(rear))


@njit
def _beside(ahead, state, path, point):
    """Point of the path nearest to the one `ahead` [m] of the center of gravity, and the errors there."""
    x = state.x + ahead * math.cos(state.yaw)
    y = state.y + ahead * math.sin(state.yaw)
    there = nearest(path, x, y, point.position + ahead)
    cross_track, heading = tracking_errors(there, x, y, state.yaw)
    return there, cross_track, heading


@njit
def _plain(params, network, vehicle, memory, state, path, point, period):
    """The paper's own scheme: Stanley at the front axle, and a network that learns delta_s + K e."""
    _, cross_track, heading = _beside(vehicle.front_axle, state, path, point)
    law = stanley(params.gain, params.softening, cross_track, heading, state.speed_long)
    emran = params.emran
    if emran.authority <= 0.0:
        return SteeringCommand(_limited(vehicle, law), law, 0.0, 0.0, False), memory
    signal = law + params.K_2 * cross_track + params.K_3 * heading
    inputs = np.empty(INPUTS)
    inputs[0], inputs[1], inputs[2], inputs[3] = state.y, state.yaw, state.speed_lat, state.yaw_rate
    output = predict(emran, network, inputs)
    learned = False
    if abs(output) < emran.output_max or output * signal < 0.0:
        learned = learn(emran, network, inputs, signal, 1.0, period)
        if learned:
            learn_bias(emran, network, signal, 1.0, period)
    part = emran.authority * predict(emran, network, inputs)
    prune(emran, network, inputs)
    return SteeringCommand(_limited(vehicle, law + part), law, part, signal, learned), memory


@njit
def _law(params, vehicle, state, path, point, cross_track_error, heading_error):
    """Feed-forward and feedback of the full scheme [rad]."""
    cross_track_error = cross_track_error + params.reference_ahead * math.sin(heading_error)
    v = max(state.speed_long, 0.0)
    window = params.preview_window * v
    ahead = point.position + _preview(params, v, params.preview_feedforward)
    kappa_ff = mean_curvature(path, ahead, window)
    ahead = point.position + _preview(params, v, params.preview_feedback)
    kappa_fb = mean_curvature(path, ahead, window)
    wheelbase = vehicle.front_axle + vehicle.rear_axle
    front = cornering_slip(params, vehicle, v * v * kappa_ff, False)
    rear = cornering_slip(params, vehicle, v * v * kappa_ff, True)
    feedforward = wheelbase * kappa_ff + front - rear
    rear_fb = cornering_slip(params, vehicle, v * v * kappa_fb, True)
    side_slip = vehicle.rear_axle * kappa_fb - rear_fb + params.reference_ahead * kappa_fb
    feedback = stanley(params.gain, params.softening, cross_track_error, heading_error - side_slip, v)
    return feedforward + feedback + params.yaw_damping * (kappa_fb * v - state.yaw_rate)


@njit
def aided(params, network, vehicle, memory, state, cross_track_error, heading_error, law, period):
    """Steering command of any law with the network beside it, within the tires' reach.

    Args:
        params: SteeringParams (learning, guards and limits are used).
        network: EmranMemory with 4 inputs, changed in place.
        vehicle: VehicleParams the law believes in.
        memory: SteeringMemory of the last call.
        state: VehicleState (speeds, yaw rate and steering angle are used).
        cross_track_error, heading_error: at the center of gravity, path minus vehicle [m], [rad]; the network learns
            at the point `reference_ahead` of it.
        law: road-wheel angle [rad] the law alone asks for.
        period: control period [s].

    Returns:
        (SteeringCommand, SteeringMemory)
    """
    emran = params.emran
    a = params.reference_ahead
    cross_track = cross_track_error + a * math.sin(heading_error)
    v = state.speed_long
    safe = max(v, 0.1)
    course = math.atan2(state.speed_lat + a * state.yaw_rate, safe)
    signal = stanley(params.gain, params.softening, cross_track, heading_error - course, v)
    front, slip = _slip(vehicle, state)
    learned, smoothed, part = False, 0.0, 0.0
    if emran.authority > 0.0:
        inputs = np.empty(INPUTS)
        inputs[0] = params.cross_track_scale * cross_track
        inputs[1] = params.heading_scale * heading_error
        inputs[2] = params.speed_lat_scale * state.speed_lat
        inputs[3] = params.yaw_rate_scale * state.yaw_rate
        learned = _learn(params, network, inputs, signal, slip, v, period)
        output = predict(emran, network, inputs)
        prune(emran, network, inputs)
        smoothed = memory.smoothed + params.smoothing * (output - memory.smoothed)
        part = emran.authority * min(max(2.0 - slip / params.guard, 0.0), 1.0) * smoothed
    total = law + part
    # beyond the peak of the tire more steering gives less force
    total = min(max(total, front - params.slip_limit), front + params.slip_limit)
    memory = SteeringMemory(smoothed, memory.hoffmann, memory.adrc, memory.lqr, memory.t2fnn)
    return SteeringCommand(_limited(vehicle, total), law, part, signal, learned), memory


@njit
def _learn(params, network, inputs, signal, slip, speed, period):
    """One sample, unless the tires slide (then the weights decay), the car stands or the output is saturated."""
    emran = params.emran
    if slip > params.guard:
        fade(network, 1.0 - params.guard_decay * period, True)
        return False
    if speed < LEARNING_SPEED:
        return False
    output = predict(emran, network, inputs)
    if abs(output) >= emran.output_max and output * signal > 0.0:
        return False
    scale = (10.0 / max(speed, SLOWEST_SCALED)) ** params.rate_exponent
    learned = learn(emran, network, inputs, signal, scale, period)
    if learned:
        learn_bias(emran, network, signal, 1.0, period)
    fade(network, 1.0 - emran.leak * period, False)
    return learned


@njit
def _limited(vehicle, angle):
    return min(max(angle, -vehicle.steer_limit), vehicle.steer_limit)
