"""The door for a controller of your own: the closed loop with a Python object in the place of the laws."""

import math
from numbers import Real
from typing import Any, NamedTuple, Protocol

import numpy as np

from emran_sumo.control.cruise import HOLD_SPEED, CruiseCommand, CruiseMemory, Motion, cruise, missing_accel, observe
from emran_sumo.control.steering import SteeringCommand, SteeringMemory, aided, track
from emran_sumo.faults import ControllerFault, defined_at, failed_at
from emran_sumo.kernels import njit
from emran_sumo.loop import RUNNING, ControlParams, LoopState, Networks, act, sense
from emran_sumo.path import Path, Point, interpolate, point_at
from emran_sumo.plant.records import GRAVITY
from emran_sumo.plant.vehicle import VehicleParams, VehicleState


class BuiltInParts(NamedTuple):
    """What the built-in laws need besides what they see: their parameters, networks, and memories at the take-over."""

    control: ControlParams
    networks: Networks
    cruise: CruiseMemory
    steering: SteeringMemory


class Observation(NamedTuple):
    """What a controller sees at the start of a control period.

    time [s] since the take-over; period [s] until the next call; car: VehicleState, measured at the center of gravity;
    cross_track_error [m], positive when the path lies to the left; heading_error [rad], path minus car; motion: Motion,
    the longitudinal sensors; speed_reference [m/s] and accel_reference [m/s2] wanted now; path: Path to follow; point:
    Point of it nearest to the car; vehicle: VehicleParams; built_in: BuiltInParts.
    """

    time: float
    period: float
    car: VehicleState
    cross_track_error: float
    heading_error: float
    motion: Motion
    speed_reference: float
    accel_reference: float
    path: Path
    point: Point
    vehicle: VehicleParams
    built_in: BuiltInParts

    @property
    def x(self) -> float:
        """East [m]."""
        return self.car.x

    @property
    def y(self) -> float:
        """North [m]."""
        return self.car.y

    @property
    def yaw(self) -> float:
        """Counter-clockwise from east [rad]."""
        return self.car.yaw

    @property
    def speed(self) -> float:
        """Along the body [m/s]."""
        return self.car.speed_long

    @property
    def speed_lat(self) -> float:
        """Across the body, left positive [m/s]."""
        return self.car.speed_lat

    @property
    def yaw_rate(self) -> float:
        """[rad/s]"""
        return self.car.yaw_rate

    @property
    def steer(self) -> float:
        """Road-wheel angle that the car has [rad]."""
        return self.car.steer

    @property
    def position(self) -> float:
        """Along the path [m]; jumps when the car is given another path, as for a lane change."""
        return self.point.position

    @property
    def curvature(self) -> float:
        """Of the path here [1/m], positive to the left."""
        return self.point.curvature

    @property
    def grade(self) -> float:
        """Of the road here, as the map has it [rad], positive uphill."""
        return float(interpolate(self.path.grade, self.path, self.point.position))

    def preview(self, distance: float) -> Point:
        """Point of the path `distance` [m] ahead of the nearest one; held at the end of the path."""
        return point_at(self.path, self.point.position + distance)


class Command(NamedTuple):
    """What a controller asks for until its next call.

    steer: road-wheel angle [rad], left positive; accel [m/s2] that the torque of the wheels alone would give: drag,
    rolling and grade come off it. A law that knows the parts of a command gives them for the trace; no network of the
    door is then added to that half.
    """

    steer: float
    accel: float
    steer_parts: SteeringCommand | None = None
    accel_parts: CruiseCommand | None = None


class Controller(Protocol):
    """A controller of one ego."""

    def reset(self) -> None:
        """The ego is taken over: forget everything."""

    def step(self, observation: Observation, /) -> Command | tuple[float, float]:
        """Command for the period that begins now."""
        ...


