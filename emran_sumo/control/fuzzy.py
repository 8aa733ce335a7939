"""EKF-T2FNN, a reconstruction: PID with the gains of a type-2 fuzzy network that an EKF trains, and an observer."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.control.bicycle import bicycle
from emran_sumo.kernels import njit
from emran_sumo.plant.tire import axle_stiffness
from emran_sumo.units import Unit

SETS = 5  # per input, with centers from -1 to 1
RULES = SETS * SETS
CELLS = 3  # centers of the observer's network per input: side speed, yaw rate, road-wheel angle
NEURONS = CELLS**3
SLOWEST = 2.0  # m/s: below it nothing is learned, integrated or observed


class FuzzyParams(NamedTuple):
    """PID on s = e_y + lookahead e_psi, e_psi beyond the side slip of the bend, whose gains are trained.

    K_P, K_I, K_D: initial values of all rules.

    cross_track_span, heading_span: errors at the outermost fuzzy sets; width and blur: standard deviation of the sets
    and half of the range of their means, both in spans.  variance, drift, noise: P_0, Q, R of the filter; teaching:
    learning signal per s; gain_range: trained gains stay within the initial ones over and times this.
    integral_max: bound of the integral's part.  observer: L; neuron_variance, neuron_drift: P_0 and Q of its network;
    disturbance_max: bound of the angle against the disturbance it finds.
    """

    lookahead: Annotated[float, Field(ge=0, le=50), Unit("m")] = 4.0
    K_P: Annotated[float, Field(ge=0, le=10), Unit("rad/m")] = 0.15
    K_I: Annotated[float, Field(ge=0, le=10), Unit("rad/(m s)")] = 0.05
    K_D: Annotated[float, Field(ge=0, le=10), Unit("rad s/m")] = 0.03
    cross_track_span: Annotated[float, Field(gt=0, le=10), Unit("m")] = 0.3
    heading_span: Annotated[float, Field(gt=0, le=1), Unit("rad")] = 0.1
    width: Annotated[float, Field(gt=0, le=2), Unit("-")] = 0.25
    blur: Annotated[float, Field(ge=0, le=0.5), Unit("-")] = 0.15
    variance: Annotated[float, Field(ge=0, le=1e6), Unit("-")] = 1.0
    drift: Annotated[float, Field(ge=0, le=1e3), Unit("-")] = 1e-4
    noise: Annotated[float, Field(gt=0, le=1e6), Unit("-")] = 10.0
    teaching: Annotated[float, Field(ge=0, le=10), Unit("rad/m")] = 0.1
    gain_range: Annotated[float, Field(ge=1, le=10), Unit("-")] = 2.0
    integral_max: Annotated[float, Field(ge=0, le=0.6), Unit("rad")] = 0.05
    observer: Annotated[float, Field(gt=0, le=50), Unit("1/s")] = 10.0
    neuron_variance: Annotated[float, Field(ge=0, le=1e6), Unit("-")] = 1.0
    neuron_drift: Annotated[float, Field(ge=0, le=1e3), Unit("-")] = 1e-3
    disturbance_max: Annotated[float, Field(ge=0, le=0.6), Unit("rad")] = 0.05


class FuzzyMemory(NamedTuple):
    """integral of s [m s]; estimated side speed [m/s] and yaw rate [rad/s]; arrays changed in place.

    gains (RULES, 3): K_P, K_I, K_D of each rule; covariance (RULES, 3, 3) of them; weights (NEURONS, 2) of the
    observer's network for dv_y/dt [m/s2] and dr/dt [rad/s2]; weight_covariance (NEURONS, NEURONS).
    """

    integral: float
    speed_lat: float
    yaw_rate: float
    gains: np.ndarray
    covariance: np.ndarray
    weights: np.ndarray
    weight_covariance: np.ndarray


def blank_fuzzy(params: FuzzyParams) -> FuzzyMemory:
    """Memory of an untrained law."""
    return FuzzyMemory(
        0.0,
        0.0,
        0.0,
        np.tile((params.K_P, params.K_I, params.K_D), (RULES, 1)),
        np.tile(params.variance * np.eye(3), (RULES, 1, 1)),
        np.zeros((NEURONS, 2)),
        params.neuron_variance * np.eye(NEURONS),
    )


@njit
def membership(x, center, width, blur):
    """Upper and lower membership of x in a Gaussian set whose mean lies somewhere in center +- blur.

    upper = 1 between the means, else that of the nearer mean;  lower = that of the farther mean
    """
    off = abs(x - center)
    near, far = max(off - blur, 0.0) / width, (off + blur) / width
    return math.exp(-0.5 * near * near), math.exp(-0.5 * far * far)


@njit
def firing(params, cross_track_error, heading_error, out):
    """Normalized firing of the rules, written to `out` (RULES,): product of sets, mean of upper and lower (Nie-Tan)."""
    x = min(max(cross_track_error / params.cross_track_span, -1.0), 1.0)
    y = min(max(heading_error / params.heading_span, -1.0), 1.0)
    total = 0.0
    for i in range(SETS):
        upper_x, lower_x = membership(x, 2.0 * i / (SETS - 1.0) - 1.0, params.width, params.blur)
        for j in range(SETS):
            upper_y, lower_y = membership(y, 2.0 * j / (SETS - 1.0) - 1.0, params.width, params.blur)
            fired = 0.5 * (upper_x * upper_y + lower_x * lower_y)
            out[i * SETS + j] = fired
            total += fired
    for i in range(RULES):
        out[i] /= total


@njit
def train(params, memory, fired, parts, signal):
    """Correct the gains of all rules by an extended Kalman filter, each rule with a covariance of its own.

        B_i = phi_i [s, int s, ds/dt],   S = R + sum_i B_i' P_i B_i,   K_i = P_i B_i / S

    Args:
        params: FuzzyParams.
        memory: FuzzyMemory, changed in place.
        fired: phi (RULES,).
        parts: (3,) what the gains multiply.
        signal: what the output should have been larger by [rad].

    Source: decoupled extended Kalman filter, Puskorius and Feldkamp 1991.
    """
    b, pb = np.empty(3), np.empty((RULES, 3))
    s = params.noise
    for r in range(RULES):
        for i in range(3):
            b[i] = fired[r] * parts[i]
        for i in range(3):
            pb[r, i] = 0.0
            for j in range(3):
                pb[r, i] += memory.covariance[r, i, j] * b[j]
            s += b[i] * pb[r, i]
    first = (params.K_P, params.K_I, params.K_D)
    for r in range(RULES):
        for i in range(3):
            gain = memory.gains[r, i] + pb[r, i] / s * signal
            memory.gains[r, i] = min(max(gain, first[i] / params.gain_range), first[i] * params.gain_range)
            for j in range(3):
                memory.covariance[r, i, j] -= pb[r, i] * pb[r, j] / s
            variance = memory.covariance[r, i, i] + params.drift
            memory.covariance[r, i, i] = min(variance, max(params.variance, params.drift))


@njit
def _cells(state, out):
    """Response of the observer's network (NEURONS,) to side speed, yaw rate and road-wheel angle."""
    place = (state.speed_lat / 0.5, state.yaw_rate / 0.4, state.steer / 0.1)
    for i in range(CELLS):
        for j in range(CELLS):
            for k in range(CELLS):
                d2 = (place[0] - i + 1.0) ** 2 + (place[1] - j + 1.0) ** 2 + (place[2] - k + 1.0) ** 2
                out[(i * CELLS + j) * CELLS + k] = math.exp(-0.5 * d2)


