"""The closed loop on an analytic road, without traffic: what the tests of controllers share."""

import signal
from typing import NamedTuple

import numpy as np
import pytest

from emran_sumo.control.steering import compiled_view
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.loop import (
    AT,
    Clock,
    ControlParams,
    LoopState,
    Networks,
    blank_networks,
    closed_loop,
    new_trace,
    quiet_references,
    start,
)
from emran_sumo.path import LaneChange, Path, lane_change_offset, nearest, point_at, shifted
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.plant.vehicle import VehicleParams, rolling_start

CAR = VehicleParams()

# a suite started in the background inherits an ignored SIGINT, and so would the processes whose SIGINT is tested
signal.signal(signal.SIGINT, signal.default_int_handler)


class Drive(NamedTuple):
    state: LoopState
    status: int
    networks: Networks
    trace: np.ndarray

    def column(self, name):
        return self.trace[:, getattr(AT, name)]


def control_named(name, changes=None):
    """ControlParams of a controller, with further dotted keys changed."""
    control = ControlParams()
    for key, value in {**CONTROLLERS[name][1], **(changes or {})}.items():
        control = _changed(control, key.split("."), value)
    return control


def _changed(record, keys, value):
    if len(keys) > 1:
        value = _changed(getattr(record, keys[0]), keys[1:], value)
    assert keys[0] in record._fields
    return record._replace(**{keys[0]: value})


def straight(length, spacing=0.25, grade=0.0):
    x = np.arange(0.0, length + 0.5 * spacing, spacing)
    zero = np.zeros_like(x)
    return Path(x, zero, zero, zero, np.full_like(x, grade), spacing)


def circle(radius, length, spacing=0.25):
    """Left turn for a positive radius, right turn for a negative one; starts at the origin, heading east."""
    turn = np.arange(0.0, length + 0.5 * spacing, spacing) / radius
    zero = np.zeros_like(turn)
    return Path(radius * np.sin(turn), radius * (1 - np.cos(turn)), turn, zero + 1 / radius, zero, spacing)


def eq23(first=-20.0, last=400.0, spacing=0.05):
    """The double lane change of Eq. 23 as a function of x, from x = first to x = last."""
    x = np.arange(first, last + 0.5 * spacing, spacing)
    zero = np.zeros_like(x)
    changes = (LaneChange(4.05, 27.19, 25.0), LaneChange(-5.7, 56.46, 21.95))
    return shifted(Path(x, zero, zero, zero, zero, spacing), *lane_change_offset(changes, x))


def drive_along(
    path, speed, time, controller="coupled-emran", *, changes=None, position=0.0, chunk=None, friction=1.0,
    speeds=None, disturbance=None, networks=None,
):  # fmt: skip
    """Drive a path at a constant speed, or at `speeds` (n + 1,), in calls of `chunk` control periods."""
    control, count = control_named(controller, changes), round(time * 100)
    speeds = np.full(count + 1, float(speed)) if speeds is None else speeds
    accels = np.diff(speeds) / 0.01
    at = point_at(path, position)
    at = nearest(path, at.x, at.y, position)
    car = rolling_start(CAR, float(speed), at.x, at.y, at.yaw)
    state = start(CAR, control.longitudinal, control.lateral, car, at.position, 0.01)
    nets = networks or blank_networks(control)
    control = control._replace(lateral=compiled_view(control.lateral))
    trace, done, status = new_trace(count), 0, 0
    while done < count and status == 0:
        n = min(chunk or count, count - done)
        state, status, rows = closed_loop(
            CAR, control, disturbance or DisturbanceParams(), friction, Clock(done, 0.01, 10, 0.001),
            quiet_references(path, speeds[done : done + n + 1], accels[done : done + n]),
            state, nets.speed, nets.steering, trace[done : done + n],
        )  # fmt: skip
        done += rows
    return Drive(state, status, nets, trace[:done])


class Bench(NamedTuple):
    """What a test of the closed loop needs, by name."""

    drive = staticmethod(drive_along)
    control = staticmethod(control_named)
    straight = staticmethod(straight)
    circle = staticmethod(circle)
    eq23 = staticmethod(eq23)


@pytest.fixture(scope="session")
def bench():
    return Bench()


@pytest.fixture(scope="session")
def double_lane_change():
    return eq23()