class BuiltIn:
    """The built-in coupled scheme as a controller of its own; take `steering` or `cruise` to write the other half."""

    def reset(self) -> None:
        """Begin anew with the memories of the next take-over."""
        self._cruise: CruiseMemory | None = None
        self._steering: SteeringMemory | None = None

    def step(self, observation: Observation) -> Command:
        """Both halves."""
        push, turn = self.cruise(observation), self.steering(observation)
        return Command(turn.angle, push.accel, turn, push)

    def cruise(self, o: Observation) -> CruiseCommand:
        """The longitudinal half, once per period."""
        push, self._cruise = cruise(
            o.built_in.control.longitudinal, o.built_in.networks.speed, o.vehicle, self._cruise or o.built_in.cruise,
            o.motion, o.speed_reference, o.accel_reference, o.period,
        )  # fmt: skip
        return push

    def steering(self, o: Observation) -> SteeringCommand:
        """The lateral half, once per period."""
        turn, self._steering = track(
            o.built_in.control.lateral, o.built_in.networks.steering, o.vehicle, self._steering or o.built_in.steering,
            o.car, o.path, o.point, o.cross_track_error, o.heading_error, o.period,
        )  # fmt: skip
        return turn


class OwnController:
    """A user's controller in the place of the laws of one ego.

    A fault of it does not raise in the middle of a step of the world: `fault` is set and the last command is held.

    Args:
        controller: object with reset() and step(observation).
        name: what the user calls it.

    Raises:
        ControllerFault: the object has no reset() and step(observation), or its reset fails.
    """

    def __init__(self, controller: Any, name: str) -> None:
        self.controller, self.name = controller, name
        self.fault: ControllerFault | None = None
        for wanted in ("reset", "step"):
            if not callable(getattr(controller, wanted, None)):
                what = f"{type(controller).__name__} has no {wanted}()"
                accepted = "an object with reset() and step(observation) -> Command(steer, accel)"
                raise ControllerFault(f"controller {name}: {defined_at(controller)}{what}; accepted is {accepted}.")
        try:
            controller.reset()
        except Exception as error:
            raise ControllerFault(f"controller {name}: {failed_at(error)} in reset().") from error

    def closed_loop(
        self, vehicle, control, disturbance, friction, clock, references, state, speed_net, steering_net, trace
    ) -> tuple[LoopState, int, int]:
        """As `loop.closed_loop`, which decides by the built-in laws."""
        car, periods, path, period = state.vehicle, references.accels.size, references.driven, clock.period
        cruise_memory, steering_memory, pending = state.cruise, state.steering, state.pending.copy()
        speeds, accels = references.speeds.tolist(), references.accels.tolist()
        nets = Networks(speed_net, steering_net)
        point, status, k = point_at(path, state.position), RUNNING, 0
        for k in range(periods):
            time = (clock.tick + k) * period
            seen = sense(
                vehicle, control.sensors, disturbance, friction, path, references.origin, references.noise[k],
                time, car, point,
            )  # fmt: skip
            asked = self._ask(
                Observation(
                    time, period, seen.car, seen.cross_track_error, seen.heading_error, seen.motion,
                    speeds[k], accels[k], path, point, vehicle,
                    BuiltInParts(control, nets, cruise_memory, steering_memory),
                ),
                car.torque / (vehicle.mass * vehicle.wheel_radius),
            )  # fmt: skip
            if asked.accel_parts is None:
                push, cruise_memory = aided_cruise(
                    control.longitudinal, speed_net, vehicle, cruise_memory, seen.motion, speeds[k], accels[k],
                    asked.accel, period,
                )  # fmt: skip
            else:
                push = asked.accel_parts
            if asked.steer_parts is None:
                turn, steering_memory = aided_steering(
                    control.lateral, steering_net, vehicle, steering_memory, seen, asked.steer, period
                )
            else:
                turn = asked.steer_parts
            car, point, status = act(
                vehicle, disturbance, friction, clock, references, k, pending, car, point, turn, push,
                speed_net, steering_net, trace[k],
            )  # fmt: skip
            if status != RUNNING:
                break
        return LoopState(car, cruise_memory, steering_memory, point.position, pending), status, k + 1

    def _ask(self, observation: Observation, accel: float) -> Command:
        """The command, or what the car does already once the controller has failed."""
        if self.fault is None:
            try:
                return _checked(self.controller.step(observation))
            except _Unusable as error:
                where, said = defined_at(self.controller.step), str(error)
                self._failed(f"{where}{said}", observation.time, None)
            except Exception as error:
                self._failed(failed_at(error), observation.time, error)
        return Command(observation.steer, accel)

    def _failed(self, said: str, time: float, error: Exception | None) -> None:
        self.fault = ControllerFault(f"controller {self.name}: {said}, after {time:.2f} s.")
        self.fault.__cause__ = error


