"""The tables as lines of words, for the terminal and for the document alike."""

from emran_sumo.paper.cases import ADD_ON, FORCES, Table, printed_rows, published
from emran_sumo.paper.memory import PASSES, Passes
from emran_sumo.paper.overview import add_on_sheet, overview_sheet
from emran_sumo.paper.rows import other_rows
from emran_sumo.paper.sheet import Line, Sheet, sheet_title
from emran_sumo.paper.tables import (
    Condition,
    Result,
    Values,
    missed,
    published_cells,
    side_values,
    unaided_of,
    views,
)
from emran_sumo.paper.timing import DEADLINE, Timing

HEADS = {
    "lateral": ("e_y rms, m", "e_y max", "e_psi rms", "e_psi max"),
    "longitudinal": ("e_v rms, m/s", "e_v max"),
}
SIDE = ("beats", "command", "neurons", "learned")
AGAINST = "pid-stanley against the row without EMRAN, all others against "
OTHERS = {"lateral": "other laws, accuracy mode", "longitudinal": "other networks"}
QUOTED = (
    "quoted: the paper prints these two rows from the literature; they are another program's results on another plant, "
    "not runs of its authors."
)
BESIDE = (
    "command: total variation of the command over that of the same law without network; learned: share of the samples "
    "admitted to learning."
)


def sheets(tables: dict[str, Table], found: list[Result], how: Condition) -> list[Sheet]:
    """One sheet per table, and one for the sweep of side forces where there is one."""
    listed = []
    for name, table in tables.items():
        mine = [result for result in found if result.table == name]
        if name in ADD_ON:
            listed.append(add_on_sheet(table, mine, how))
            continue
        listed.append(_sheet(name, table, mine, how))
        if any(result.case.sweep for result in mine):
            listed.append(_sweep(name, mine, how))
    every = overview_sheet(found, how)
    return [*listed, every] if every else listed


def _sheet(name: str, table: Table, mine: list[Result], how: Condition) -> Sheet:
    printed = published()["tables"].get(name)
    lines: list[Line] = []
    for case in table.cases:
        here = [result for result in mine if result.case.name == case.name]
        for view in range(len(views(here[0]))):
            lines.append(Line("case", (views(here[0])[view][0],)))
            lines += _printed(printed or {})
            others = {row.name for row in other_rows(table.half)}
            for i, result in enumerate(here):
                if result.row.name in others and here[i - 1].row.name not in others:
                    lines.append(Line("group", (OTHERS[table.half],)))
                lines.append(_ours(result, view, unaided_of(result, here), table))
                asked = _required(result, table) if view == 0 and not how.name else None
                lines += [asked] if asked else []
    against = _against(printed)
    remarks = [f"{table.window}. Ratio: {against}", BESIDE]
    if printed and "quoted" in printed:
        remarks.append(QUOTED)
    if how.seeds != (1,):
        remarks.append(f"Mean over {len(how.seeds)} seeds of the noise; where there are many cars they take turns.")
    return Sheet(sheet_title(name, table.title, how), ("", *HEADS[table.half], *SIDE), tuple(lines), tuple(remarks))


def _printed(printed: dict) -> list[Line]:
    quoted = printed.get("quoted", ())
    rows = printed_rows(printed).items()
    return [
        Line("published", (f"{'quoted' if row in quoted else 'published'} {row}", *(f"{cell:.4f}" for cell in cells)))
        for row, cells in rows
    ]


def _against(printed: dict | None) -> str:
    if printed is None:
        return "to the same law without network."
    if not {"PID", "Stanley"} & set(printed):
        return f"ours / published {printed['compared']}."
    best = printed["compared"] == "best"
    return f"ours / published, {AGAINST}{'the lowest cells of those with EMRAN' if best else printed['compared']}."


def _ours(result: Result, view: int, alone: Result | None, table: Table) -> Line:
    values = views(result)[view][1]
    held = published_cells(result) or (_cells(views(alone)[view][1], table) if alone else ())
    pairs = list(zip(_cells(values, table), held, strict=False))
    good = tuple(value is not None and limit is not None and value < limit for value, limit in pairs)
    side = side_values(result, alone, table.half)
    if result.lost:
        when = f"lost {result.lost} of {result.runs}" if result.runs > 1 else f"lost at {result.after:.1f} s"
        shown = (when, *[""] * (len(pairs) - 1))
    else:
        shown = tuple(_against_cell(value, limit) for value, limit in pairs)
    return Line("ours", (result.row.name, *shown, f"{sum(good)}/{len(pairs)}", *_side(side)), good)


def _cells(values: Values, table: Table) -> tuple[float | None, ...]:
    return tuple(values[metric] for metric in table.metrics)


def _against_cell(value: float | None, limit: float | None) -> str:
    if value is None:
        return ""
    if not limit:
        return f"{value:.4f}"
    ratio = value / limit
    return f"{value:.4f} x{ratio:.2f}" if ratio < 10.0 else f"{value:.4f} x{ratio:.0f}"


