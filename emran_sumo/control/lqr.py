"""LQR path tracking with curvature feed-forward, and with preview of the curvature ahead."""

import math
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.control.bicycle import bicycle, steady_turn
from emran_sumo.kernels import njit
from emran_sumo.path import interpolate
from emran_sumo.plant.records import VehicleParams
from emran_sumo.units import Unit

STATES = 5  # cross-track offset, side speed, heading, yaw rate, road-wheel angle
SLOWEST, FASTEST, SPACING = 1.0, 46.0, 0.5  # m/s: speeds of the table of gains
OFFSET_ACCEL = 4.0  # m/s2: lateral acceleration that an offset from the path may ask for
DOUBLINGS = 30  # at most; 2^30 steps of the Riccati recursion


class LqrParams(NamedTuple):
    """Weights of the quadratic cost; the road-wheel angle that is asked beyond that of the bend costs 1 / rad^2.

    cross_track_rate is the weight of the speed across the path, yaw_rate that of the yaw rate beyond the bend's.
    """

    cross_track: Annotated[float, Field(gt=0, le=1000), Unit("1/m^2")] = 2.8684
    cross_track_rate: Annotated[float, Field(ge=0, le=1000), Unit("s^2/m^2")] = 0.015353
    heading: Annotated[float, Field(ge=0, le=1000), Unit("1/rad^2")] = 0.011061
    yaw_rate: Annotated[float, Field(ge=0, le=1000), Unit("s^2/rad^2")] = 0.070803


class LqPreviewParams(NamedTuple):
    """The weights of LqrParams, and how far ahead the curvature is seen."""

    cross_track: Annotated[float, Field(gt=0, le=1000), Unit("1/m^2")] = 1.9987
    cross_track_rate: Annotated[float, Field(ge=0, le=1000), Unit("s^2/m^2")] = 0.0010023
    heading: Annotated[float, Field(ge=0, le=1000), Unit("1/rad^2")] = 0.010002
    yaw_rate: Annotated[float, Field(ge=0, le=1000), Unit("s^2/rad^2")] = 0.0010023
    horizon: Annotated[float, Field(ge=0, le=3), Unit("s")] = 1.0


class LqrGains(NamedTuple):
    """Gains at m speeds from SLOWEST in steps of SPACING: feedback (m, STATES); preview (m, n) on the change of
    curvature [1/m] in each of the next n control periods, n = 0 without preview."""

    feedback: np.ndarray
    preview: np.ndarray


@njit
def lqr(gains, vehicle, state, path, position, cross_track_error, heading_error, curvature, period):
    """Angle of the bend, feedback of what differs from its steady state, and what the bends ahead ask already now.

        delta = D kappa - K (x - X kappa) + sum_j g_j (kappa_j+1 - kappa_j),   x = [e_1, v_y, e_2, r, delta]

    D kappa and X kappa are road-wheel angle and state of the steady bend; e_1, e_2 are position and heading, vehicle
    minus path.

    Args:
        gains: LqrGains.
        vehicle: VehicleParams the law believes in.
        state: VehicleState (speeds, yaw rate and measured steering angle are used).
        path, position: Path and the place [m] on it nearest to the center of gravity.
        cross_track_error, heading_error: at the center of gravity, path minus vehicle [m], [rad].
        curvature: kappa [1/m] at `position`.
        period: control period [s].

    Returns:
        Road-wheel angle [rad], not yet limited.

    Source: Rajamani, chapter 3, in measured states in place of error rates (no derivative of the curvature is left
    out); preview: Tomizuka 1976.  Differs: below 1 m/s the gains are those of 1 m/s; an offset counts no more than
    an angle that turns the car with 4 m/s2, or a car beside the path at speed would steer faster than it can.
    """
    v = max(state.speed_long, 0.0)
    side_slip, angle = steady_turn(vehicle, v)
    row = min(max((v - SLOWEST) / SPACING, 0.0), gains.feedback.shape[0] - 1.000001)
    i = int(row)
    f = row - i
    gain = gains.feedback[i, 0] + f * (gains.feedback[i + 1, 0] - gains.feedback[i, 0])
    most = OFFSET_ACCEL * angle / max(v * v, 1.0) / gain
    deviation = (
        min(max(-cross_track_error, -most), most),
        state.speed_lat - v * side_slip * curvature,
        -heading_error + side_slip * curvature,
        state.yaw_rate - v * curvature,
        state.steer - angle * curvature,
    )
    total = angle * curvature
    for k in range(STATES):
        gain = gains.feedback[i, k] + f * (gains.feedback[i + 1, k] - gains.feedback[i, k])
        total -= gain * deviation[k]
    here = curvature
    for j in range(gains.preview.shape[1]):
        ahead = interpolate(path.curvature, path, position + (j + 1) * period * v)
        gain = gains.preview[i, j] + f * (gains.preview[i + 1, j] - gains.preview[i, j])
        total += gain * (ahead - here)
        here = ahead
    return total


