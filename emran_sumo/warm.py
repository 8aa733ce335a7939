"""Compiling every kernel of a run before it is needed."""

from collections.abc import Callable

import numpy as np

from emran_sumo import kernels
from emran_sumo.loop import blank_networks, closed_loop, new_trace, quiet_references, start
from emran_sumo.path import Path as Track
from emran_sumo.path import interpolate, nearest, point_at, project
from emran_sumo.plant.vehicle import rolling_start
from emran_sumo.scenario import Scenario

Progress = Callable[[str, float, float], None]  # phase, seconds done, seconds in all


def kernel_set(scenario: Scenario) -> str:
    """Name of the set of kernels that a run needs: each law is compiled when it is first used; "" is Stanley's."""
    law = scenario.lateral.law.replace("lq_preview", "lqr")
    parts = [law] if law != "stanley" else []
    parts += [half for half in ("longitudinal", "lateral") if getattr(scenario, half).emran.all_neurons]
    return "".join(f"-{part}" for part in parts)


def warm_kernels(scenario: Scenario, progress: Progress = lambda *_: None) -> None:
    """Compile or load every kernel of a run by driving a tenth of a second on a straight line."""
    if not kernels.compiled_before(kernel_set(scenario)):
        progress("compile", 0.0, 0.0)
    n = 400
    line = np.arange(n) * 0.25
    flat = np.zeros(n)
    track = Track(line, flat, flat, flat, flat, 0.25)
    car = rolling_start(scenario.vehicle, 10.0, 5.0, 0.0, 0.0)
    state = start(scenario.vehicle, scenario.longitudinal, scenario.lateral, car, 5.0, scenario.rates.control_step)
    nets = blank_networks(scenario.control)
    references = quiet_references(track, np.full(3, 10.0), np.zeros(2))
    closed_loop(
        scenario.vehicle, scenario.control, scenario.disturbance, scenario.road.friction, scenario.clock(),
        references, state, nets.speed, nets.steering, new_trace(2),
    )  # fmt: skip
    project(track, np.ones(1), np.ones(1), 5.0, 10.0)
    nearest(track, 1.0, 1.0, point_at(track, 5.0).position)
    interpolate(track.x, track, 5.0)
    kernels.mark_compiled(kernel_set(scenario))
