"""The test bench in one kernel call per run: what tables, tuning and tests drive."""

from typing import NamedTuple

import numpy as np

from emran_sumo import metrics
from emran_sumo.conditioning import conditioned
from emran_sumo.controllers import is_own
from emran_sumo.errors import UserError
from emran_sumo.loop import STATUS, Networks, References, blank_networks, closed_loop, new_trace, start
from emran_sumo.path import Path, nearest, point_at
from emran_sumo.plant.disturbance import drawn
from emran_sumo.plant.sensors import CHANNELS, noise_source
from emran_sumo.plant.vehicle import rolling_start
from emran_sumo.scenario import Scenario
from emran_sumo.world.track import LEAD_IN, TrackParams, accel_reference, speed_reference, track_path


class BenchRun(NamedTuple):
    """ended: "running" (drove to the end), "diverged" or "path ended"; trace: (n, loop.WIDTH); networks as they were
    at the end."""

    ended: str
    trace: np.ndarray
    networks: Networks


_paths: dict[tuple, Path] = {}


def _path(track: TrackParams, duration: float) -> Path:
    """The road, built once for all runs on it."""
    key = (track, duration)
    if key not in _paths:
        if len(_paths) > 32:
            _paths.clear()
        _paths[key] = track_path(track, duration)
    return _paths[key]


def drive_track(scenario: Scenario, networks: Networks | None = None) -> BenchRun:
    """Drive a track scenario from its start for its duration.

    Args:
        scenario: Scenario with world = "track".
        networks: what was learned before; empty networks otherwise. Changed in place.
    """
    if is_own(scenario.controller):
        accepted = "a built-in one; `emran-sumo run`, `compare` and `study` take your own"
        raise UserError(f'controller: found "{scenario.controller}"; accepted here is {accepted}.')
    track, period = scenario.track, scenario.rates.control_step
    n = round(scenario.duration / period)
    times = np.arange(n + 1) * period
    speeds = speed_reference(track, times)
    accels = accel_reference(track, times[:-1] + scenario.longitudinal.preview)
    path = _path(track, scenario.duration)
    lateral = scenario.lateral
    driven = conditioned(path, lateral, scenario.vehicle, float(speeds[0])) if lateral.conditioning else path
    noise = noise_source(scenario.seed).standard_normal((n, CHANNELS))
    begin = point_at(path, LEAD_IN)
    car = rolling_start(scenario.vehicle, float(speeds[0]), begin.x, begin.y, begin.yaw)
    position = nearest(driven, car.x, car.y, LEAD_IN).position
    state = start(scenario.vehicle, scenario.longitudinal, scenario.lateral, car, position, period)
    nets = networks if networks is not None else blank_networks(scenario.control)
    trace = new_trace(n)
    _, status, rows = closed_loop(
        scenario.vehicle, scenario.control, drawn(scenario.disturbance, scenario.seed), scenario.road.friction,
        scenario.clock(), References(path, driven, speeds, accels, noise, 0.0), state, nets.speed, nets.steering, trace,
    )  # fmt: skip
    return BenchRun(STATUS[status], trace[:rows], nets)


def scores(run: BenchRun) -> dict[str, float]:
    """Tracking, effort and network metrics of a run, flat; `ended` is 1.0 when it drove to the end."""
    trace = run.trace
    found = {**metrics.tracking(trace), **metrics.effort(trace), **metrics.networks(trace)}
    return {**found, "ended": float(run.ended != "diverged"), "driven": float(trace[-1, 0])}