def lqr_gains(params: LqrParams | LqPreviewParams, vehicle: VehicleParams, period: float) -> LqrGains:
    """Gains for the car the law believes in, at all speeds of the table.

    Args:
        params: LqrParams, or LqPreviewParams for gains with preview.
        vehicle: VehicleParams.
        period: control period [s].
    """
    horizon = round(params.horizon / period) if isinstance(params, LqPreviewParams) else 0
    return _gains(tuple(params[:4]), horizon, vehicle, period)


@lru_cache(maxsize=8)
def _gains(weights: tuple[float, ...], horizon: int, vehicle: VehicleParams, period: float) -> LqrGains:
    speeds = np.arange(SLOWEST, FASTEST + 0.5 * SPACING, SPACING)
    models = [error_model(vehicle, float(v)) for v in speeds]
    transition, entry = zero_order_hold(np.array([a for a, _ in models]), np.array([b for _, b in models]), period)
    cost = np.array([_cost(weights, float(v)) for v in speeds])
    value = riccati(transition, entry, cost)
    back = entry.transpose(0, 2, 1)
    scale = 1.0 + back @ value @ entry
    feedback = back @ value @ transition / scale
    steady = np.array([_steady_state(vehicle, float(v)) for v in speeds])[:, :, None]
    closed = (transition - entry @ feedback).transpose(0, 2, 1)
    preview, carried = np.empty((speeds.size, horizon)), value @ steady
    for j in range(horizon):
        preview[:, j] = (back @ carried / scale)[:, 0, 0]
        carried = closed @ carried
    return LqrGains(np.ascontiguousarray(feedback[:, 0, :]), preview)


def error_model(vehicle: VehicleParams, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """A (5, 5) and B (5, 1) of dx/dt = A x + B u on a straight path, x as in `lqr`, u the angle that is asked."""
    car = bicycle(vehicle, speed)
    lag = vehicle.steer_lag
    a = np.array([
        [0.0, 1.0, speed, 0.0, 0.0],
        [0.0, car.lat_lat, 0.0, car.lat_yaw, car.lat_steer],
        [0.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, car.yaw_lat, 0.0, car.yaw_yaw, car.yaw_steer],
        [0.0, 0.0, 0.0, 0.0, -1.0 / lag],
    ])  # fmt: skip
    return a, np.array([[0.0], [0.0], [0.0], [0.0], [1.0 / lag]])


def _cost(weights: tuple[float, ...], speed: float) -> np.ndarray:
    """Q (5, 5) of the cost x' Q x."""
    outputs = np.zeros((4, STATES))
    outputs[0, 0] = 1.0
    outputs[1, 1], outputs[1, 2] = 1.0, speed  # speed across the path
    outputs[2, 2] = outputs[3, 3] = 1.0
    return outputs.T @ np.diag(weights) @ outputs


def _steady_state(vehicle: VehicleParams, speed: float) -> tuple[float, ...]:
    """X (5,): state of the steady bend per curvature."""
    side_slip, angle = steady_turn(vehicle, speed)
    return 0.0, speed * side_slip, -side_slip, speed, angle


def zero_order_hold(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Models a (m, n, n), b (m, n, 1) over one period [s] of constant input: the exponential of [[a, b], [0, 0]]."""
    n = a.shape[1]
    step = np.zeros((a.shape[0], n + 1, n + 1))
    step[:, :n, :n], step[:, :n, n:] = a * period, b * period
    halvings = max(0, math.ceil(math.log2(max(np.abs(step).sum(axis=2).max(), 1e-9)))) + 4
    step /= 2.0**halvings
    term = total = np.broadcast_to(np.eye(n + 1), step.shape)
    for k in range(1, 13):
        term = term @ step / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total[:, :n, :n], total[:, :n, n:]


def riccati(a: np.ndarray, b: np.ndarray, q: np.ndarray) -> np.ndarray:
    """P (m, n, n) of P = A' P A - A' P B (1 + B' P B)^-1 B' P A + Q, by doubling the horizon until nothing changes.

    Source: structure-preserving doubling, Chu, Fan, Lin, Wang 2004.
    """
    one = np.eye(a.shape[1])
    reach, value = b @ b.transpose(0, 2, 1), q
    for _ in range(DOUBLINGS):
        solved = np.linalg.solve(one + reach @ value, np.concatenate((a, reach), axis=2))
        n = a.shape[1]
        moved, spread = solved[:, :, :n], solved[:, :, n:]
        gained = a.transpose(0, 2, 1) @ value @ moved
        reach = reach + a @ spread @ a.transpose(0, 2, 1)
        a, value = a @ moved, value + gained
        if np.abs(gained).max() <= 1e-13 * np.abs(value).max():
            break
    return 0.5 * (value + value.transpose(0, 2, 1))
