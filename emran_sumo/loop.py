"""The closed loop on one screen: path and speed reference -> law + network -> plant -> trace."""

import math
from collections import namedtuple
from typing import NamedTuple

import numpy as np

from emran_sumo.control.cruise import INPUTS as CRUISE_INPUTS
from emran_sumo.control.cruise import (
    CruiseMemory,
    CruiseParams,
    Motion,
    cruise,
    resistance,
    rolling_memory,
)
from emran_sumo.control.emran import (
    GROWN,
    LEARNED,
    MERGED,
    NEURONS,
    PRUNED,
    EmranMemory,
    blank_memory,
)
from emran_sumo.control.steering import INPUTS as STEERING_INPUTS
from emran_sumo.control.steering import SteeringMemory, SteeringParams, blank_steering, track
from emran_sumo.kernels import njit
from emran_sumo.path import Path, interpolate, nearest, path_length, point_at, tracking_errors
from emran_sumo.plant.disturbance import environment
from emran_sumo.plant.sensors import CHANNELS, SensorParams, measured_state
from emran_sumo.plant.vehicle import Actuation, VehicleParams, VehicleState, forces, step

RUNNING, DIVERGED, PATH_ENDED = range(3)
STATUS = ("running", "diverged", "path ended")
LOST_CROSS_TRACK = 6.0  # m: almost two lanes beside the path the controller has lost the car
LOST_HEADING = 1.4  # rad
DELAYS = 16  # longest command delay, in control periods, plus one

TRACE = (
    "time", "x", "y", "yaw", "speed_long", "speed_lat", "yaw_rate", "accel_long", "accel_lat",
    "steer", "steer_command", "steer_law", "steer_network",
    "accel_command", "accel_law", "accel_network", "torque",
    "wheel_speed_front", "wheel_speed_rear", "slip_ratio_front", "slip_ratio_rear",
    "slip_angle_front", "slip_angle_rear", "force_long_front", "force_long_rear",
    "force_lat_front", "force_lat_rear", "load_front", "load_rear",
    "friction", "friction_use_front", "friction_use_rear", "grade", "force_external_lat",
    "speed_reference", "accel_reference", "speed_error",
    "path_position", "reference_x", "reference_y", "reference_yaw", "reference_curvature",
    "cross_track_error", "heading_error",
    "neurons_speed", "neurons_steering", "signal_speed", "signal_steering",
    "learned_speed", "learned_steering", "grown_speed", "grown_steering",
    "pruned_speed", "pruned_steering", "merged_speed", "merged_steering",
)  # fmt: skip
WIDTH = len(TRACE)
AT = namedtuple("Column", TRACE)(*range(WIDTH))  # AT.time is the place of "time" in a row


class ControlParams(NamedTuple):
    """Both halves of the coupled controller, and what they see through; kernels want the `compiled_view` of it."""

    longitudinal: CruiseParams = CruiseParams()
    lateral: SteeringParams = SteeringParams()
    sensors: SensorParams = SensorParams()


class Networks(NamedTuple):
    """What the two networks of one ego have learned; arrays changed in place."""

    speed: EmranMemory
    steering: EmranMemory


class LoopState(NamedTuple):
    """Everything of one ego that the next control step needs, besides its networks.

    position: of the point of the driven path nearest to the car [m]; pending: (DELAYS, 2) commands [rad], [N m] on
    their way to the actuators, a ring by tick.
    """

    vehicle: VehicleState
    cruise: CruiseMemory
    steering: SteeringMemory
    position: float
    pending: np.ndarray


class Clock(NamedTuple):
    """Integer time: `tick` counts control periods; `period` [s] holds `substeps` plant steps of `plant_step` [s].

    delay: control periods that a command needs to reach the actuators, below DELAYS.
    """

    tick: int
    period: float
    substeps: int
    plant_step: float
    delay: int = 0


class Seen(NamedTuple):
    """What a controller is told: the measured state, the errors [m], [rad] of its center of gravity, and Motion."""

    car: VehicleState
    cross_track_error: float
    heading_error: float
    motion: Motion


class References(NamedTuple):
    """What to follow and what disturbs the view over n control periods.

    path: Path that the errors of the trace refer to; driven: Path that the controller follows, the same or a
    conditioned one; speeds: (n + 1,) speed reference [m/s] at the borders of the periods; accels: (n,) acceleration
    reference [m/s2] within each; noise: (n, CHANNELS) standard normal numbers; origin: position [m] along the road of
    the path's first point, for disturbances that lie at places and for the trace.
    """

    path: Path
    driven: Path
    speeds: np.ndarray
    accels: np.ndarray
    noise: np.ndarray
    origin: float


def blank_networks(params: ControlParams) -> Networks:
    """Two empty networks."""
    return Networks(
        blank_memory(params.longitudinal.emran, CRUISE_INPUTS),
        blank_memory(params.lateral.emran, STEERING_INPUTS),
    )


