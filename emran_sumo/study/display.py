"""A study on the terminal: its progress while it drives, its state from elsewhere."""

import time
from pathlib import Path
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from emran_sumo.study.plan import Plan
from emran_sumo.study.sizing import Size
from emran_sumo.study.store import Counts, Store, is_running

_WORDS = {
    "compiling": "compiling the kernels, once per version: about half a minute",
    "driving": "driving",
    "recording": "driving again, with recording",
}
_EVERY = 30.0  # s between lines where there is no terminal


class Display:
    """Progress on stderr; use as a context manager and pass `told` to the study."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=None, note="")
        self._began = self._shown = 0.0
        self._first = 0
        self._last = ""

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_) -> None:
        self._bar.stop()

    def told(self, what: str, counts: Counts) -> None:
        """Show what is being done and how far it is."""
        now = time.monotonic()
        ended = counts.done + counts.failed
        if what != self._last:
            self._last, self._began, self._first, self._shown = what, now, ended, 0.0
        note = progress(counts, ended - self._first, now - self._began)
        self._bar.update(
            self._task, description=_WORDS[what], note=note, completed=ended, total=counts.total if ended else None
        )
        if not self._console.is_terminal and now - self._shown > _EVERY:
            self._console.print(f"{_WORDS[what]}: {note}", highlight=False)
            self._shown = now


def progress(counts: Counts, ended: int, seconds: float) -> str:
    """One line: runs done and failed, and, from `ended` runs in `seconds`, their rate and the time left."""
    said = f"{counts.done + counts.failed} of {counts.total} runs, {counts.failed} failed"
    left = counts.total - counts.done - counts.failed
    if ended > 0 and seconds > 0.0 and left:
        said += f", {60.0 * ended / seconds:.0f} per minute, {span(seconds / ended * left)} left"
    return said


def span(seconds: float) -> str:
    """A time in words."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def show_status(folder: Path) -> None:
    """Print how far the study in `folder` is, also while it runs elsewhere."""
    console = Console()
    with Store(folder) as store:
        manifest, counts = store.manifest(), store.counts()
        session = manifest.get("session", {})
        running = is_running(folder)
        if manifest.get("plan", {}).get("title"):
            console.print(manifest["plan"]["title"], style="bold", highlight=False)
        state = f"running on {session.get('where')}" if running else "not running"
        if counts.done + counts.failed == counts.total:
            state = "complete" if not running else "complete, finishing"
        began = session.get("began", time.time())
        line = progress(counts, store.finished_since(began) if running else 0, time.time() - began)
        console.print(f"{folder}: {state}: {line}", highlight=False, soft_wrap=True)
        for error, count in store.errors()[:10]:
            console.print(f"  {count} x {error}", style="red", highlight=False, soft_wrap=True, markup=False)


def show_end(folder: Path, counts: Counts) -> None:
    """Print how a study ended."""
    console = Console()
    style = "bold red" if counts.failed else "bold"
    console.print(f"{counts.done} of {counts.total} runs done, {counts.failed} failed.", style=style, highlight=False)
    if counts.failed:
        console.print(f"why: emran-sumo study status {folder}; once more: the same command with --retry-failed",
                      highlight=False, soft_wrap=True)  # fmt: skip


def show_size(size: Size, of: Plan) -> None:
    """Print what a study will cost."""
    console = Console()
    cells = size.runs // len(of.seeds)
    console.print(f"{size.runs} runs: {cells} combinations x {len(of.seeds)} seeds", highlight=False)
    workers = f"{size.workers} worker{'s' if size.workers != 1 else ''}"
    console.print(f"time: about {span(size.seconds)} on {workers}, {size.each:.2f} s per run", highlight=False)
    disk = f"disk: about {size.store / 1e6:.1f} MB"
    if of.record in ("all", "worst"):
        disk += f", and {size.recordings / 1e6:.0f} MB of recordings"
    if of.record == "failed":
        disk += ", and the recordings of runs that end badly"
    console.print(disk, highlight=False)
