"""Tuning: search the keys of a tuning file for the values that drive its cases best; resumable, same by seed."""

import hashlib
import json
import math
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from emran_sumo import __version__
from emran_sumo.bench import drive_track, scores
from emran_sumo.checkpoint import Checkpoint, checkpoint_file, sources
from emran_sumo.errors import UserError
from emran_sumo.scenario import build
from emran_sumo.search import need_packages, search
from emran_sumo.tuning import START, Tuning, decode, encode, read

LOST = 1e3  # cost of a run that diverges, plus the share of its duration that was not driven

Values = dict[str, float | int]


class Plan(NamedTuple):
    """How to search; workers: processes that drive, without influence on the result."""

    method: str = "ga"
    seed: int = 1
    generations: int = 10
    population: int = 20
    workers: int = 1


class Step(NamedTuple):
    """Where a search stands; cost of the start values and of the best so far, 1 where all equals the reference.

    generation: the last finished one; evaluations: points asked for so far, also those that were known before;
    driven: evaluations of this call, without those that a checkpoint held.
    """

    generation: int
    evaluations: int
    driven: int
    start: float
    best: float


class Tuned(NamedTuple):
    """What a search found; changed: start and best value by key."""

    step: Step
    changed: dict[str, tuple[float | int, float | int]]
    file: Path


Progress = Callable[[Step], None]


def ride(given: dict[str, Any]) -> dict[str, float]:
    """Scores of one run, with `share`, how much of its duration was driven."""
    scenario = build(given)
    found = scores(drive_track(scenario))
    return {**found, "share": found["driven"] / scenario.duration}


def cost(tuning: Tuning, units: list[dict[str, float]], values: Values) -> float:
    """Weighted mean over the cases of the weighted mean of their terms, each over its unit; the reference costs 1.

    Args:
        tuning: Tuning.
        units: per case, what each term is divided by.
        values: of the genes, by dotted key.
    """
    total = 0.0
    for case, unit in zip(tuning.cases, units, strict=True):
        found = ride({**case.given, **values})
        part = sum(weight * found[term] / unit[term] for term, weight in case.terms.items())
        part /= sum(case.terms.values())
        if not found["ended"] or not math.isfinite(part):
            part = LOST + 1.0 - found["share"]
        total += case.weight * part
    return total / sum(case.weight for case in tuning.cases)


def units_of(tuning: Tuning) -> list[dict[str, float]]:
    """Scores of the reference in every case, by which the terms are divided.

    Raises:
        UserError: the reference does not drive a case to its end, or a term of it is 0.
    """
    found = []
    for case in tuning.cases:
        values = decode(tuning.genes, encode(tuning.genes))
        other = values if tuning.reference == START else {**values, "controller": tuning.reference}
        unit = ride({**case.given, **other})
        if not unit["ended"]:
            raise UserError(f'case "{case.name}": the reference {tuning.reference} leaves the path; name another one.')
        for term in case.terms:
            if not unit[term] > 0.0:
                raise UserError(f'case "{case.name}": {term} of the reference {tuning.reference} is 0 and no unit.')
        found.append(unit)
    return found


class Crew:
    """Processes that drive; one of them is this process. Use as a context manager."""

    def __init__(self, tuning: Tuning, units: list[dict[str, float]], workers: int) -> None:
        self._task = (tuning, units)
        self._pool: ProcessPoolExecutor | None = None
        if workers > 1:
            spawn = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(workers, spawn, _employ, self._task)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    def costs(self, values: list[Values]) -> Iterator[float]:
        """Costs in the order of `values`, one by one."""
        if self._pool:
            return self._pool.map(_work, values)
        return (cost(*self._task, one) for one in values)


_task: tuple[Tuning, list[dict[str, float]]] | None = None


def _employ(*task: Any) -> None:
    """Begin as a worker: an interrupt is for the process that hands out the work."""
    global _task
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _task = (task[0], task[1])


def _work(values: Values) -> float:
    assert _task is not None
    return cost(*_task, values)


def tune(file: Path, out: Path, plan: Plan, command: str, progress: Progress = lambda _: None) -> Tuned:
    """Search, continuing a checkpoint beside `out`, and write the best values to `out`.

    Args:
        file: tuning file.
        out: result, a TOML file that `run --set-file` takes.
        plan: Plan.
        command: for the head of the result.
        progress: called with a Step after every evaluation.

    Raises:
        UserError: a mistake in the file, a foreign checkpoint or a missing package.
    """
    need_packages()
    tuning = read(file)
    try:
        out.resolve().parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out: cannot write {out}: {error.strerror}; accepted is a file in a folder.") from None
    if out.is_dir() or not out.name:
        raise UserError(f"--out: found {out}, a folder; accepted is a TOML file.")
    kept = Checkpoint(checkpoint_file(out), _identity(tuning, plan))
    try:
        units = units_of(tuning)  # also fills the cache of compiled kernels before the workers read it
        begin = decode(tuning.genes, encode(tuning.genes))
        with Crew(tuning, units, plan.workers) as crew:
            run = _Run(tuning, plan, kept, crew, begin, cost(tuning, units, begin), progress)
            run.go()
    finally:
        kept.close()
    changed = {key: (begin[key], value) for key, value in run.best.items()}
    _write(out, file, tuning, plan, run, command)
    return Tuned(run.step, changed, out)