def start(
    vehicle: VehicleParams,
    longitudinal: CruiseParams,
    lateral: SteeringParams,
    state: VehicleState,
    position: float,
    period: float,
) -> LoopState:
    """State of a loop that takes over a rolling vehicle: the plain PID starts at the trim of drag and rolling.

    Args:
        vehicle: VehicleParams the laws believe in.
        longitudinal, lateral: CruiseParams, SteeringParams.
        state: VehicleState at the take-over.
        position: of the nearest point of the driven path [m].
        period: control period [s].
    """
    achieved = state.torque / (vehicle.wheel_radius * vehicle.mass)
    trim = 0.0 if longitudinal.feedforward else float(resistance(vehicle, state.speed_long))
    motion = Motion(state.speed_long, state.accel_long, 0.0, achieved, position)
    pending = np.tile((state.steer, state.torque), (DELAYS, 1))
    cruise = rolling_memory(state.speed_long, motion, trim)
    return LoopState(state, cruise, blank_steering(lateral, vehicle, state, period), position, pending)


def quiet_references(path: Path, speeds: np.ndarray, accels: np.ndarray) -> References:
    """References without noise and without conditioning."""
    return References(path, path, speeds, accels, np.zeros((accels.size, CHANNELS)), 0.0)


@njit
def closed_loop(vehicle, control, disturbance, friction, clock, references, state, speed_net, steering_net, trace):
    """Drive `references.accels.size` control periods and write one row of `trace` at the end of each.

    Args:
        vehicle: VehicleParams; control: ControlParams; disturbance: DisturbanceParams.
        friction: of the road [-].
        clock: Clock of the first period.
        references: References.
        state: LoopState.
        speed_net, steering_net: EmranMemory, changed in place.
        trace: (n, WIDTH) rows, columns named by TRACE.

    Returns:
        (LoopState, status, rows written); status is RUNNING, DIVERGED or PATH_ENDED.
    """
    car, cruise_memory, steering_memory = state.vehicle, state.cruise, state.steering
    pending = state.pending.copy()
    period, periods, path = clock.period, references.accels.size, references.driven
    point = point_at(path, state.position)
    for k in range(periods):
        time = (clock.tick + k) * period
        seen = sense(
            vehicle, control.sensors, disturbance, friction, path, references.origin, references.noise[k],
            time, car, point,
        )  # fmt: skip
        push, cruise_memory = cruise(
            control.longitudinal, speed_net, vehicle, cruise_memory, seen.motion,
            references.speeds[k], references.accels[k], period,
        )  # fmt: skip
        turn, steering_memory = track(
            control.lateral, steering_net, vehicle, steering_memory, seen.car, path, point,
            seen.cross_track_error, seen.heading_error, period,
        )  # fmt: skip
        car, point, status = act(
            vehicle, disturbance, friction, clock, references, k, pending, car, point, turn, push,
            speed_net, steering_net, trace[k],
        )  # fmt: skip
        state = LoopState(car, cruise_memory, steering_memory, point.position, pending)
        if status != RUNNING:
            return state, status, k + 1
    return state, RUNNING, periods


@njit
def sense(vehicle, sensors, disturbance, friction, path, origin, noise, time, car, point):
    """What the controller is told of a car at `time` [s], `point` of the driven `path` being nearest to it: Seen."""
    env = _environment(disturbance, friction, path, time, point.position, origin, car.speed_long)
    seen = measured_state(sensors, noise, car, point.yaw)
    cross_track, heading = tracking_errors(point, seen.x, seen.y, seen.yaw)
    return Seen(seen, cross_track, heading, _motion(vehicle, sensors, noise, car, seen, env, point.position))


@njit
def act(
    vehicle, disturbance, friction, clock, references, k, pending, car, point, turn, push, speed_net, steering_net, row
):
    """Let the car answer what is asked of it in period `k` of the references, and write the row of its end.

    Args:
        turn: SteeringCommand; push: CruiseCommand.
        pending: (DELAYS, 2) ring of commands, changed in place.
        others: as in `closed_loop`; `clock` is that of period 0.

    Returns:
        (VehicleState, Point of the driven path, status)
    """
    path, period = references.driven, clock.period
    tick = clock.tick + k
    time = tick * period
    pending[tick % DELAYS, 0] = turn.angle
    pending[tick % DELAYS, 1] = vehicle.mass * vehicle.wheel_radius * push.accel
    arrived = (tick - clock.delay) % DELAYS
    actuation = Actuation(pending[arrived, 0], pending[arrived, 1])
    for j in range(clock.substeps):
        now = time + j * clock.plant_step
        travelled = point.position + car.speed_long * j * clock.plant_step
        env = _environment(disturbance, friction, path, now, travelled, references.origin, car.speed_long)
        car = step(vehicle, car, actuation, env, clock.plant_step)
    point = nearest(path, car.x, car.y, point.position + car.speed_long * period)
    row[AT.time] = (tick + 1) * period
    _write_car(row, vehicle, car, env)
    _write_control(row, turn, push)
    shown = nearest(references.path, car.x, car.y, point.position)
    _write_reference(row, car, shown, references, k)
    _write_networks(row, push, turn, speed_net, steering_net)
    if _lost(row[AT.cross_track_error], row[AT.heading_error], car):
        return car, point, DIVERGED
    if point.position >= path_length(path) - 1e-6:
        return car, point, PATH_ENDED
    return car, point, RUNNING


