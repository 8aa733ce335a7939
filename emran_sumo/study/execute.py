"""Drive what is missing of a study: futures in, rows out; this process alone writes."""

import json
import os
import secrets
import shutil
import signal
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from emran_sumo.errors import UserError
from emran_sumo.opening import opening
from emran_sumo.scenario import Located, flat, to_dict
from emran_sumo.study import identity, plan, statistics
from emran_sumo.study.plan import Plan, Run
from emran_sumo.study.pool import LocalPool, Pool
from emran_sumo.study.store import Counts, Row, Store
from emran_sumo.study.worker import CHANGED, DONE, FAILED, INTERRUPTED, NO_SPACE, Outcome, Task, scratch_folder

TRIES = 2  # of a run whose process died: a kill from outside is not the run's fault
WORST = 10  # recordings that `record = "worst"` keeps
RECORDINGS = "recordings"

Told = Callable[[str, Counts], None]  # what is being done, how far it is


class Settings(NamedTuple):
    """How to drive, which changes no row: workers 0 for all cores; dask: address of a scheduler."""

    workers: int = 0
    dask: str = ""
    retry_failed: bool = False

    def processes(self) -> int:
        """Processes of the local pool."""
        usable = getattr(os, "sched_getaffinity", None)
        return self.workers or (len(usable(0)) if usable else os.cpu_count() or 1)


def study(folder: Path, of: Plan, settings: Settings, told: Told = lambda *_: None) -> Counts:
    """Drive a study, or what is missing of it.

    Args:
        folder: of the study.
        of: the plan.
        settings: how.
        told: called with what is being done and the counts.

    Raises:
        UserError: bad input, another study's folder, a changed scenario or version, a full disk.
        KeyboardInterrupt: stopped; what is done is in the store.
    """
    runs, located = plan.resolve(of)
    for one in {(s.values.world, *inputs_of(s)): s for s in located}.values():
        opening(one)  # a missing file or ego is the user's mistake, not one of every run
    now = identity.of(located)
    with Store(folder, write=True) as store:
        _refuse_another(store, of, runs, located, now)
        store.note(
            plan=describe(of), identity=now, values=values_of(of, located),
            scratch=store.manifest().get("scratch") or secrets.token_hex(6),
            session={"began": time.time(), "pid": os.getpid(), "host": socket.gethostname(),
                     "where": settings.dask or f"{settings.processes()} processes"},
        )  # fmt: skip
        store.enroll(runs)
        if settings.retry_failed:
            store.forget_failed()
        _Session(store, of, runs, located, now, told).drive(settings)
        return store.counts()


def inputs_of(located: Located) -> tuple[Any, ...]:
    """What of a scenario decides which files it opens."""
    s = located.values
    return located.folder, s.network, s.routes, s.additional, s.config, s.ego


def describe(of: Plan) -> dict[str, Any]:
    """A plan as the manifest keeps it."""
    return {
        "name": of.name,
        "title": of.title,
        "scenarios": list(of.scenarios),
        "set": {key: value for key, (value, _) in of.base.items()},
        "grid": {key: list(values) for key, (values, _) in of.axes.items()},
        "seeds": list(of.seeds),
    }


def _refuse_another(store: Store, of: Plan, runs: list[Run], located: list[Located], now: dict[str, str]) -> None:
    """A study may grow; it never mixes with another one, nor with other versions or files."""
    manifest = store.manifest()
    if "identity" not in manifest:
        return
    before, after = manifest["plan"], describe(of)
    stranger = f"{store.folder}: this folder holds another study"
    if set(before["scenarios"]) - set(of.scenarios):
        theirs, ours = ", ".join(before["scenarios"]), ", ".join(of.scenarios)
        raise UserError(f"{stranger}, of {theirs} instead of {ours}; accepted is another --out.")
    differ = [text for text in identity.differences(manifest["identity"], now) if not text.endswith("is new")]
    if store.keys() - {run.key for run in runs}:
        differ += identity.differences(manifest["values"], values_of(of, located))
        differ += [f"{name} is {before[name]} there and {after[name]} here" for name in ("grid", "seeds")
                   if before[name] != after[name]]  # fmt: skip
        differ = differ or ["other values"]
    if differ:
        raise UserError(
            f"{store.folder}: not as this study was begun: {'; '.join(differ[:5])}; accepted is what it was begun "
            "with, a grid that only grows, or another --out."
        )


def values_of(of: Plan, located: list[Located]) -> dict[str, str]:
    """Every value of each scenario that the grid does not vary, in words."""
    found: dict[str, str] = {}
    for one in located:
        for key, value in flat(to_dict(one.values)).items():
            if key not in of.axes and key != "seed":
                found.setdefault(f"{one.name}: {key}", str(value))
    return found


