"""The paper's figures, drawn from the runs that give the cells of its tables: PNG, SVG and one recording."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from emran_sumo.bench import BenchRun, drive_track
from emran_sumo.errors import UserError
from emran_sumo.loop import AT
from emran_sumo.paper.cases import TABLES
from emran_sumo.paper.drawing import DOTS, Band, Driven, draw, limits, span
from emran_sumo.paper.plates import DRIVERS, PLATES, Panel, Plate
from emran_sumo.paper.rows import rows
from emran_sumo.paper.tables import lost_at
from emran_sumo.print_style import image
from emran_sumo.recording.panels import Line, View, write_panels
from emran_sumo.scenario import build

RECORDING, CAPTIONS = "figures.rrd", "captions.md"
NAME = "Figures of the paper on this plant"
TABS = {
    "III": "28 to 25 m/s", "IV": "Hills", "VI": "Lane change 10 m/s", "VII": "Side force",
    "VIII": "Lane change 20 m/s", "IX": "Gust",
}  # fmt: skip
Progress = Callable[[str, int, int], None]
Runs = dict[tuple[str, str, str], BenchRun]  # by table, case and row


def chosen(tables: Iterable[str]) -> tuple[Plate, ...]:
    """The plates of the tables named, or all.

    Raises:
        UserError: none of the tables has a figure.
    """
    names = set(tables) or set(TABS)
    found = tuple(plate for plate in PLATES if plate.table in names)
    if not found:
        raise UserError(f"--figures: found {', '.join(sorted(names))}; accepted are the tables {', '.join(TABS)}.")
    return found


def write_figures(folder: Path, plates: tuple[Plate, ...] = PLATES, progress: Progress = lambda *_: None) -> list[Path]:
    """Drive what the plates show and write them; returns the files.

    Args:
        folder: created where it is missing.
        plates: which figures.
        progress: told what is done, and how far of how much.

    Raises:
        UserError: the folder is a file or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / CAPTIONS).touch()  # before the drive, not after it
        return _write(folder, plates, driven_cases(plates, progress), progress)
    except OSError as error:
        raise UserError(
            f"--figures: cannot write to {folder} ({error.strerror}); accepted is a folder, new or not."
        ) from None


def _write(folder: Path, plates: tuple[Plate, ...], driven: Runs, progress: Progress) -> list[Path]:
    written = []
    for i, plate in enumerate(plates):
        figure = draw(plate, cases_of(plate, driven))
        for kind in ("png", "svg"):
            file = folder / f"{plate.stem}.{kind}"
            file.write_bytes(image(figure, kind, DOTS))
            written.append(file)
        progress("drawing", i + 1, len(plates))
    (folder / CAPTIONS).write_text(captions(plates), encoding="utf-8")
    write_panels(folder / RECORDING, _tabs(plates, driven), captions(plates), NAME)
    return [*written, folder / CAPTIONS, folder / RECORDING]


def driven_cases(plates: Iterable[Plate], progress: Progress = lambda *_: None) -> Runs:
    """What the plates show, each driven once."""
    wanted = dict.fromkeys((p.table, case, row) for p in plates for case in p.cases for row in p.rows)
    found = {}
    for key in wanted:
        name, case_name, row_name = key
        table = TABLES[name]
        case = next(case for case in table.cases if case.name == case_name)
        row = next(row for row in rows(table.half) if row.name == row_name)
        found[key] = drive_track(build({**case.given, **row.given}))
        progress("driving", len(found), len(wanted))
    return found


def cases_of(plate: Plate, driven: Runs) -> list[Driven]:
    """What the rows of panels of a plate show."""
    listed = []
    for case in plate.cases:
        runs = {row: driven[plate.table, case, row] for row in plate.rows}
        traces = {row: run.trace for row, run in runs.items()}
        lost = {row: when for row, run in runs.items() if (when := lost_at(run)) is not None}
        longest = max(traces.values(), key=len)
        listed.append(Driven(case, traces, lost, longest, bands(longest)))
    return listed


def bands(trace: np.ndarray) -> tuple[Band, ...]:
    """When grade or side force is above half of its largest, as Band."""
    found = []
    for column, words in ((AT.grade, _grade_words), (AT.force_external_lat, _force_words)):
        values = trace[:, column]
        acting = np.abs(values) > 0.5 * np.abs(values).max(initial=0.0)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], acting, [False])).astype(int)))
        for first, after in edges.reshape(-1, 2):
            peak = values[first:after][np.abs(values[first:after]).argmax()]
            found.append(Band(float(trace[first, AT.time]), float(trace[after - 1, AT.time]), words(peak)))
    return tuple(found)


def _grade_words(grade: float) -> str:
    return f"{np.degrees(grade):+.0f}°".replace("-", "\N{MINUS SIGN}")


def _force_words(force: float) -> str:
    return f"{abs(force) / 1000.0:g} kN from the {'right' if force > 0.0 else 'left'}"


def captions(plates: Iterable[Plate]) -> str:
    """Markdown: every figure with its file, caption and case."""
    lines = ["# Figures", ""]
    for plate in plates:
        where = f"case{'s' * (len(plate.cases) > 1)} {', '.join(plate.cases)} of table {plate.table}"
        lines.append(f"- **Fig. {plate.number}** (`{plate.stem}`): {plate.caption} Drawn from {where}.")
    return "\n".join(lines) + "\n"


def _tabs(plates: tuple[Plate, ...], driven: Runs) -> dict[str, list[View]]:
    """The same panels for the recording, a tab per table."""
    tabs: dict[str, list[View]] = {}
    for plate in plates:
        for case in cases_of(plate, driven):
            views = [_view(plate, case, panel) for panel in plate.panels]
            tabs.setdefault(TABS[plate.table], []).extend(views)
    return tabs


def _view(plate: Plate, case: Driven, panel: Panel) -> View:
    whole, column = case.longest, getattr(AT, panel.column)
    curves = []
    if panel.reference:
        curves.append(Line("reference", None, whole[:, [AT.time, getattr(AT, panel.reference)]]))
    curves += [Line(name, DRIVERS.index(name), trace[:, [AT.time, column]]) for name, trace in case.traces.items()]
    where = f", {case.name}" if len(plate.cases) > 1 else ""
    return View(
        f"Fig. {plate.number}: {panel.axis}{where}".replace("m/s2", "m/s²"),
        f"{plate.stem}/{case.name.replace('/', ' ')}/{panel.column}", tuple(curves),
        span(plate, case), limits(plate, panel, case), panel.steps,
    )  # fmt: skip
