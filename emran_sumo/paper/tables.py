"""Drives the cases with the rows, on all cores; the digits do not depend on how many."""

import math
import multiprocessing
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from emran_sumo.bench import BenchRun, drive_track, scores
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.loop import AT
from emran_sumo.paper import memory
from emran_sumo.paper.cases import ADD_ON, BLIND, FORCES, TABLES, Case, Given, Table, compared, dlc, published
from emran_sumo.paper.rows import Row, literal_rows, pairs, rows
from emran_sumo.paper.timing import Timing
from emran_sumo.scenario import build

SPUN = 0.6  # rad: a car that turned this far has lost the road, even if it stopped beside it
ALONE = 24  # fewer runs than this are faster without further processes
NAMES = (*TABLES, *ADD_ON, "blind", "memory", "timing")

Values = dict[str, float | None]
Progress = Callable[[int, int], None]


class Condition(NamedTuple):
    """How the cases are driven: name in words, dotted keys on top, seeds of the noise to average over."""

    name: str = ""
    given: Given = {}  # noqa: RUF012
    seeds: tuple[int, ...] = (1,)


class Result(NamedTuple):
    """What one row did in one case.

    values: metric -> mean over the runs, None where a car was lost; worst: largest over the runs; lost: how many of
    `runs` lost the car; after: when the first one did [s].
    """

    table: str
    case: Case
    row: Row
    values: Values
    worst: Values
    lost: int
    runs: int
    after: float


class Record(NamedTuple):
    """One cell, for machines; ours is None where the car was lost, published where the paper has no such cell."""

    table: str
    case: str
    row: str
    metric: str
    published: float | None
    ours: float | None
    ours_unaided: float | None


NOISE = {
    "sensors.cross_track": 0.01, "sensors.heading": math.radians(0.1), "sensors.yaw_rate": math.radians(0.2),
    "sensors.speed_lat": 0.03, "sensors.speed": 0.02, "sensors.accel": 0.05, "sensors.pitch_rate": 0.002,
    "sensors.pitch_rate_bias": 0.001,
}  # fmt: skip


def condition(noise: bool = False, delay: int = 0) -> Condition:
    """The condition of the command line.

    Args:
        noise: sensor noise, three seeds.
        delay: of the commands [ms], a multiple of 10 below 160.

    Raises:
        UserError: the delay is not one.
    """
    if delay % 10 or not 0 <= delay < 160:
        raise UserError(f"--delay: found {delay} ms; accepted is a whole multiple of 10 ms, at most 150 ms.")
    given: Given = {**(NOISE if noise else {}), **({"rates.command_delay": delay / 1000.0} if delay else {})}
    words = ["sensor noise"] * noise + [f"{delay} ms delay"] * bool(delay)
    return Condition(" and ".join(words), given, (1, 2, 3) if noise else (1,))


def chosen(names: Sequence[str]) -> tuple[str, ...]:
    """Table names in their order; all but the timing, whose digits differ each time, when none is given.

    Raises:
        UserError: a name is no table.
    """
    known = {name.lower(): name for name in NAMES}
    for name in names:
        if name.lower() not in known:
            raise UserError(f'Unknown table "{name}". {nearest_name(name, list(NAMES), ", ".join(NAMES))}')
    wanted = {known[name.lower()] for name in names} or set(NAMES) - {"timing"}
    return tuple(name for name in NAMES if name in wanted)


def driven_tables(names: Iterable[str]) -> dict[str, Table]:
    """The tables of cases among `names`."""
    known = {**TABLES, **ADD_ON}
    found = {name: known[name] for name in names if name in known}
    return {**found, **(BLIND if "blind" in names else {})}