@njit
def _environment(disturbance, friction, path, time, position, origin, speed):
    grade = interpolate(path.grade, path, position)
    slope = (interpolate(path.grade, path, position + path.spacing) - grade) / path.spacing
    return environment(disturbance, friction, grade, slope, time, position + origin, speed)


@njit
def _motion(vehicle, sensors, noise, car, seen, env, position):
    """What the longitudinal sensors say; the centripetal part of the accelerometer is known from the side speed."""
    f = forces(vehicle, car, env)
    achieved = car.torque / (vehicle.wheel_radius * vehicle.mass)
    specific_force = f.accel_long + seen.speed_lat * seen.yaw_rate + sensors.accel * noise[5]
    pitch_rate = env.pitch_rate + sensors.pitch_rate * noise[6] + sensors.pitch_rate_bias
    return Motion(seen.speed_long, specific_force, pitch_rate, achieved, position)


@njit
def _lost(cross_track, heading, car):
    finite = math.isfinite(car.x + car.y + car.yaw + car.speed_long + car.speed_lat + car.yaw_rate)
    return not finite or abs(cross_track) > LOST_CROSS_TRACK or abs(heading) > LOST_HEADING


@njit
def _write_car(row, vehicle, car, env):
    f = forces(vehicle, car, env)
    row[AT.x], row[AT.y], row[AT.yaw] = car.x, car.y, car.yaw
    row[AT.speed_long], row[AT.speed_lat], row[AT.yaw_rate] = car.speed_long, car.speed_lat, car.yaw_rate
    row[AT.accel_long], row[AT.accel_lat] = f.accel_long, f.accel_lat
    row[AT.steer] = car.steer
    row[AT.torque] = car.torque
    row[AT.wheel_speed_front], row[AT.wheel_speed_rear] = car.wheel_speed_front, car.wheel_speed_rear
    row[AT.slip_ratio_front], row[AT.slip_ratio_rear] = f.slip_ratio_front, f.slip_ratio_rear
    row[AT.slip_angle_front], row[AT.slip_angle_rear] = f.slip_angle_front, f.slip_angle_rear
    row[AT.force_long_front], row[AT.force_long_rear] = f.force_long_front, f.force_long_rear
    row[AT.force_lat_front], row[AT.force_lat_rear] = f.force_lat_front, f.force_lat_rear
    row[AT.load_front], row[AT.load_rear] = f.load_front, f.load_rear
    row[AT.friction] = env.friction
    row[AT.friction_use_front], row[AT.friction_use_rear] = f.friction_use_front, f.friction_use_rear
    row[AT.grade], row[AT.force_external_lat] = env.grade, env.force_lat


@njit
def _write_control(row, turn, push):
    row[AT.steer_command], row[AT.steer_law], row[AT.steer_network] = turn.angle, turn.law, turn.network
    row[AT.accel_command], row[AT.accel_law], row[AT.accel_network] = push.accel, push.law, push.network


@njit
def _write_reference(row, car, point, references, k):
    cross_track, heading = tracking_errors(point, car.x, car.y, car.yaw)
    speed, accel = references.speeds[k + 1], references.accels[k]
    row[AT.speed_reference], row[AT.accel_reference], row[AT.speed_error] = (
        speed,
        accel,
        speed - car.speed_long,
    )
    row[AT.path_position] = point.position + references.origin
    row[AT.reference_x], row[AT.reference_y] = point.x, point.y
    row[AT.reference_yaw], row[AT.reference_curvature] = point.yaw, point.curvature
    row[AT.cross_track_error], row[AT.heading_error] = cross_track, heading


@njit
def _write_networks(row, push, turn, speed_net, steering_net):
    row[AT.signal_speed], row[AT.signal_steering] = push.signal, turn.signal
    a, b = speed_net.counts, steering_net.counts
    row[AT.neurons_speed], row[AT.neurons_steering] = a[NEURONS], b[NEURONS]
    row[AT.learned_speed], row[AT.learned_steering] = a[LEARNED], b[LEARNED]
    row[AT.grown_speed], row[AT.grown_steering] = a[GROWN], b[GROWN]
    row[AT.pruned_speed], row[AT.pruned_steering] = a[PRUNED], b[PRUNED]
    row[AT.merged_speed], row[AT.merged_steering] = a[MERGED], b[MERGED]


def new_trace(rows: int) -> np.ndarray:
    """Empty trace of `rows` control periods."""
    return np.zeros((rows, WIDTH))