@njit
def observe(params, memory, vehicle, state, period):
    """Linear bicycle with a network for what it misses, corrected by the measured side speed and yaw rate.

        dx/dt = A x + B delta + W' phi + L (y - x),   W trained by a Kalman filter on (y - x) with B = phi / L

    Args:
        params: FuzzyParams.
        memory: FuzzyMemory; its arrays are changed in place.
        vehicle: VehicleParams the law believes in.
        state: VehicleState, measured.
        period: control period [s].

    Returns:
        (side speed [m/s] and yaw rate [rad/s] estimated for the next call, acceleration to the left [m/s2] that the
        bicycle misses)
    """
    phi, pb = np.empty(NEURONS), np.empty(NEURONS)
    _cells(state, phi)
    miss_lat, miss_yaw = 0.0, 0.0
    for i in range(NEURONS):
        miss_lat += memory.weights[i, 0] * phi[i]
        miss_yaw += memory.weights[i, 1] * phi[i]
    error_lat, error_yaw = state.speed_lat - memory.speed_lat, state.yaw_rate - memory.yaw_rate
    s = 1.0
    for i in range(NEURONS):
        pb[i] = 0.0
        for j in range(NEURONS):
            pb[i] += memory.weight_covariance[i, j] * phi[j] / params.observer
        s += phi[i] / params.observer * pb[i]
    for i in range(NEURONS):
        memory.weights[i, 0] += pb[i] / s * error_lat
        memory.weights[i, 1] += pb[i] / s * error_yaw
        for j in range(NEURONS):
            memory.weight_covariance[i, j] -= pb[i] * pb[j] / s
        variance = memory.weight_covariance[i, i] + params.neuron_drift
        memory.weight_covariance[i, i] = min(variance, max(params.neuron_variance, params.neuron_drift))
    car = bicycle(vehicle, state.speed_long)
    v, r = state.speed_lat, state.yaw_rate
    rate_lat = car.lat_lat * v + car.lat_yaw * r + car.lat_steer * state.steer + miss_lat
    rate_yaw = car.yaw_lat * v + car.yaw_yaw * r + car.yaw_steer * state.steer + miss_yaw
    next_lat = memory.speed_lat + period * (rate_lat + params.observer * error_lat)
    next_yaw = memory.yaw_rate + period * (rate_yaw + params.observer * error_yaw)
    return next_lat, next_yaw, miss_lat