def results(
    tables: dict[str, Table], how: Condition, literal: bool, workers: int | None, progress: Progress | None = None
) -> list[Result]:
    """Every case of every table with every row.

    Args:
        tables: name -> Table.
        how: Condition.
        literal: the rows that take the paper word for word instead of the usual ones.
        workers: processes; as many as there are cores otherwise.
        progress: told the runs done and all runs.
    """
    lines = [
        (name, case, row)
        for name, table in tables.items()
        if not (literal and name in ADD_ON)
        for case in table.cases
        for row in (literal_rows() if literal else pairs() if name in ADD_ON else rows(table.half))
    ]
    jobs = [_jobs(case, row, how) for _, case, row in lines]
    done = iter(work([job for group in jobs for job in group], workers, progress))
    return [_result(*line, [next(done) for _ in group]) for line, group in zip(lines, jobs, strict=True)]


def memory_results(how: Condition, workers: int | None, progress: Progress | None = None) -> list[memory.Passes]:
    """The repeated passes of the table "memory"."""
    jobs = memory.jobs(how.given)
    return memory.ranked(work([partial(memory.repeated, *job[2:]) for job in jobs], workers, progress), jobs)


def _jobs(case: Case, row: Row, how: Condition) -> list[partial]:
    """One run per draw and seed; many draws take the seeds in turn. Then the sweep, where there is one."""
    several = len(case.draws) > 1
    turns = [(how.seeds[i % len(how.seeds)],) if several else how.seeds for i in range(len(case.draws))]
    runs = [
        {**case.given, **draw, **how.given, "seed": seed, **row.given}
        for draw, seeds in zip(case.draws, turns, strict=True)
        for seed in seeds
    ]
    return [partial(_driven, run) for run in runs] + [partial(_lost_force, run) for run in runs[:1] if case.sweep]


def _driven(given: Given) -> Values:
    run = drive_track(build(given))
    return {**scores(run), "lost_at": lost_at(run)}


def lost_at(run: BenchRun) -> float | None:
    """When the car had turned SPUN from the path or the run broke off [s]; None for one that was kept."""
    spun = np.abs(run.trace[:, AT.heading_error]) > SPUN
    if spun.any():
        return float(run.trace[spun.argmax(), AT.time])
    return float(run.trace[-1, AT.time]) if run.ended == "diverged" else None


def _lost_force(given: Given) -> Values:
    """The smallest gust of the sweep [N] that loses the car; None when none does."""
    for force in FORCES:
        if _driven({**given, "disturbance.gust_force": force})["lost_at"] is not None:
            return {"lost_force": force}
    return {"lost_force": None}


def _result(name: str, case: Case, row: Row, found: list[Values]) -> Result:
    sweep = found.pop() if case.sweep else {}
    lost = [when for one in found if (when := one.pop("lost_at")) is not None]
    keys = found[0]
    columns = {key: [one[key] or 0.0 for one in found] for key in keys}
    mean: Values = {key: None if lost else math.fsum(c) / len(c) for key, c in columns.items()}
    worst: Values = {key: None if lost else max(c) for key, c in columns.items()}
    return Result(name, case, row, {**mean, **sweep}, {**worst, **sweep}, len(lost), len(found), min(lost, default=0.0))


def work(jobs: list[partial], workers: int | None = None, progress: Progress | None = None) -> list[Any]:
    """What the jobs return, in their order; they share nothing, so the number of processes changes no digit."""
    warm()
    count = min(workers or os.cpu_count() or 1, max(len(jobs), 1))
    if count == 1 or len(jobs) < ALONE:
        return [_told(job(), i, len(jobs), progress) for i, job in enumerate(jobs)]
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
        found = pool.map(_call, jobs, chunksize=8)
        return [_told(one, i, len(jobs), progress) for i, one in enumerate(found)]


def _call(job: partial) -> Any:
    return job()


def _told(value: Any, i: int, total: int, progress: Progress | None) -> Any:
    if progress:
        progress(i + 1, total)
    return value


def warm() -> None:
    """Compile the kernels here, so that the other processes read them from the cache."""
    drive_track(build({**dlc(10.0, 0.05), "lateral.conditioning": True}))


def effort_name(half: str) -> str:
    """The metric that says how much the command moves."""
    return "steer_variation" if half == "lateral" else "accel_variation"


