"""Where an online network earns its place: repeated passes with what was learned kept from pass to pass.

The rival is an observer: the integrator of the same learning signal without neurons. It drives with the rate of the
scheme's own bias, with the bandwidth of neurons and bias together, and with every rate of a sweep, of which the best
for the very case counts: it may be tuned on the test, the network may not.
"""

import math
from typing import NamedTuple

from emran_sumo.bench import drive_track, scores
from emran_sumo.paper.cases import Given, cruise, dlc
from emran_sumo.scenario import build

PASSES = 5
RATES = {
    "lateral": (0.979, 2.0, 3.0, 3.652, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0),
    "longitudinal": (5.0, 8.0, 11.2, 20.0, 40.0, 60.0, 90.0),
}
OWN = {"lateral": 0.979, "longitudinal": 5.0}  # 1/s, rate of the scheme's own bias
SAME = {"lateral": 3.652, "longitudinal": 11.2}  # 1/s, of neurons and bias together
METRIC = {"lateral": "cross_track_error_rms", "longitudinal": "speed_error_rms"}
EFFORT = {"lateral": "steer_variation", "longitudinal": "accel_variation"}

_WRONG = {"mass_factor": 1.2, "stiffness_front": 0.85, "stiffness_rear": 0.85}


def _slalom(speed: float, wavelength: float, **disturbance: float) -> Given:
    shape = {"track.shape": "slalom", "track.amplitude": 1.5, "track.wavelength": wavelength}
    return {**cruise(20.0, speed, **disturbance), **shape}


def _hills(degrees: float, mass: float) -> Given:
    up = math.radians(degrees)
    times = {"grade_start": 5.0, "grade_return_start": 22.0}
    return cruise(40.0, grade_pulse=up, grade_return=-up, mass_factor=mass, **times)


def _wave(speed: float, amplitude: float, frequency: float, **disturbance: float) -> Given:
    shape = {"track.speed_amplitude": amplitude, "track.speed_frequency": frequency}
    return {**cruise(40.0, speed, **disturbance), **shape}


_STOP_AND_GO = {
    "track.speed_times": (2.0, 6.0, 12.0, 16.0, 22.0, 26.0, 32.0, 36.0),
    "track.speed_values": (15.0, 25.0, 25.0, 15.0, 15.0, 25.0, 25.0, 15.0),
}
CASES: dict[str, tuple[str, Given]] = {
    "slalom 100 m, 20 m/s, mass 1.2, stiffness 0.85": ("lateral", _slalom(20.0, 100.0, **_WRONG)),
    "slalom 60 m, 15 m/s, mass 1.2, stiffness 0.85": ("lateral", _slalom(15.0, 60.0, **_WRONG)),
    "slalom 60 m, 15 m/s, steering 15 % weak": ("lateral", _slalom(15.0, 60.0, steer_effectiveness=0.85)),
    "slalom 45 m, 12 m/s, mass 1.2, stiffness 0.85": ("lateral", _slalom(12.0, 45.0, **_WRONG)),
    "DLC 10 m/s, steering 15 % weak": ("lateral", dlc(10.0, 14.0, steer_effectiveness=0.85)),
    "DLC 10 m/s, +1500 N, mass 1.2, stiffness 0.85": ("lateral", dlc(10.0, 14.0, lateral_force=1500.0, **_WRONG)),
    "straight 15 m/s, 1.5 kN from 3 to 7 s in each pass": (
        "lateral", cruise(15.0, 15.0, gust_force=1500.0, gust_start=3.0, gust_duration=4.0),
    ),
    "speed 20 +- 1.5 m/s at 2 rad/s, mass 1.3": ("longitudinal", _wave(20.0, 1.5, 2.0, mass_factor=1.3)),
    "speed 20 +- 3 m/s at 1 rad/s, mass 1.2": ("longitudinal", _wave(20.0, 3.0, 1.0, mass_factor=1.2)),
    "between 15 and 25 m/s at 2.5 m/s2, mass 1.2": ("longitudinal", {**cruise(40.0, mass_factor=1.2), **_STOP_AND_GO}),
    "hills of +-20 degrees, 25 m/s, mass 1.15": ("longitudinal", _hills(20.0, 1.15)),
    "hills of +-20 degrees, 25 m/s, mass 0.85": ("longitudinal", _hills(20.0, 0.85)),
}  # fmt: skip


class Passes(NamedTuple):
    """One line: case, who drove, rms of the error in each pass, rms over all, command variation of the last pass, most
    neurons; errors are None after a lost car."""

    case: str
    half: str
    row: str
    rms: tuple[float | None, ...]
    overall: float | None
    variation: float
    neurons: int


class Job(NamedTuple):
    """One car through all its passes: case, what drives in words, half of the controller, dotted keys."""

    case: str
    row: str
    half: str
    given: Given


def repeated(half: str, given: Given) -> tuple[tuple[float | None, ...], float, int]:
    """Drive PASSES passes with one pair of networks.

    Returns:
        RMS error of each pass, command variation of the last, most neurons.
    """
    scenario, networks, errors, variation, neurons = build(given), None, [], 0.0, 0
    which = "steering" if half == "lateral" else "speed"
    for number in range(PASSES):
        run = drive_track(scenario._replace(seed=scenario.seed + number), networks)
        networks, found = run.networks, scores(run)
        errors.append(found[METRIC[half]] if found["ended"] else None)
        variation, neurons = found[EFFORT[half]], max(neurons, int(found[f"neurons_{which}_max"]))
    return tuple(errors), variation, neurons


def jobs(how: Given) -> list[Job]:
    """All cars of all cases; `how`: dotted keys on top."""
    listed = []
    for case, (half, given) in CASES.items():
        section = f"{half}.emran"
        cars: dict[str, Given] = {"coupled-base": {"controller": "coupled-base"}, "coupled-emran": {}}
        for rate in RATES[half]:
            cars[f"observer {rate:g}/s"] = {f"{section}.neurons_max": 0, f"{section}.bias_rate": rate}
        listed += [Job(case, row, half, {**given, **how, **keys}) for row, keys in cars.items()]
    return listed


def ranked(found: list[tuple[tuple[float | None, ...], float, int]], of: list[Job]) -> list[Passes]:
    """The lines to show: base, observers at the scheme's own rate, at its bandwidth and at their best, EMRAN."""
    lines = [
        Passes(job.case, job.half, job.row, rms, _overall(rms), variation, neurons)
        for job, (rms, variation, neurons) in zip(of, found, strict=True)
    ]
    shown = []
    for case, (half, _) in CASES.items():
        here = {line.row: line for line in lines if line.case == case}
        observers = [line for row, line in here.items() if row.startswith("observer")]
        best = min(observers, key=lambda line: math.inf if line.overall is None else line.overall)
        own, same = here[f"observer {OWN[half]:g}/s"], here[f"observer {SAME[half]:g}/s"]
        shown += [
            here["coupled-base"],
            own._replace(row=f"bias alone, {OWN[half]:g}/s"),
            same._replace(row=f"observer, same bandwidth, {SAME[half]:.3g}/s"),
            best._replace(row=f"observer at its best here, {best.row.removeprefix('observer ')}"),
            here["coupled-emran"],
        ]
    return shown


def _overall(rms: tuple[float | None, ...]) -> float | None:
    squares = [value * value for value in rms if value is not None]
    return math.sqrt(math.fsum(squares) / len(squares)) if len(squares) == len(rms) else None
