"""All tables as one Markdown document with a reading of them; `emran-sumo paper --markdown FILE` writes it."""

from pathlib import Path

from emran_sumo.paper.sheet import Line, Sheet

HEAD = "<!-- Written by `emran-sumo paper --markdown FILE`. Change the code, not this file. -->\n"


def document(chapters: list[tuple[str, list[Sheet]]]) -> str:
    """Markdown text of chapters, each the name of its prose and its tables."""
    prose = _prose()
    parts = [HEAD, prose["opening"]]
    for name, sheets in chapters:
        parts.append(prose[name])
        parts += [sheet_text(sheet) for sheet in sheets]
    return "\n".join(part.strip() + "\n" for part in parts)


def _prose() -> dict[str, str]:
    """Chapters of reading.md by the name in their `<!-- name -->` line."""
    text = Path(__file__).with_name("reading.md").read_text(encoding="utf-8")
    chapters = (chapter.partition(" -->") for chapter in text.split("<!-- ")[1:])
    return {name: body for name, _, body in chapters}


def sheet_text(sheet: Sheet) -> str:
    """One table in Markdown; bold where a cell beats what it is held against."""
    rows = [f"| {' | '.join(sheet.heads)} |", f"|{'---|' * len(sheet.heads)}"]
    rows += [f"| {' | '.join(_cells(line, len(sheet.heads)))} |" for line in sheet.lines]
    table = "\n".join(rows) if sheet.lines else ""
    remarks = "\n\n".join(sheet.remarks)
    return f"### {sheet.title}\n\n{table}\n\n{remarks}\n"


def _cells(line: Line, columns: int) -> list[str]:
    name, *rest = line.cells
    if line.kind == "case":
        return [f"**{name}**", *[""] * (columns - 1)]
    if line.kind == "group":
        return [f"*{name}*", *[""] * (columns - 1)]
    if line.kind != "required":
        rest = [f"**{cell}**" if i < len(line.good) and line.good[i] else cell for i, cell in enumerate(rest)]
    return [name, *rest, *[""] * (columns - 1 - len(rest))]