def side_values(result: Result, unaided: Result | None, half: str) -> Values:
    """The columns beside the errors: command variation over that of the law without network, neurons, samples."""
    which = "steering" if half == "lateral" else "speed"
    own, alone = result.values[effort_name(half)], unaided.values[effort_name(half)] if unaided else None
    return {
        "command_variation_ratio": own / alone if own is not None and alone else None,
        "neurons": result.worst[f"neurons_{which}_max"],
        "learned_share": result.values[f"learned_share_{which}"],
    }


def unaided_of(result: Result, among: list[Result]) -> Result | None:
    """The result of the same law without its network, in the same case."""
    same = (r for r in among if r.table == result.table and r.case.name == result.case.name)
    return next((r for r in same if r.row.name == result.row.unaided), None)


def views(result: Result) -> tuple[tuple[str, Values], ...]:
    """Case name and values; a case of many cars has its mean and its worst."""
    if len(result.case.draws) == 1:
        return ((result.case.name, result.values),)
    return ((f"{result.case.name}, mean", result.values), (f"{result.case.name}, worst", result.worst))


def records(tables: dict[str, Table], found: list[Result], how: Condition) -> list[Record]:
    """Every cell for machines."""
    listed: list[Record] = []
    for result in found:
        table, alone = tables[result.table], unaided_of(result, found)
        cells = published_cells(result)
        for i, (name, values) in enumerate(views(result)):
            case = f"{name}, {how.name}" if how.name else name
            without = views(alone)[i][1] if alone else {}
            for metric, printed in zip(table.metrics, cells or (None,) * 4, strict=False):
                key = (result.table, case, result.row.name, metric)
                listed.append(Record(*key, printed, values[metric], without.get(metric)))
            for metric, value in _extras(result, alone, table.half).items():
                listed.append(Record(result.table, case, result.row.name, metric, None, value, None))
    return listed


def _extras(result: Result, alone: Result | None, half: str) -> Values:
    sweep: Values = {"lost_force": result.values["lost_force"]} if result.case.sweep else {}
    return {**side_values(result, alone, half), "lost_share": result.lost / result.runs, **sweep}


def memory_records(found: list[memory.Passes], how: Condition) -> list[Record]:
    """Repeated passes for machines; unaided is the law without network in the same pass."""
    base = {line.case: line for line in found if line.row == "coupled-base"}
    listed = []
    for line in found:
        case, alone = f"{line.case}, {how.name}" if how.name else line.case, base[line.case]
        metrics = (
            *(f"{memory.METRIC[line.half]}_pass_{i + 1}" for i in range(len(line.rms))),
            memory.METRIC[line.half],
        )
        cells = zip(metrics, (*line.rms, line.overall), (*alone.rms, alone.overall), strict=True)
        listed += [Record("memory", case, line.row, metric, None, ours, without) for metric, ours, without in cells]
    return listed


def timing_records(found: list[Timing]) -> list[Record]:
    """Computing times [s] for machines."""
    names = ("mean", "p99", "largest", "inside")
    return [
        Record("timing", "control step", t.row, f"{name}_time", None, getattr(t, name), None)
        for t in found
        for name in names
    ]


def published_cells(result: Result) -> tuple[float, ...] | None:
    """What the paper printed for this kind of row; None outside its tables."""
    printed = published()["tables"].get(result.table)
    return compared(printed, result.row.aided) if printed else None


def missed(result: Result, metrics: tuple[str, ...]) -> list[str] | None:
    """Names of the required cells that the mean does not reach; None where nothing is required of this row."""
    limits = result.case.required.get(result.row.name)
    if limits is None:
        return None
    pairs = [(m, result.values[m], limit) for m, limit in zip(metrics, limits, strict=True) if limit is not None]
    return [metric for metric, value, limit in pairs if value is None or value > limit]


def required_results(names: Iterable[str] = TABLES, workers: int | None = None) -> list[Result]:
    """The results of which something is required, for tests."""
    found = results(driven_tables(tuple(names)), Condition(), False, workers)
    return [result for result in found if result.row.name in result.case.required]
