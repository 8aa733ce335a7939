"""What a run shows on the terminal: a progress bar while it drives, a table when it is done."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskID, TextColumn
from rich.table import Table

if TYPE_CHECKING:
    from emran_sumo.compare import Row
    from emran_sumo.drive import RunResult
    from emran_sumo.tune import Step, Tuned
    from emran_sumo.world.native import Native

_WORDS = {
    "load": "loading",
    "compile": "compiling the kernels, once per version: about half a minute",
    "warm-up": "warming up the traffic",
    "wait": "waiting for the ego to depart",
    "native": "the same with SUMO driving",
    "drive": "driving",
    "draw": "drawing",
}
_REFRESH = 0.1  # s
HARMED_SHOWN = 10  # egos that came to harm


class Display:
    """Progress of a run on stderr; use as a context manager and pass `phase` as the run's progress.

    Where stderr is no terminal only the compilation is told, which takes long enough to look like a hang.
    """

    def __init__(self) -> None:
        console = Console(stderr=True)
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[note]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task: TaskID | None = None
        self._name = self._whose = ""
        self._began = self._shown = 0.0

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_) -> None:
        self._progress.stop()

    def about(self, whose: str) -> Callable[[str, float, float], None]:
        """`phase` for one of several runs, whose name is shown in front."""
        self._name, self._whose = "", f"{whose}: "
        return self.phase

    def phase(self, name: str, done: float, total: float) -> None:
        """Show that phase `name` has done `done` of `total` seconds; 0 of 0 where it cannot be known."""
        now = time.perf_counter()
        if name != self._name:
            self._begin(name, now, total)
        elif now - self._shown < _REFRESH and done < total:
            return
        self._shown = now
        note = ""
        if name == "drive" and now > self._began:
            note = f"{done:5.1f} / {total:g} s, {done / (now - self._began):.0f} x real time"
        elif name == "wait":
            note = f"{done:5.1f} s"
        elif name in ("warm-up", "native", "draw"):
            note = f"{done:5.1f} / {total:g} s"
        assert self._task is not None
        self._progress.update(self._task, completed=done, note=note)

    def _begin(self, name: str, now: float, total: float) -> None:
        if self._task is not None:
            self._progress.remove_task(self._task)
        if name == "compile" and not self._progress.console.is_terminal:
            self._progress.console.print(_WORDS[name])
        self._task = self._progress.add_task(
            self._whose + _WORDS[name], total=total if name != "compile" else None, note=""
        )
        self._name, self._began = name, now


class SearchDisplay:
    """Progress of a search on stderr: generation, evaluations, fitness, time left; a line per generation where stderr
    is no terminal."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}")
        self._progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        self._task = self._progress.add_task("loading", total=None, note="")
        self._generations = self._budget = self._told = 0
        self._began = 0.0

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_) -> None:
        self._progress.stop()

    def begin(self, generations: int, population: int, compiled: bool) -> None:
        """The search begins with the runs of the reference, which may first have to be compiled."""
        self._generations, self._budget = generations, generations * population
        text = "driving the reference" if compiled else _WORDS["compile"]
        self._progress.update(self._task, description=text)
        if not compiled and not self._progress.console.is_terminal:
            self._progress.console.print(text)

    def step(self, step: "Step") -> None:
        """Show where the search stands."""
        now = time.perf_counter()
        if not self._began:
            self._began = now
            self._progress.update(self._task, total=self._budget)
        note = f"{step.evaluations} of {self._budget} runs of all cases, fitness {step.start:.4f} -> {step.best:.4f}"
        if step.driven > 1:
            left = (now - self._began) / (step.driven - 1) * (self._budget - step.evaluations)
            note += f", {left // 60:.0f} min {left % 60:02.0f} s left"
        text = f"generation {min(step.generation + 1, self._generations)} of {self._generations}"
        self._progress.update(self._task, description=text, completed=step.evaluations, note=note)
        if step.generation > self._told and not self._progress.console.is_terminal:
            text = f"generation {step.generation} of {self._generations}: {note}"
            self._progress.console.print(text, highlight=False, soft_wrap=True)
        self._told = step.generation