def _identity(tuning: Tuning, plan: Plan) -> dict[str, Any]:
    """What two searches must share to be one; more generations continue a search."""
    digest = hashlib.sha256(json.dumps(tuning).encode()).hexdigest()[:16]
    of_plan = {"method": plan.method, "seed": plan.seed, "population": plan.population}
    return {"version": __version__, "sources": sources(), "tuning": digest, **of_plan}


class _Run:
    """A search under way; `best` are the values of the least cost so far."""

    def __init__(
        self, tuning: Tuning, plan: Plan, kept: Checkpoint, crew: Crew, begin: Values, start: float, progress: Progress
    ) -> None:
        self._tuning, self._plan, self._kept, self._crew, self._tell = tuning, plan, kept, crew, progress
        self._known = {tuple(begin.values()): start}
        self.best, self.step = begin, Step(0, 0, 0, start, start)

    def go(self) -> None:
        plan = self._plan
        generations = search(plan.method, encode(self._tuning.genes), self.step.start, plan.seed, plan.population)
        points = next(generations)
        for number in range(1, plan.generations + 1):
            values = [decode(self._tuning.genes, point) for point in points]
            costs = self._before(number, values) or self._now(number, values)
            try:
                points = generations.send(np.array(costs))
            except StopIteration:
                return

    def _before(self, number: int, values: list[Values]) -> list[float] | None:
        """Costs that the checkpoint holds for this generation."""
        if number > len(self._kept.generations):
            return None
        record = self._kept.generations[number - 1]
        if record["values"] != [list(one.values()) for one in values]:
            raise UserError(
                f"{self._kept.file}: generation {number} is not what this search asks for; pymoo or cma has changed "
                "since; remove it to begin anew."
            )
        for one, its_cost in zip(values, record["costs"], strict=True):
            self._count(one, its_cost, 0)
        self._finish(number, 0)
        return record["costs"]

    def _now(self, number: int, values: list[Values]) -> list[float]:
        """Costs of a generation driven now; what was driven before is known."""
        fresh = {tuple(one.values()): one for one in values if tuple(one.values()) not in self._known}
        for one, its_cost in zip(fresh.values(), self._crew.costs(list(fresh.values())), strict=True):
            self._count(one, its_cost, 1)
        costs = [self._known[tuple(one.values())] for one in values]
        self._kept.add({"generation": number, "costs": costs, "values": [list(one.values()) for one in values]})
        self._finish(number, len(values) - len(fresh))
        return costs

    def _count(self, values: Values, its_cost: float, driven: int) -> None:
        self._known[tuple(values.values())] = its_cost
        if its_cost < self.step.best:
            self.best = values
        step = self.step
        best = min(its_cost, step.best)
        self.step = Step(step.generation, step.evaluations + 1, step.driven + driven, step.start, best)
        self._tell(self.step)

    def _finish(self, number: int, known: int) -> None:
        self.step = self.step._replace(generation=number, evaluations=self.step.evaluations + known)
        self._tell(self.step)


def _write(out: Path, file: Path, tuning: Tuning, plan: Plan, run: _Run, command: str) -> None:
    """The result as a scenario would hold it, below what is needed to repeat the search."""
    step = run.step
    lines = [
        f"# {tuning.title or 'Tuned values'}",
        f"# {command}",
        f"# {file.name}: {plan.method}, seed {plan.seed}, {step.generation} generations of {plan.population}: "
        f"{step.evaluations} evaluations besides the start",
        f"# fitness: start {step.start:.6g} -> best {step.best:.6g}  (1 = {tuning.reference})",
        f"# emran-sumo {__version__}, sources {sources()}",
        "# drive with it: emran-sumo run SCENARIO --set-file THIS_FILE",
    ]
    sections: dict[str, list[str]] = {}
    for key, value in run.best.items():
        section, _, name = key.rpartition(".")
        sections.setdefault(section, []).append(f"{name} = {value!r}")
    for section in sorted(sections):
        lines += ["", *([f"[{section}]"] if section else []), *sections[section]]
    written = out.with_name(f"{out.name}.part")
    written.write_text("\n".join(lines) + "\n", encoding="utf-8")
    written.replace(out)