class _Unusable(Exception):
    """What a step returned, in words."""


def _checked(asked: Any) -> Command:
    """A Command of finite floats."""
    if isinstance(asked, Command):
        steer, accel, steer_parts, accel_parts = asked
    else:
        steer_parts = accel_parts = None
        try:
            if isinstance(asked, str | bytes | dict | set):
                raise TypeError
            steer, accel = asked
        except (TypeError, ValueError):
            raise _Unusable(
                f"step returned {_shown(asked)}; accepted is Command(steer [rad], accel [m/s^2]) or a pair of numbers"
            ) from None
    steer, accel = _number("steer", steer, "rad"), _number("accel", accel, "m/s^2")
    if steer_parts is not None:
        steer_parts = _parts("steer_parts", steer_parts, SteeringCommand, steer)
    if accel_parts is not None:
        accel_parts = _parts("accel_parts", accel_parts, CruiseCommand, accel)
    return Command(steer, accel, steer_parts, accel_parts)


def _parts(name: str, parts: Any, kind: Any, total: float) -> Any:
    """The parts of a command with the command itself in front, as the compiled loop takes them."""
    if not isinstance(parts, kind):
        raise _Unusable(f"step returned {_shown(parts)} for {name}; accepted is a {kind.__name__}")
    return kind(total, *(float(value) for value in parts[1:4]), bool(parts[4]))


def _number(name: str, value: Any, unit: str) -> float:
    scalar = isinstance(value, Real) or getattr(value, "ndim", None) == 0
    if scalar and math.isfinite(value):
        return float(value)
    raise _Unusable(f"step returned {_shown(value)} for {name}; accepted is a finite number [{unit}]")


def _shown(value: Any) -> str:
    """A value on one line, not longer than a sentence bears."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of shape {value.shape}"
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:60]}..."


@njit
def aided_cruise(params, network, vehicle, memory, motion, speed_reference, accel_reference, accel, period):
    """Acceleration of any law with the network beside it (authority 0: without), within the limits of CruiseParams.

    The network learns and adds what the inverse model of the built-in law misses; see `cruise.missing_accel`.

    Args:
        params: CruiseParams; network: EmranMemory, changed in place; vehicle: VehicleParams.
        memory: CruiseMemory, of which the observer's part is used; motion: Motion.
        speed_reference: [m/s]; accel_reference: [m/s2]; accel: of the law [m/s2]; period [s].

    Returns:
        (CruiseCommand, CruiseMemory)
    """
    v, b = observe(params, memory, motion, period)
    ahead = b + params.grade_lead * motion.pitch_rate * math.sqrt(max(GRAVITY * GRAVITY - b * b, 0.0))
    part, signal, learned = missing_accel(
        params, network, vehicle, motion, speed_reference, accel_reference, b, ahead, period
    )
    if speed_reference < 0.05 and motion.speed < HOLD_SPEED:
        part = 0.0  # brakes hold the car
    total = min(max(accel + part, -params.decel_max), params.accel_max)
    after = CruiseMemory(v, b, motion.specific_force, memory.asked, memory.led, memory.expected, memory.pid)
    return CruiseCommand(total, accel, part, signal, learned), after


@njit
def aided_steering(params, network, vehicle, memory, seen, steer, period):
    """Steering of any law with the network beside it (authority 0: without), within the limits of the car.

    Args:
        params: SteeringParams; network: EmranMemory, changed in place; vehicle: VehicleParams.
        memory: SteeringMemory; seen: Seen; steer: of the law [rad]; period [s].

    Returns:
        (SteeringCommand, SteeringMemory)
    """
    cross_track = seen.cross_track_error + params.reference_ahead * math.sin(seen.heading_error)
    return aided(params, network, vehicle, memory, seen.car, cross_track, seen.heading_error, steer, period)