def show_tuned(tuned: "Tuned") -> None:
    """Print what a search found and how to drive with it."""
    console, step = Console(), tuned.step
    better = step.best < step.start
    text = f"fitness {step.start:.4f} -> {step.best:.4f} after {step.evaluations} evaluations"
    console.print(text if better else f"{text}: nothing better than the start", style="bold", highlight=False)
    table = Table("", "start", "best", box=None, header_style="dim", pad_edge=False)
    for key, (start, best) in tuned.changed.items():
        table.add_row(key, f"{start:g}", f"{best:g}")
    console.print(table)
    file = _shown(tuned.file)
    console.print(
        f"\n{file}\ndrive with it:  emran-sumo run SCENARIO --set-file {file}", highlight=False, soft_wrap=True
    )


def show(result: "RunResult", recorded: bool) -> None:
    """Print how a run ended, its table, and where its files lie."""
    import json

    from emran_sumo.report import ends, rows, verdict

    console = Console()
    summary = json.loads((result.folder / "summary.json").read_text(encoding="utf-8"))
    good = result.ended in ("finished", "arrived")
    console.print(verdict(summary), style="bold" if good else "bold red", highlight=False, soft_wrap=True)
    for note in summary["notes"]:
        console.print(f"note: {note}", style="dim", highlight=False, soft_wrap=True)
    table = Table("", "", "RMS or value", "max", box=None, header_style="dim", pad_edge=False)
    group = ""
    for row in rows(summary):
        if group and row.group != group:
            table.add_row()
        table.add_row(row.group if row.group != group else "", row.name, row.value, row.most)
        group = row.group
    console.print(table)
    numbers, harmed = ends(summary)
    if numbers:
        console.print(f"\n{numbers}; the table is of {summary['ego']}", highlight=False, soft_wrap=True)
    for line in harmed[:HARMED_SHOWN]:
        console.print(escape(line), style="red", highlight=False, soft_wrap=True)
    if len(harmed) > HARMED_SHOWN:
        console.print(f"and {len(harmed) - HARMED_SHOWN} more in summary.json", style="red", highlight=False)
    files = [name for name in ("run.rrd", "trace.parquet", "summary.json") if (result.folder / name).exists()]
    console.print(f"\n{_shown(result.folder)}/  {'  '.join(files)}", highlight=False, soft_wrap=True)
    if recorded:
        console.print(f"open it:  rerun {_shown(result.folder / 'run.rrd')}", highlight=False, soft_wrap=True)


def show_native(result: "RunResult", native: "Native") -> None:
    """Print the ego beside SUMO's own driving of the same vehicle."""
    run, wake = result.metrics["run"], result.metrics["wake"]
    table = Table("", "ego", "SUMO", box=None, header_style="dim", pad_edge=False, title="beside SUMO's own driver")
    table.add_row("ended", result.ended, native.ended)
    rows = (
        ("time", run["simulated"], native.time, "s"),
        ("distance", run["distance"], native.distance, "m"),
        ("hardest braking of a follower", wake["follower_decel_max"], native.wake["follower_decel_max"], "m/s²"),
        ("delay of the followers", wake["follower_delay"], native.wake["follower_delay"], "s"),
    )
    for name, ours, theirs, unit in rows:
        table.add_row(name, f"{ours:.1f} {unit}", f"{theirs:.1f} {unit}")
    Console().print("", table)


def show_comparison(file: Path, controllers: list[str], rows: "list[Row]") -> None:
    """Print one row per measure, one column per controller; the best value of a row is marked."""
    console = Console()
    table = Table("", "", box=None, header_style="bold", pad_edge=False)
    for name in controllers:
        table.add_column(name, justify="right", no_wrap=True)
    group = ""
    for row in rows:
        if group and row.group != group:
            table.add_row()
        cells = (f"[bold green]{text} *[/]" if i in row.best else f"{text}  " for i, text in enumerate(row.values))
        table.add_row(row.group if row.group != group else "", escape(row.words), *cells)
        group = row.group
    console.print(table)
    console.print("* best of the row", style="dim", highlight=False)
    console.print(f"\nopen it:  emran-sumo view {_shown(file)}", highlight=False, soft_wrap=True)


def _shown(path: Path) -> str:
    """Shorter of the path as given and the path from here."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)
