"""Two tables across the others: every law alone and with the network, and all controllers at a glance."""

from emran_sumo.paper.cases import Table
from emran_sumo.paper.rows import own_rows, rows
from emran_sumo.paper.sheet import Line, Sheet, sheet_title
from emran_sumo.paper.tables import Condition, Result, Values, effort_name, unaided_of, views

METRICS = ("cross_track_error_rms", "heading_error_rms")
# Column -> table, case and view of it; what a reader asks first
GLANCE = {
    "VI": ("VI", "nominal", 0), "VII +1.5 kN": ("VII", "+1500 N", 0), "VIII mu 1.2": ("VIII", "friction 1.2", 0),
    "VIII mu 1.0": ("VIII", "friction 1.0", 0), "IX mu 1.2": ("IX", "friction 1.2", 0),
    "IX mu 1.0": ("IX", "friction 1.0", 0), "XI worst": ("XI", "16 corners", 1),
}  # fmt: skip
LOST = "lost"


def add_on_sheet(table: Table, found: list[Result], how: Condition) -> Sheet:
    """What the network changes for each law; good where it lowers the metric."""
    lines = []
    for case in table.cases:
        here = [result for result in found if result.case.name == case.name]
        for view in range(len(views(here[0]))):
            lines.append(Line("case", (views(here[0])[view][0],)))
            for aided in here:
                alone = unaided_of(aided, here)
                if alone is not None and alone is not aided:
                    lines.append(_change(aided, alone, view, table))
    remarks = (
        f"{table.window}. Columns: the law alone, with its network, what that changes. bold or green: less with the "
        "network. The network, its rates and its learning signal are those of coupled-emran for every law but "
        "the paper's; none was tuned for the law it aids.",
        "command: total variation of the steering command, aided over alone.",
    )
    heads = ("", "e_y rms, m", "aided", "change", "e_y max", "e_psi rms", "e_psi max", "command")
    return Sheet(sheet_title("add-on", table.title, how), heads, tuple(lines), remarks)


def _change(aided: Result, alone: Result, view: int, table: Table) -> Line:
    with_network, without = views(aided)[view][1], views(alone)[view][1]
    changes = [_percent(with_network[metric], without[metric]) for metric in table.metrics]
    words = ["" if change is None else f"{change:+.0f} %" for change in changes]
    good = (False, False, *(change is not None and change <= -0.5 for change in changes))
    first = table.metrics[0]
    effort = effort_name(table.half)
    ratio = _percent(with_network[effort], without[effort])
    cells = (
        alone.row.name, _cell(without, first, alone), _cell(with_network, first, aided), *words,
        "" if ratio is None else f"x{1.0 + ratio / 100.0:.2f}",
    )  # fmt: skip
    return Line("ours", cells, good)


def _percent(new: float | None, old: float | None) -> float | None:
    return None if new is None or not old else 100.0 * (new / old - 1.0)


def _cell(values: Values, metric: str, result: Result) -> str:
    value = values[metric]
    if value is not None:
        return f"{value:.4f}"
    return f"{LOST} {result.lost} of {result.runs}" if result.runs > 1 else LOST


def overview_sheet(found: list[Result], how: Condition) -> Sheet | None:
    """RMS cross-track and heading error of all controllers in all cases; None where not all cases were driven."""
    cells = {(r.table, r.case.name, r.row.name): r for r in found}
    places = GLANCE.values()
    names = [row.name for row in rows("lateral") if all((t, case, row.name) in cells for t, case, _ in places)]
    if not names:
        return None
    lines, others = [], len(own_rows("lateral"))
    best = [[min(_values(cells, place, name)[i] for name in names) for i in range(len(METRICS))] for place in places]
    for k, name in enumerate(names):
        if k in (0, others):
            lines.append(Line("group", ("the paper's scheme and ours" if k == 0 else "other laws, accuracy mode",)))
        shown, good = [], []
        for place, least in zip(places, best, strict=True):
            values = _values(cells, place, name)
            kept = values[0] < float("inf")
            shown.append(f"{1e3 * values[0]:.1f} {1e3 * values[1]:.1f}" if kept else LOST)
            good.append(kept and values[0] <= least[0])
        lines.append(Line("ours", (name, *shown), tuple(good)))
    remarks = (
        "RMS cross-track error [mm] and RMS heading error [mrad]; bold or green: the lowest cross-track error of the "
        "column. XI: the worst of the 16 corners. A car whose center of gravity follows the path exactly has the side "
        "slip as heading error.",
    )
    return Sheet(sheet_title("all controllers", "At a glance", how), ("", *GLANCE), tuple(lines), remarks)


def _values(cells: dict, place: tuple[str, str, int], name: str) -> list[float]:
    """Both metrics; infinite where the car was lost."""
    table, case, view = place
    values = views(cells[table, case, name])[view][1]
    found = (values[metric] for metric in METRICS)
    return [float("inf") if value is None else value for value in found]