class _Session:
    """One stretch of work on a study."""

    def __init__(
        self, store: Store, of: Plan, runs: list[Run], located: list[Located], now: dict[str, str], told: Told
    ) -> None:
        self.store, self.plan, self.runs, self.located, self.identity = store, of, runs, located, now
        self.limit = of.timeout or max(map(automatic_timeout, located))
        self.told = told
        self.scratch = store.manifest()["scratch"]

    def drive(self, settings: Settings) -> None:
        """All missing runs, then the recordings that are wanted."""
        missing = self.store.keys(missing=True)
        waiting = plan.in_order_of_driving([run for run in self.runs if run.key in missing])
        if not waiting and not self._unrecorded():
            return
        shutil.rmtree(scratch_folder(self.scratch), ignore_errors=True)  # of a session that was killed
        with stoppable():
            pool = open_pool(settings, self.store.folder / "workers.log", self.located, lambda: self._say("compiling"))
            try:
                self._say("driving")
                for outcome, tries in outcomes(pool, (self._task(run) for run in waiting)):
                    self._enter(outcome, tries)
                    self._say("driving")
                replays = self._unrecorded()
                before = {row.run.key: row for row in replays}
                if replays:
                    self._say("recording")
                for outcome, _ in outcomes(pool, (self._task(row.run, record=True) for row in replays)):
                    refuse_other_numbers(outcome, before[outcome.key], self.store.folder)
                    self._keep(outcome)
                    self._say("recording")
            finally:
                pool.close()
                shutil.rmtree(scratch_folder(self.scratch), ignore_errors=True)

    def _say(self, what: str) -> None:
        self.told(what, self.store.counts())

    def _task(self, run: Run, record: bool = False) -> Task:
        record = record or self.plan.record == "all"
        return Task(run.key, run.scenario, run.given, self.identity, self.limit, record, self.scratch)

    def _enter(self, outcome: Outcome, tries: int) -> None:
        refuse_to_go_on(outcome, self.store.folder)
        if outcome.state != INTERRUPTED:
            self.store.write(outcome, tries)
            self._keep(outcome)

    def _keep(self, outcome: Outcome) -> None:
        """Put a recording beside the store."""
        refuse_to_go_on(outcome, self.store.folder)
        if outcome.recording is None:
            return
        run = next(run for run in self.runs if run.key == outcome.key)
        file = self.store.folder / RECORDINGS / f"{plan.run_name(run)}.rrd"
        part = file.with_suffix(".part")
        try:
            file.parent.mkdir(exist_ok=True)
            part.write_bytes(outcome.recording)
            part.replace(file)
        except OSError as error:
            raise UserError(f"{file}: cannot be written: {error.strerror}.") from None
        self.store.keep(outcome.key, f"{RECORDINGS}/{file.name}")

    def _unrecorded(self) -> list[Row]:
        """Rows whose recording is wanted and not there; a run repeats itself bit for bit, so it is driven again."""
        if self.plan.record == "none":
            return []
        rows = [row for row in self.store.rows() if row.state == DONE]
        if self.plan.record == "worst":
            rows = statistics.worst(rows, WORST)
        elif self.plan.record == "failed":
            rows = [row for row in rows if row.ended not in statistics.GOOD]
        return [row for row in rows if not row.recording]


def automatic_timeout(located: Located) -> float:
    """Far more than a run needs [s]: 20 times what it simulates, and two minutes."""
    return 120.0 + 20.0 * (located.values.warm_up + located.values.duration)


def open_pool(settings: Settings, log: Path, located: list[Located], told: Callable[[], None]) -> Pool:
    """The cluster, or processes of this machine with their kernels compiled once, here."""
    if settings.dask:
        from emran_sumo.study.cluster import ClusterPool

        return ClusterPool(settings.dask)
    from emran_sumo import warm

    for scenario in {warm.kinds(one.values): one.values for one in located}.values():
        if not warm.warm(scenario):
            told()
            warm.warm_kernels(scenario)
    return LocalPool(settings.processes(), log)


def outcomes(pool: Pool, tasks: Iterator[Task]) -> Iterator[tuple[Outcome, int]]:
    """Drive tasks; yields what became of each, and after how many tries, as they end."""
    again: deque[tuple[Task, int]] = deque()
    under_way: dict[Future[Outcome], tuple[Task, int, float]] = {}
    while True:
        while len(under_way) < pool.room:
            task, tries = again.popleft() if again else (next(tasks, None), 1)
            if task is None:
                break
            under_way[pool.submit(task)] = (task, tries, time.monotonic())
        if not under_way:
            return
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            task, tries, began = under_way.pop(future)
            pool.settle(future)
            lasted = time.monotonic() - began
            error = future.exception()
            if error is None:
                yield future.result(), tries
            elif isinstance(error, pool.died) and lasted < task.timeout and tries < TRIES:
                again.append((task, tries + 1))
            else:
                yield Outcome(task.key, FAILED, error=_said(error, pool, lasted, task), wall=lasted), tries


def _said(error: BaseException, pool: Pool, lasted: float, task: Task) -> str:
    if not isinstance(error, pool.died):
        return f"{type(error).__name__}: {error}"
    if lasted >= task.timeout:
        return f"timed out after {task.timeout:g} s"
    return f"the process that drove it died, {TRIES} times"


def refuse_to_go_on(outcome: Outcome, folder: Path) -> None:
    """Raise where one outcome spoils all that follow."""
    if outcome.state == CHANGED:
        raise UserError(
            f"{folder}: {outcome.error} while the study ran; accepted is what it was begun with, or another --out."
        )
    if outcome.state == NO_SPACE:
        raise UserError(f"{folder}: stopped, no run is lost: {outcome.error}; the same command goes on.")


def refuse_other_numbers(outcome: Outcome, before: Row, folder: Path) -> None:
    """Raise where a run that was driven again is not what it was."""
    if outcome.state == DONE and json.dumps(outcome.metrics) != json.dumps(before.metrics):
        raise UserError(
            f"{folder}: {plan.replay(before.run)} gave other numbers when driven again; accepted are machines that "
            "round alike for all runs of a study."
        )


@contextmanager
def stoppable() -> Iterator[None]:
    """SIGTERM stops like Ctrl-C."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    try:
        saved = signal.signal(signal.SIGTERM, stop)
    except ValueError:  # only the main thread may
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, saved)