def _side(side: Values) -> tuple[str, str, str]:
    ratio, neurons, share = side["command_variation_ratio"], side["neurons"], side["learned_share"]
    return (
        "" if ratio is None else f"x{ratio:.2f}" if ratio < 10.0 else f"x{ratio:.0f}",
        "" if neurons is None else f"{neurons:.0f}",
        "" if share is None else f"{100.0 * share:.0f} %",
    )


def _required(result: Result, table: Table) -> Line | None:
    gaps = missed(result, table.metrics)
    if gaps is None:
        return None
    limits = tuple("" if limit is None else f"{limit:.4f}" for limit in result.case.required[result.row.name])
    verdict = "holds" if not gaps else f"MISSED: {', '.join(gaps)}"
    return Line("required", ("  asked of it", *limits, verdict), (not gaps,))


def _sweep(name: str, mine: list[Result], how: Condition) -> Sheet:
    cases = list(dict.fromkeys(result.case.name for result in mine))
    lines = []
    for row in dict.fromkeys(result.row.name for result in mine):
        forces = (result.values["lost_force"] for result in mine if result.row.name == row)
        lines.append(Line("ours", (row, *(_force(force) for force in forces))))
    title = sheet_title(name, "The side gust that loses the car [kN], in steps of 0.25 kN", how)
    return Sheet(title, ("", *cases), tuple(lines), ("Lost: |e_y| > 6 m, |e_psi| > 0.6 rad.",))


def _force(newton: float | None) -> str:
    return f"above {FORCES[-1] / 1000.0:g}" if newton is None else f"{newton / 1000.0:.2f}"


def literal_sheet(found: list[Result]) -> Sheet:
    """What taking the paper word for word gives, in sentences."""
    remarks = []
    for row in dict.fromkeys(result.row.name for result in found if result.row.aided):
        mine = [result for result in found if result.row.name == row]
        groups: dict[str, list[str]] = {
            "loses the car in": [],
            "errs no less than the law alone in": [],
            "errs less in": [],
        }
        for result in mine:
            alone = unaided_of(result, found)
            first = next(iter(key for key in result.values if key.endswith("_rms") and key.startswith(_error(result))))
            own, without = result.values[first], alone.values[first] if alone else None
            worse = own is not None and without is not None and own >= without
            key = list(groups)[0 if result.lost else 1 if worse else 2]
            groups[key].append(f"{result.table} ({result.case.name})")
        remarks.append(
            f"{row}: " + "; ".join(f"{key} {', '.join(names)}" for key, names in groups.items() if names) + "."
        )
    return Sheet("The paper word for word", ("",), (), tuple(remarks))


def _error(result: Result) -> str:
    return "speed_error" if result.table in ("III", "IV", "V", "blind cruise") else "cross_track"


def memory_sheet(found: list[Passes], how: Condition) -> Sheet:
    """Repeated passes."""
    lines, case = [], ""
    base = emran = None
    for line in found:
        if line.case != case:
            case = line.case
            unit = "e_y rms [m]" if line.half == "lateral" else "e_v rms [m/s]"
            lines.append(Line("case", (f"{case}: {unit}",)))
            here = [one for one in found if one.case == case]
            base, emran = here[0], here[-1]
        assert base is not None
        assert emran is not None
        ratio = line.overall / emran.overall if line.overall and emran.overall else None
        cells = tuple("lost" if value is None else f"{value:.4f}" for value in (*line.rms, line.overall))
        ends = ("" if ratio is None else f"x{ratio:.2f}", f"x{line.variation / base.variation:.2f}", f"{line.neurons}")
        good = (False,) * PASSES + (line is not emran and ratio is not None and ratio < 1.0,)
        lines.append(Line("ours", (line.row, *cells, *ends), good))
    heads = ("", *(f"pass {number + 1}" for number in range(PASSES)), "all", "to EMRAN", "command", "neurons")
    remarks = (
        "What was learned is kept from pass to pass, by the network and by the observer. to EMRAN: error over all "
        "passes over that of coupled-emran; green or bold where the other one is better.",
        "The rate of the best observer is chosen in the very case, from 1 to 30 /s in steering and from 5 to 90 /s in "
        "cruise; the network keeps its frozen values.",
    )
    return Sheet(
        sheet_title("memory", "A network against an observer over repeated passes", how), heads, tuple(lines), remarks
    )


def timing_sheet(found: list[Timing], how: str) -> Sheet:
    """Computing time per control step."""
    micro = 1e6
    lines = tuple(
        Line(
            "ours",
            (
                t.row, *(f"{micro * value:.0f}" for value in (t.mean, t.p99, t.largest)),
                f"{100.0 * t.largest / DEADLINE:.1f} %", f"{micro * t.inside:.0f}", f"{t.neurons}",
            ),
        )
        for t in found
    )  # fmt: skip
    heads = ("microseconds per control step", "mean", "p99", "max", "max of 10 ms", "inside one call", "neurons")
    return Sheet("Timing. Computing time against the deadline of 10 ms", heads, lines, (how,))
