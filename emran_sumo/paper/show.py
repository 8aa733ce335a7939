"""The tables on the terminal."""

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from emran_sumo.paper.layout import Line, Sheet

WIDTH = 118  # columns, where the output is no terminal


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
    table = Table(*sheet.heads[:1], box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for head in sheet.heads[1:]:
        table.add_column(head, no_wrap=True)
    for i, line in enumerate(sheet.lines):
        if line.kind == "case" and i:
            table.add_row()
        table.add_row(*_cells(line, len(sheet.heads)), style={"case": "bold", "published": "dim"}.get(line.kind, ""))
    out.print(f"[bold]{sheet.title}[/bold]")
    out.print(table)
    for remark in sheet.remarks:
        out.print(remark, style="dim")
    out.print()


def _cells(line: Line, columns: int) -> list[str]:
    name, *rest = line.cells
    if line.kind == "required":
        *limits, verdict = rest
        color = "green" if line.good[0] else "bold red"
        rest = [*limits, f"[{color}]{verdict}[/]"]
    else:
        rest = [f"[green]{cell}[/]" if i < len(line.good) and line.good[i] else cell for i, cell in enumerate(rest)]
    return [name if line.kind == "case" else f"  {name}", *rest, *[""] * (columns - 1 - len(rest))]
