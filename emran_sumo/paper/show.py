"""The tables on the terminal."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from rich.text import Text

from emran_sumo.paper.sheet import Line, Sheet

HEADINGS = {"case": "bold", "group": "italic"}  # kinds of lines that are words across the table, and their style
WIDTH = 116  # columns, where the output is no terminal


def console() -> Console:
    """A console wide enough for the tables also when it writes to a file."""
    made = Console(highlight=False)
    return made if made.is_terminal else Console(highlight=False, width=WIDTH)


def progress() -> Progress:
    """Progress on stderr; nothing where stderr is no terminal."""
    err = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    return Progress(*columns, console=err, transient=True, disable=not err.is_terminal)


def show(sheet: Sheet, out: Console) -> None:
    """Print one table with what is below it."""
    out.print(sheet.title, style="bold", markup=False)
    if sheet.lines:
        _print_lines(sheet, out)
    for remark in sheet.remarks:
        out.print(remark, style="dim", markup=False)
    out.print()


def _print_lines(sheet: Sheet, out: Console) -> None:
    rows = [(line, _cells(line, len(sheet.heads))) for line in sheet.lines]
    named = [(cells[0], *map(_plain, cells[1:])) for line, cells in rows if line.kind not in HEADINGS]
    widths = [max(map(len, column)) for column in zip(sheet.heads, *named, strict=True)]
    _print_rows(out, widths, [(list(sheet.heads), "dim")])
    for line, cells in rows:
        if line.kind in HEADINGS:
            out.print(cells[0], style=HEADINGS[line.kind], markup=False)
        else:
            _print_rows(out, widths, [(cells, "dim" if line.kind == "published" else "")])


def _plain(cell: str) -> str:
    return Text.from_markup(cell).plain


def _print_rows(out: Console, widths: list[int], rows: list[tuple[list[str], str]]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 1, 0, 0))
    for width in widths:
        table.add_column(width=width, no_wrap=True)
    for cells, style in rows:
        table.add_row(*cells, style=style)
    out.print(table)


def _cells(line: Line, columns: int) -> list[str]:
    name, *rest = line.cells
    if line.kind == "required":
        *limits, verdict = rest
        color = "green" if line.good[0] else "bold red"
        rest = [*limits, f"[{color}]{verdict}[/]"]
    else:
        rest = [f"[green]{cell}[/]" if i < len(line.good) and line.good[i] else cell for i, cell in enumerate(rest)]
    return [name if line.kind == "case" else f"  {name}", *rest, *[""] * (columns - 1 - len(rest))]