@njit
def fuzzy_pid(params, memory, vehicle, state, cross_track_error, heading_error, curvature, slip, guard, period):
    """PID on s with the gains of the fuzzy network, beside the bend's angle and the one against what was observed.

        s = e_y + c (e_psi + atan(l_r kappa))
        delta = atan(L kappa) + sum_i phi_i (K_P,i s + K_I,i int s + K_D,i ds/dt) - m / C_f W_1' phi

    Args:
        params: FuzzyParams.
        memory: FuzzyMemory of the last call; its arrays are changed in place.
        vehicle: VehicleParams the law believes in.
        state: VehicleState (speeds, yaw rate and measured steering angle are used).
        cross_track_error, heading_error: at the center of gravity, path minus vehicle [m], [rad].
        curvature: kappa [1/m] of the path there.
        slip, guard: largest slip angle of the axles and the one [rad] beyond which nothing is learned.
        period: control period [s].

    Returns:
        (road-wheel angle [rad], not yet limited; FuzzyMemory)

    Source: a reconstruction from the description "type-2 fuzzy neural PID with an EKF-based adaptive observer"
    (Taghavifar, Hu, Qin, Wei 2020); neither structure nor gains of the original are known here.  Differs: the
    angle and the side slip of a bend without tire slip are added, without which a PID on errors cannot take a town's
    corner.
    """
    v = max(state.speed_long, 0.0)
    fired, parts = np.empty(RULES), np.empty(3)
    beyond = heading_error + math.atan(vehicle.rear_axle * curvature)
    firing(params, cross_track_error, beyond, fired)
    c = params.lookahead
    parts[0] = cross_track_error + c * beyond
    parts[2] = v * math.sin(heading_error) - state.speed_lat * math.cos(heading_error)
    parts[2] += c * (v * curvature - state.yaw_rate)
    parts[1] = memory.integral
    moving = v > SLOWEST and slip < guard
    if moving:
        bound = params.integral_max / max(params.K_I, 1e-9)
        parts[1] = min(max(memory.integral + period * parts[0], -bound), bound)
        train(params, memory, fired, parts, params.teaching * parts[0])
    wheelbase = vehicle.front_axle + vehicle.rear_axle
    angle = math.atan(wheelbase * curvature)
    for r in range(RULES):
        for i in range(3):
            angle += fired[r] * memory.gains[r, i] * parts[i]
    side, turn, miss = state.speed_lat, state.yaw_rate, 0.0
    if moving:
        side, turn, miss = observe(params, memory, vehicle, state, period)
    against = vehicle.mass / axle_stiffness(vehicle.tire, False) * miss
    angle -= min(max(against, -params.disturbance_max), params.disturbance_max)
    return angle, FuzzyMemory(
        parts[1], side, turn, memory.gains, memory.covariance, memory.weights, memory.weight_covariance
    )
