"""`emran-sumo paper`: words in, tables out."""

import json
from pathlib import Path

from rich.console import Console

from emran_sumo.errors import UserError
from emran_sumo.kernels import compiled_before
from emran_sumo.paper import document, layout, show, tables
from emran_sumo.paper.tables import Condition, Record
from emran_sumo.paper.timing import HOW, timings


def paper(
    names: list[str], *, json_file: Path | None = None, markdown: Path | None = None, literal: bool = False,
    noise: bool = False, delay: int = 0, figures: Path | None = None, workers: int | None = None,
) -> None:  # fmt: skip
    """Recompute the tables `names`, or all of them, and print them; see the command line for the rest.

    `markdown` and `figures` are written instead of tables on the terminal; `names` choose whose figures.

    Raises:
        UserError: a table or a delay that is none, or a file in no folder.
    """
    for flag, file in (("--json", json_file), ("--markdown", markdown)):
        if file and (file.is_dir() or not file.resolve().parent.is_dir()):
            raise UserError(f"{flag}: found {file}; accepted is a file in a folder that exists.")
    how, wanted = tables.condition(noise, delay), tables.chosen(names)
    if markdown and (names or json_file or literal or noise or delay):
        raise UserError("--markdown: writes every table in every condition; accepted without other options.")
    if figures and (markdown or json_file or literal or noise or delay):
        raise UserError("--figures: writes the figures instead of the tables; accepted with names of tables alone.")
    if literal and (len(tables.driven_tables(wanted)) < len(names) or ({*wanted} & {*tables.ADD_ON} and names)):
        raise UserError("--literal: accepted with the tables III to IX, XI, XII and blind.")
    out = show.console()
    if not compiled_before():
        out.print("compiling the kernels, once per version: about half a minute")
    if markdown:
        markdown.write_text(_whole(workers), encoding="utf-8")
        return
    if figures:
        _draw(figures, names, wanted, out)
        return
    sheets, records = _computed(wanted, how, literal, workers)
    for sheet in sheets:
        show.show(sheet, out)
    if json_file:
        text = json.dumps([record._asdict() for record in records], indent=1)
        json_file.write_text(text + "\n", encoding="utf-8")


def _draw(folder: Path, names: list[str], wanted: tuple[str, ...], out: Console) -> None:
    from emran_sumo.paper.figures import chosen, write_figures

    plates = chosen(wanted if names else ())
    with show.progress() as bar:
        task = bar.add_task("driving")
        files = write_figures(
            folder, plates, lambda what, done, total: bar.update(task, description=what, completed=done, total=total)
        )
    out.print(f"{len(plates)} figures as PNG and SVG, {files[-2].name} and {files[-1].name} in {folder}", markup=False)


def _computed(
    wanted: tuple[str, ...], how: Condition, literal: bool, workers: int | None
) -> tuple[list[layout.Sheet], list[Record]]:
    sheets: list[layout.Sheet] = []
    records: list[Record] = []
    with show.progress() as bar:
        task = bar.add_task("driving")
        driven = tables.driven_tables(wanted)
        if driven:
            found = tables.results(
                driven, how, literal, workers, lambda done, total: bar.update(task, completed=done, total=total)
            )
            sheets += layout.sheets(driven, found, how)
            sheets += [layout.literal_sheet(found)] if literal else []
            records += tables.records(driven, found, how)
        if "memory" in wanted and not literal:
            passes = tables.memory_results(
                how, workers, lambda done, total: bar.update(task, completed=done, total=total)
            )
            sheets.append(layout.memory_sheet(passes, how))
            records += tables.memory_records(passes, how)
    if "timing" in wanted and not literal:
        times = timings()
        sheets.append(layout.timing_sheet(times, HOW))
        records += tables.timing_records(times)
    return sheets, records


def _whole(workers: int | None) -> str:
    """The document: everything, in every condition."""
    everything = tables.chosen([])
    cases = tuple(name for name in everything if name in tables.TABLES)
    plans = (
        ("tables", cases, Condition(), False),
        ("literal", ("III", "IV", "V", "VI", "VII", "VIII"), Condition(), True),
        ("memory", ("memory",), Condition(), False),
        ("memory under noise", ("memory",), tables.condition(noise=True), False),
        ("blind", ("blind",), Condition(), False),
        ("noise", cases, tables.condition(noise=True), False),
        ("delay", cases, tables.condition(delay=10), False),
        ("delay 20", cases, tables.condition(delay=20), False),
        ("timing", ("timing",), Condition(), False),
    )
    return document.document([(name, _computed(w, how, literal, workers)[0]) for name, w, how, literal in plans])
