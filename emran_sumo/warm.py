"""Compiling every kernel of a run before it is needed."""

from collections.abc import Callable

import numpy as np

from emran_sumo import kernels
from emran_sumo.controllers import is_own
from emran_sumo.loop import blank_networks, closed_loop, new_trace, quiet_references, start
from emran_sumo.observation import Command, Observation
from emran_sumo.own_controller import OwnController
from emran_sumo.path import Path as Track
from emran_sumo.path import interpolate, nearest, point_at, project
from emran_sumo.plant.vehicle import rolling_start
from emran_sumo.scenario import Scenario

Progress = Callable[[str, float, float], None]  # phase, seconds done, seconds in all


class _Still:
    """The least controller."""

    def reset(self) -> None:
        """Nothing to forget."""

    def step(self, observation: Observation) -> Command:
        """Straight on; asks for what a controller may."""
        observation.preview(1.0)
        return Command(0.0 * observation.grade, 0.0)


def warm_kernels(scenario: Scenario, progress: Progress = lambda *_: None) -> None:
    """Compile or load every kernel of a run by driving a tenth of a second on a straight line."""
    if not warm(scenario):
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
    if is_own(scenario.controller):
        own = OwnController(_Still(), "warm-up")
        own.closed_loop(
            scenario.vehicle, scenario.control, scenario.disturbance, scenario.road.friction, scenario.clock(),
            references, state, nets.speed, nets.steering, new_trace(2),
        )  # fmt: skip
    project(track, np.ones(1), np.ones(1), 5.0, 10.0)
    nearest(track, 1.0, 1.0, point_at(track, 5.0).position)
    interpolate(track.x, track, 5.0)
    for kind in kinds(scenario):
        kernels.mark_compiled(kind)


def warm(scenario: Scenario) -> bool:
    """Whether every kernel of a run lies in the cache."""
    return all(map(kernels.compiled_before, kinds(scenario)))


def kinds(scenario: Scenario) -> tuple[str, ...]:
    """Names of the sets of kernels that a run needs; a law or a filter over all neurons is compiled when first used."""
    law = scenario.lateral.law.replace("lq_preview", "lqr")
    parts = [law] if law != "stanley" else []
    parts += [half for half in ("longitudinal", "lateral") if getattr(scenario, half).emran.all_neurons]
    sets = (kernels.ALL, kernels.OWN) if is_own(scenario.controller) else (kernels.ALL,)
    return tuple("-".join((name, *parts)) for name in sets)
