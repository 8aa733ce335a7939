"""The door for a controller of your own: the closed loop with a Python object in the place of the laws."""

import contextlib
import math
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from emran_sumo.control.cruise import HOLD_SPEED, CruiseCommand, CruiseMemory, missing_accel, observe
from emran_sumo.control.steering import SteeringCommand, SteeringMemory, aided
from emran_sumo.faults import ControllerFault, defined_at, failed_at
from emran_sumo.kernels import njit
from emran_sumo.loop import RUNNING, LoopState, Networks, act, sense
from emran_sumo.observation import BuiltInParts, Command, Observation
from emran_sumo.path import Point, point_at
from emran_sumo.plant.records import GRAVITY
from emran_sumo.plant.vehicle import VehicleState


class OwnController:
    """A user's controller in the place of the laws of one ego.

    A fault does not raise in the middle of a step of the world: `fault` is set, the car keeps its steering and torque.

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
        except (Exception, SystemExit) as error:
            raise ControllerFault(f"controller {name}: {failed_at(error)} in reset().") from error

    def closed_loop(
        self, vehicle, control, disturbance, friction, clock, references, state, speed_net, steering_net, trace
    ) -> tuple[LoopState, int, int]:
        """As `loop.closed_loop`, which decides by the built-in laws."""
        now = Moment(state.vehicle, point_at(references.driven, state.position), state.cruise, state.steering)
        path, period, pending = references.driven, clock.period, state.pending.copy()
        speeds, accels = references.speeds.tolist(), references.accels.tolist()
        nets, status, k = Networks(speed_net, steering_net), RUNNING, 0
        seen = sense(
            vehicle, control.sensors, disturbance, friction, path, references.origin, references.noise[0],
            clock.tick * period, now.car, now.point,
        )  # fmt: skip
        for k in range(len(accels)):
            asked = self._ask(
                Observation(
                    (clock.tick + k) * period, period, seen.car, seen.cross_track_error, seen.heading_error,
                    seen.motion, speeds[k], accels[k], path, now.point, vehicle,
                    BuiltInParts(control, nets, now.cruise, now.steering),
                ),
                now.car.torque / (vehicle.mass * vehicle.wheel_radius),
            )  # fmt: skip
            turn, push = asked.steer_parts, asked.accel_parts
            now, seen, status = one_period(
                vehicle, control, disturbance, friction, clock, references, k, pending, now, seen,
                turn or SteeringCommand(asked.steer, asked.steer, 0.0, 0.0, False), turn is None,
                push or CruiseCommand(asked.accel, asked.accel, 0.0, 0.0, False), push is None,
                speed_net, steering_net, trace[k],
            )  # fmt: skip
            if status != RUNNING:
                break
        return LoopState(now.car, now.cruise, now.steering, now.point.position, pending), status, k + 1

    def _ask(self, observation: Observation, accel: float) -> Command:
        """The command, or what the car does already once the controller has failed."""
        if self.fault is None:
            try:
                return _checked(self.controller.step(observation))
            except _Unusable as error:
                where, said = defined_at(self.controller.step), str(error)
                self._failed(f"{where}{said}", observation.time, None)
            except (Exception, SystemExit) as error:
                self._failed(failed_at(error), observation.time, error)
        return Command(observation.steer, accel)

    def _failed(self, said: str, time: float, error: BaseException | None) -> None:
        self.fault = ControllerFault(f"controller {self.name}: {said}, after {time:.2f} s.")
        self.fault.__cause__ = error


class Moment(NamedTuple):
    """The car at the start of a period, the Point nearest to it, and what the aid of the door remembers."""

    car: VehicleState
    point: Point
    cruise: CruiseMemory
    steering: SteeringMemory


@njit
def one_period(
    vehicle, control, disturbance, friction, clock, references, k, pending, now, seen, turn, aid_turn, push, aid_push,
    speed_net, steering_net, row,
):  # fmt: skip
    """Aid the halves that want it, let the car answer, and look again: one call from Python, whose arguments cost most.

    Args:
        now: Moment; seen: Seen of it.
        turn: SteeringCommand; aid_turn: whether its angle is a law's, to which the network is added.
        push: CruiseCommand; aid_push: the same of its acceleration.
        others: as for `loop.act`.

    Returns:
        (Moment, Seen, status); Seen is old after the last period.
    """
    cruise_memory, steering_memory = now.cruise, now.steering
    if aid_push:
        push, cruise_memory = aided_cruise(
            control.longitudinal, speed_net, vehicle, cruise_memory, seen.motion,
            references.speeds[k], references.accels[k], push.accel, clock.period,
        )  # fmt: skip
    if aid_turn:
        turn, steering_memory = aided(
            control.lateral, steering_net, vehicle, steering_memory, seen.car,
            seen.cross_track_error, seen.heading_error, turn.angle, clock.period,
        )  # fmt: skip
    car, point, status = act(
        vehicle, disturbance, friction, clock, references, k, pending, now.car, now.point, turn, push,
        speed_net, steering_net, row,
    )  # fmt: skip
    if k + 1 < references.accels.size:
        seen = sense(
            vehicle, control.sensors, disturbance, friction, references.driven, references.origin,
            references.noise[k + 1], (clock.tick + k + 1) * clock.period, car, point,
        )  # fmt: skip
    return Moment(car, point, cruise_memory, steering_memory), seen, status


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
    scalar = isinstance(value, float | Real) or getattr(value, "ndim", None) == 0
    with contextlib.suppress(OverflowError):  # of an integer that no float holds
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
