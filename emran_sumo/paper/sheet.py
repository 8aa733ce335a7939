"""What a printed table is made of."""

from typing import NamedTuple

from emran_sumo.paper.tables import Condition


class Line(NamedTuple):
    """kind: "case", "group", "published", "ours" or "required"; good: which cells beat what they are held against."""

    kind: str
    cells: tuple[str, ...]
    good: tuple[bool, ...] = ()


class Sheet(NamedTuple):
    """A table ready to print: title, column heads, lines, remarks below."""

    title: str
    heads: tuple[str, ...]
    lines: tuple[Line, ...]
    remarks: tuple[str, ...]


def sheet_title(name: str, text: str, how: Condition) -> str:
    """A table's name, what it shows, and the condition."""
    label = f"Table {name}" if name[0] in "IVX" else name.capitalize()
    return f"{label}. {text}{f', with {how.name}' if how.name else ''}"
