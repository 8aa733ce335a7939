"""Processes of this machine that drive runs: the death of one costs the others nothing."""

from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Protocol

from emran_sumo.study.worker import Outcome, Task, begin, drive_task

RECYCLE = 50  # runs of a process before a fresh one takes its place


class Pool(Protocol):
    """Where runs are driven."""

    @property
    def died(self) -> tuple[type[BaseException], ...]:
        """Errors of a future whose process died."""
        ...

    @property
    def room(self) -> int:
        """How many runs may be under way."""
        ...

    def submit(self, task: Task) -> "Future[Outcome]":
        """Start a run; its future tells what became of it."""
        ...

    def settle(self, future: "Future[Outcome]") -> None:
        """Take back the place of a future that is done."""
        ...

    def close(self) -> None:
        """End everything at once."""
        ...


class _Slot:
    """A pool of one process. With one process per pool a death breaks no other run, and it is known whose it was."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._process: BaseProcess | None = None
        self._runs = 0
        self._open()

    def _open(self) -> None:
        self._executor = ProcessPoolExecutor(1, get_context("spawn"), initializer=begin, initargs=(str(self._log),))
        self._runs = 0

    def submit(self, task: Task) -> "Future[Outcome]":
        if self._runs >= RECYCLE:  # max_tasks_per_child of the library can deadlock (python/cpython#115634)
            self.renew()
        self._runs += 1
        before = set(active_children())
        try:
            future = self._executor.submit(drive_task, task)
        except BrokenProcessPool:  # it died while it had nothing to do
            self.renew()
            future = self._executor.submit(drive_task, task)
        self._process = next(iter(set(active_children()) - before), self._process)
        return future

    def renew(self) -> None:
        """Let the process go and take a new one."""
        self._executor.shutdown(wait=False)
        self._open()

    def kill(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)
        if self._process is not None and self._process.is_alive():
            self._process.kill()


class LocalPool:
    """`workers` spawned processes, each its own executor.

    Args:
        workers: how many.
        log: file that takes what the processes print.
    """

    died: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, workers: int, log: Path) -> None:
        self._free = [_Slot(log) for _ in range(workers)]
        self._busy: dict[Future[Outcome], _Slot] = {}

    @property
    def room(self) -> int:
        """How many runs may be under way."""
        return len(self._free) + len(self._busy)

    def submit(self, task: Task) -> "Future[Outcome]":
        """Start a run in a free process."""
        slot = self._free.pop(0)
        future = slot.submit(task)
        self._busy[future] = slot
        return future

    def settle(self, future: "Future[Outcome]") -> None:
        """Take back the process of a future that is done; a fresh one for a dead one."""
        slot = self._busy.pop(future)
        if isinstance(future.exception(), self.died):
            slot.renew()
        self._free.append(slot)

    def close(self) -> None:
        """Kill all processes."""
        for slot in (*self._free, *self._busy.values()):
            slot.kill()
