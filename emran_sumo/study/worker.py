"""One run of a study, wherever it is driven: in a pool's process on this machine or on a cluster's worker."""

import contextlib
import errno
import faulthandler
import json
import multiprocessing
import os
import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

from emran_sumo.errors import Interrupted, UserError

DONE, FAILED, CHANGED, NO_SPACE, INTERRUPTED = "done", "failed", "changed", "no space", "interrupted"
CLOCKS = ("run.real_time_factor",)  # metrics of the machine, not of the run
BAD = ("collision", "diverged", "lost")  # ends, worst first
_SUMS = (
    "safety.collisions",
    "safety.conflicts",
    "run.distance",
    "run.simulated",
    "run.lane_changes",
)  # over several egos
_DISK = (errno.ENOSPC, errno.EROFS, errno.EDQUOT)

_one_at_a_time = threading.Lock()  # libsumo holds one simulation per process


class Task(NamedTuple):
    """A run to drive.

    key: of the run; scenario, given: what to load; identity: what it must be driven with; timeout [s]; record: bring
    the recording; scratch: name of a folder for temporary files.
    """

    key: str
    scenario: str
    given: dict[str, Any]
    identity: dict[str, str]
    timeout: float
    record: bool
    scratch: str


class Outcome(NamedTuple):
    """What became of a run.

    state: DONE or FAILED, which are rows, or why the study cannot go on; metrics: dotted name -> value; wall: of
    everything [s]; simulation: of warm-up and drive alone [s]; driving: of the drive alone [s];
    recording: content of the .rrd.
    """

    key: str
    state: str
    ended: str = ""
    reason: str = ""
    error: str = ""
    metrics: dict[str, Any] | None = None
    wall: float = 0.0
    simulation: float = 0.0
    driving: float = 0.0
    recording: bytes | None = None


class _Stopwatch:
    """Time [s] spent in simulation, as the run's progress tells it."""

    def __init__(self) -> None:
        self.first = self.began = self.last = 0.0  # of the simulation, of the drive, of both

    def __call__(self, phase: str, _done: float, _total: float) -> None:
        if phase in ("warm-up", "wait", "drive"):
            self.last = time.perf_counter()
            self.first = self.first or self.last
            if phase == "drive":
                self.began = self.began or self.last


def begin(log: str) -> None:
    """Prepare a process of the local pool: Ctrl-C is the coordinator's, output goes to a file, no life of its own."""
    with contextlib.suppress(OSError, AttributeError):
        os.setpgid(0, 0)
    stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(stream, 1)
    os.dup2(stream, 2)
    os.close(stream)
    faulthandler.enable()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A killed coordinator leaves its processes waiting for work forever, if they do not look after themselves."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def drive_task(task: Task) -> Outcome:
    """Drive a run; every error becomes a word, because SUMO's exceptions cannot be pickled."""
    with _one_at_a_time, open(os.devnull, "w") as nowhere:
        began = time.perf_counter()
        # a hanging library cannot be interrupted, only ended together with its process
        faulthandler.dump_traceback_later(task.timeout, exit=True, file=nowhere)
        try:
            outcome = _driven(task)
        except (KeyboardInterrupt, Interrupted):
            outcome = Outcome(task.key, INTERRUPTED)
        except OSError as error:
            state = NO_SPACE if error.errno in _DISK else FAILED
            outcome = Outcome(task.key, state, error=f"{type(error).__name__}: {error}")
        except Exception as error:
            outcome = Outcome(task.key, FAILED, error=_one_line(error))
        finally:
            faulthandler.cancel_dump_traceback_later()
        return outcome._replace(wall=time.perf_counter() - began)


def _driven(task: Task) -> Outcome:
    from emran_sumo import drive
    from emran_sumo.scenario import load
    from emran_sumo.study import identity
    from emran_sumo.study.plan import run_key

    located = load(task.scenario, {key: (value, "study") for key, value in task.given.items()})
    now = identity.of([located])
    differ = identity.differences({k: v for k, v in task.identity.items() if k in now}, now)
    if differ or run_key(located) != task.key:
        return Outcome(task.key, CHANGED, error=differ[0] if differ else f"{task.scenario} has changed")
    base = scratch_folder(task.scratch)
    base.mkdir(exist_ok=True)
    folder = tempfile.mkdtemp(dir=base)
    watch = _Stopwatch()
    try:
        result = drive.run(located, folder, record=task.record, command="study", progress=watch)
        summary = json.loads((result.folder / "summary.json").read_text(encoding="utf-8"))
        recording = (result.folder / "run.rrd").read_bytes() if task.record else None
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    if result.ended == "interrupted":
        return Outcome(task.key, INTERRUPTED)
    ended, reason, found = together(summary)
    spent, driving = watch.last - watch.first, watch.last - watch.began
    return Outcome(task.key, DONE, ended, reason, "", found, 0.0, spent, driving, recording)


def scratch_folder(name: str) -> Path:
    """Where the runs of a study keep their temporary files on this machine."""
    return Path(tempfile.gettempdir()) / f"emran-sumo-study-{name}"


def together(summary: dict[str, Any]) -> tuple[str, str, dict[str, Any]]:
    """ended, reason and metrics of a run; of several egos the worst end, sums, extremes and means over all of them."""
    egos = list(summary.get("egos", {"": summary}).values())
    worst = min(egos, key=lambda ego: BAD.index(ego["ended"]) if ego["ended"] in BAD else len(BAD))
    each = [scalars(ego["metrics"]) for ego in egos]
    found = {
        name: _merged(name, [one[name] for one in each if one.get(name) is not None])
        for name in dict.fromkeys(name for one in each for name in one)
        if name not in CLOCKS
    }
    return worst["ended"], worst["reason"], {**found, "run.egos": len(egos)}


def _merged(name: str, values: list[Any]) -> Any:
    if len(values) < 2 or isinstance(values[0], str):
        return values[0] if values else None
    if name in _SUMS:
        return sum(values)
    if name.endswith("_min"):
        return min(values)
    return max(values) if name.endswith("_max") else sum(values) / len(values)


def scalars(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted name -> value of nested metrics."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            found |= scalars(value, f"{prefix}{key}.")
        elif value is None or isinstance(value, bool | int | float | str):
            found[prefix + key] = value
    return found


def _one_line(error: Exception) -> str:
    text = " ".join(str(error).split()) or "no message"
    return text if isinstance(error, UserError) else f"{type(error).__name__}: {text}"
