"""Computing time of a control step against its deadline."""

import gc
import time
from typing import Any, NamedTuple

import numpy as np

from emran_sumo.conditioning import conditioned
from emran_sumo.loop import References, blank_networks, closed_loop, new_trace, start
from emran_sumo.paper.cases import dlc
from emran_sumo.paper.rows import rows
from emran_sumo.path import point_at
from emran_sumo.plant.sensors import CHANNELS
from emran_sumo.plant.vehicle import rolling_start
from emran_sumo.scenario import Scenario, build
from emran_sumo.world.track import LEAD_IN, track_path

DEADLINE = 0.01  # s
WARM = 100  # calls not counted
RUNS = 3
HOW = (
    "Each call of the compiled loop drives one control period of table VI: sensors, both laws, learning, and the ten "
    "1 ms steps of the plant; the time includes the way from Python into the kernel and back, so the controller alone "
    "takes less. Each step is timed in three equal runs and the shortest counts, because a shared "
    "machine takes the core away for milliseconds at a time. The last column is the whole run in one call, divided by "
    "its periods."
)


class Timing(NamedTuple):
    """Seconds per control period: mean, 99th percentile, largest; mean inside one long call; most neurons."""

    row: str
    mean: float
    p99: float
    largest: float
    inside: float
    neurons: int


# so fine a grid of neurons that the networks fill up: the most that a step can cost
FULL: dict[str, Any] = {
    f"{half}.emran.{key}": value
    for half, distance in (("lateral", 0.02), ("longitudinal", 0.0002))
    for key, value in (
        ("eps_max", distance), ("eps_min", distance), ("prune_share", 0.0), ("merge_distance", 0.0),
        ("error_delete", 0.0), ("error_learn", 0.0), ("error_grow", 0.0), ("rms_grow", 0.0),
    )
}  # fmt: skip


def timings() -> list[Timing]:
    """Time all rows of table VI, and EMRAN with networks made to fill up."""
    cars = {row.name: row.given for row in rows("lateral") if "accuracy" not in row.name}
    cars["coupled-emran, made to fill up"] = FULL
    return [_timed(name, build({**dlc(10.0, 14.0), **given})) for name, given in cars.items()]


def _timed(name: str, scenario: Scenario) -> Timing:
    n = round(scenario.duration / scenario.rates.control_step)
    _drive(scenario, n, WARM)
    again = [_drive(scenario, n, n) for _ in range(RUNS)]
    singles, neurons = np.min([seconds for seconds, _ in again], axis=0), again[0][1]
    whole, _ = _drive(scenario, n, 1)
    counted = singles[WARM:]
    return Timing(
        name,
        float(counted.mean()),
        float(np.percentile(counted, 99)),
        float(counted.max()),
        float(whole[0] / n),
        neurons,
    )


def _drive(scenario: Scenario, periods: int, calls: int) -> tuple[np.ndarray, int]:
    """Seconds of each of `calls` calls that share the control periods of a run, and the most neurons."""
    speed = scenario.track.speed
    path = track_path(scenario.track, scenario.duration)
    lateral = scenario.lateral
    followed = conditioned(path, lateral, scenario.vehicle, speed) if lateral.conditioning else path
    begin = point_at(path, LEAD_IN)
    car = rolling_start(scenario.vehicle, speed, begin.x, begin.y, begin.yaw)
    state = start(scenario.vehicle, scenario.longitudinal, scenario.lateral, car, LEAD_IN, scenario.rates.control_step)
    nets, seconds, most = blank_networks(scenario.control), np.zeros(calls), 0
    size = periods // calls
    speeds, accels, noise = np.full(size + 1, speed), np.zeros(size), np.zeros((size, CHANNELS))
    trace, following = new_trace(size), References(path, followed, speeds, accels, noise, 0.0)
    control, disturbance, friction = scenario.control, scenario.disturbance, scenario.road.friction
    gc.disable()
    try:
        for call in range(calls):
            clock = scenario.clock(call * size)
            began = time.perf_counter()
            state, _, _ = closed_loop(
                scenario.vehicle,
                control,
                disturbance,
                friction,
                clock,
                following,
                state,
                nets.speed,
                nets.steering,
                trace,
            )
            seconds[call] = time.perf_counter() - began
            most = max(most, int(nets.speed.counts[0]), int(nets.steering.counts[0]))
    finally:
        gc.enable()
    return seconds, most
