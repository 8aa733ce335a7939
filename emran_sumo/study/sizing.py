"""What a study will cost, from a short pilot that leaves nothing behind."""

import json
import secrets
import shutil
import tempfile
from pathlib import Path
from typing import NamedTuple

from emran_sumo.errors import UserError
from emran_sumo.study import identity, plan
from emran_sumo.study.execute import WORST, Settings, automatic_timeout, open_pool, outcomes, stoppable
from emran_sumo.study.plan import Plan
from emran_sumo.study.worker import DONE, Outcome, Task, scratch_folder

PILOTS = 6  # combinations that are tried
SHORT = 5.0  # s that each is driven
_ROW = 1500  # bytes of a row beside its metrics


class Size(NamedTuple):
    """Number of runs and workers; seconds of one run and of the study; bytes of the store and of recordings."""

    runs: int
    workers: int
    each: float
    seconds: float
    store: float
    recordings: float


def estimate(of: Plan, settings: Settings) -> Size:
    """Drive a few combinations of the grid for a few seconds and extrapolate.

    Raises:
        UserError: bad input, or a pilot run failed.
    """
    runs, located = plan.resolve(of)
    short = min(SHORT, *(one.values.duration for one in located))
    base = of.base if "duration" in of.axes else {**of.base, "duration": plan.Given(short, "pilot")}
    tried, there = plan.resolve(of._replace(base=base, seeds=of.seeds[:1]))
    step = -(-len(tried) // PILOTS)
    scale = {
        run.key: full.values.duration / here.values.duration
        for run, here, full in zip(tried, there, located, strict=True)
    }
    now, recorded, scratch = identity.of(located), of.record != "none", f"pilot-{secrets.token_hex(6)}"
    limit = of.timeout or max(map(automatic_timeout, located))
    tasks = [Task(r.key, r.scenario, r.given, now, limit, recorded, scratch) for r in tried[::step]]
    with tempfile.TemporaryDirectory() as folder, stoppable():
        pool = open_pool(settings._replace(workers=1), Path(folder) / "log", located, lambda: None)
        try:
            found = [outcome for outcome, _ in outcomes(pool, iter(tasks))]
            workers = pool.room // 2 if settings.dask else settings.processes()
        finally:
            pool.close()
            shutil.rmtree(scratch_folder(scratch), ignore_errors=True)
    for outcome in found:
        if outcome.state != DONE:
            raise UserError(f"--dry-run: a pilot run failed: {(outcome.error or outcome.state).rstrip('.')}.")
    return _sized(found, scale, len(runs), workers, of.record)


def _sized(found: list[Outcome], scale: dict[str, float], runs: int, workers: int, record: str) -> Size:
    n = len(found)
    around = min(o.wall - o.simulation for o in found)  # the first run of a process also loads the libraries
    each = around + sum(o.simulation + (scale[o.key] - 1.0) * o.driving for o in found) / n
    store = runs * (_ROW + sum(len(json.dumps(o.metrics)) for o in found) / n)
    kept = {"all": runs, "worst": min(WORST, runs)}.get(record, 0)
    recording = sum(len(o.recording or b"") * scale[o.key] for o in found) / n
    return Size(runs, workers, each, runs * each / min(workers, runs), store, kept * recording)
