"""A study's answers in files: tables, figures, and one self-contained page."""

import base64
import itertools
import math
from html import escape
from pathlib import Path
from typing import Any

from emran_sumo.errors import UserError
from emran_sumo.print_style import image
from emran_sumo.study import figures, statistics
from emran_sumo.study.display import span
from emran_sumo.study.figures import Drawn
from emran_sumo.study.page import PAGE, STYLE
from emran_sumo.study.plan import replay
from emran_sumo.study.statistics import GOOD, Paired
from emran_sumo.study.store import Row, Store
from emran_sumo.study.tables import LEAST_TTC, Metric, Slice, slices, write_tables

WORST = 10  # runs that the page lists
_ENDS = ("finished", "arrived", "collision", "diverged", "lost", "failed", "missing")


def write_report(folder: Path) -> list[Path]:
    """Write results.parquet, results.csv, report.html and figures/ into the folder of a study.

    Raises:
        UserError: no study there, nothing driven yet, or the folder cannot be written.
    """
    with Store(folder) as store:
        manifest, rows = store.manifest(), list(store.rows())
    if not any(row.metrics for row in rows):
        raise UserError(f"{folder}: no run of this study is done yet; there is nothing to report.")
    files = write_tables(folder, rows)
    plan = manifest["plan"]
    cuts = slices(rows, plan["grid"], plan["scenarios"])
    try:
        (folder / "figures").mkdir(exist_ok=True)
        sections = [_section(folder, cut, i if len(cuts) > 1 else None) for i, cut in enumerate(cuts)]
        page = folder / "report.html"
        part = page.with_suffix(".part")
        part.write_text(_page(manifest, rows, cuts, sections), encoding="utf-8")
        part.replace(page)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {error.strerror or error}.") from None
    return [*files, page]


def _section(folder: Path, cut: Slice, number: int | None) -> str:
    """Figures and tables of one slice; the figures also as files."""
    parts = [f"<h2>{escape(_fixed(cut))}</h2>"] if cut.fixed else []
    drawn = figures.draw(cut)
    for one in drawn:
        name = one.name if number is None else f"{one.name}-{number + 1}"
        for kind in ("png", "pdf"):
            (folder / "figures" / f"{name}.{kind}").write_bytes(image(one.figure, kind))
        parts.append(_figure(one))
        if one.name == "differences":
            parts.append(_differences(cut))
    parts.append(_endings(cut))
    return "\n".join(parts)


def _fixed(cut: Slice) -> str:
    return ", ".join(f"{key} = {value}" if key != "scenario" else str(value) for key, value in cut.fixed.items())


def _figure(one: Drawn) -> str:
    data = base64.b64encode(image(one.figure, "svg")).decode()
    title, caption = escape(one.title), escape(one.caption)
    return (
        f'<figure id="{one.name}"><h3>{title}</h3><img alt="{title}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _differences(cut: Slice) -> str:
    """The numbers behind the figure of paired differences."""
    head = "".join(f"<th>{escape(_x(cut, x))}</th>" for x in cut.xs)
    body = []
    first, *others = cut.names
    for name in others:
        if len(others) > 1:
            body.append(f'<tr><th colspan="{len(cut.xs) + 1}">{escape(str(name))}</th></tr>')
        for metric in figures.shown_metrics(cut):
            cells = "".join(f"<td>{_pair(pair, metric)}</td>" for pair in figures.comparisons(cut, metric)[name])
            body.append(f"<tr><th>{escape(metric.title)} <small>({escape(metric.unit)})</small></th>{cells}</tr>")
    names = ", ".join(escape(str(name)) for name in others)
    return (
        f"<table><caption>{names} minus {escape(str(first))}: mean difference and 95 % interval; pairs in which it "
        f"is lower; change of the mean; p (Wilcoxon, Holm)</caption><thead><tr><th></th>{head}</tr></thead>"
        f"<tbody>{''.join(body)}</tbody></table>"
    )


def _x(cut: Slice, x: Any) -> str:
    if not cut.x:
        return "all"
    return f"{figures.short(cut.x)} {x:g}" if isinstance(x, float) else str(x)


def _pair(pair: Paired, metric: Metric) -> str:
    if not pair.n:
        return "no pairs"
    if pair.value == pair.low == pair.high == 0.0:
        return f"equal <br><small>in all {pair.n}</small>"
    scale = max(abs(v) for v in (pair.value, pair.low, pair.high) if math.isfinite(v))
    digits = 3 if scale < 0.1 else 2 if scale < 10.0 else 1
    digits = 4 if scale < 0.01 else digits
    value = f"{pair.value:+.{digits}f}"
    range_ = f"[{pair.low:+.{digits}f}, {pair.high:+.{digits}f}]" if math.isfinite(pair.low) else ""
    change = f", {100.0 * pair.relative:+.0f} %" if math.isfinite(pair.relative) and metric.key != LEAST_TTC else ""
    strong = pair.p < figures.SIGNIFICANT
    p = "" if math.isnan(pair.p) else ", p < 0.001" if pair.p < 0.001 else f", p = {pair.p:.3f}"
    value = f"<b>{value}</b>" if strong else value
    text = f"{value} <small>{range_}</small><br><small>{round(pair.lower * pair.n)} of {pair.n}{change}{p}</small>"
    return text.replace("-", "−").replace("+", "+")


def _endings(cut: Slice) -> str:
    """How the runs ended; only ways that occurred."""
    counts: dict[tuple[Any, Any], dict[str, int]] = {}
    for place, rows in cut.cells.items():
        for row in rows.values():
            end = row.ended if row.state == "done" else row.state or "missing"
            of_place = counts.setdefault(place, {})
            of_place[end] = of_place.get(end, 0) + 1
    seen = {end for of_place in counts.values() for end in of_place}
    ends = [end for end in _ENDS if end in seen] + sorted(seen - set(_ENDS))
    head = "".join(f"<th>{escape(end)}</th>" for end in ends)
    body = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(_x(cut, x))}</td>"
        + "".join(f"<td>{of_place.get(end, 0) or ''}</td>" for end in ends) + "</tr>"
        for name, x in itertools.product(cut.names, cut.xs)
        if (of_place := counts.get((name, x)))
    )  # fmt: skip
    return (
        "<table><caption>How the runs ended. Metrics of a run that ended early are those of its shorter drive."
        f"</caption><thead><tr><th></th><th></th>{head}</tr></thead><tbody>{body}</tbody></table>"
    )


def _worst(rows: list[Row]) -> str:
    body = []
    for row in statistics.worst([row for row in rows if row.state == "done"], WORST):
        m = row.metrics
        cells = [
            escape(", ".join(str(value) for value in (*row.run.factors.values(), f"seed {row.run.given['seed']}"))),
            escape(row.ended if row.ended in GOOD else row.reason),
            _number(m.get(LEAST_TTC), 1),
            _number(m.get("tracking.cross_track_error_max"), 3),
            f"<code>{escape(replay(row.run))}</code>"
            + (f'<br><a href="{escape(row.recording)}">{escape(row.recording)}</a>' if row.recording else ""),
        ]
        body.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    head = "".join(
        f"<th>{name}</th>"
        for name in ("run", "ended", "least TTC (s)", "largest cross-track error (m)", "drives it again, to run.rrd")
    )
    return (
        '<table class="worst"><caption>The worst runs: those that ended badly, then by least time to collision, then '
        f"by cross-track error</caption><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
    )


def _failures(rows: list[Row]) -> str:
    failed = [row for row in rows if row.state == "failed"]
    if not failed:
        return ""
    items = "".join(f"<li>{escape(row.error)} <code>{escape(replay(row.run))}</code></li>" for row in failed[:WORST])
    more = f" The first {WORST}:" if len(failed) > WORST else ""
    return f"<h2>Runs that failed</h2><p>{len(failed)} of {len(rows)}, in no figure.{more}</p><ul>{items}</ul>"


def _number(value: Any, digits: int) -> str:
    return "none" if value is None else f"{value:.{digits}f}"


def _page(manifest: dict[str, Any], rows: list[Row], cuts: list[Slice], sections: list[str]) -> str:
    plan, done = manifest["plan"], [row for row in rows if row.state == "done"]
    title = plan["title"] or f"{', '.join(plan['scenarios'])}: {' x '.join(plan['grid']) or 'seeds'}"
    km = sum(row.metrics.get("run.distance") or 0.0 for row in done) / 1000.0
    facts = {
        "scenario": ", ".join(plan["scenarios"]),
        **{key: ", ".join(f"{v:g}" if isinstance(v, int | float) else str(v) for v in values)
           for key, values in plan["grid"].items()},
        **{key: str(value) for key, value in plan["set"].items()},
        "seeds": f"{len(plan['seeds'])}, the same for every combination",
        "runs": f"{len(done)} of {len(rows)} done, {sum(row.state == 'failed' for row in rows)} failed; "
                f"{km:,.0f} km, {span(sum(row.wall for row in done))} of computing",
        "versions": ", ".join(f"{name} {value}" for name, value in manifest["identity"].items()
                              if name in ("emran_sumo", "libsumo", "numpy", "numba", "python")),
    }  # fmt: skip
    table = "".join(f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in facts.items())
    return PAGE.format(
        title=escape(title), style=STYLE, facts=table, answer=_answer(cuts), sections="\n".join(sections),
        worst=_worst(rows), failures=_failures(rows),
    )  # fmt: skip


def _answer(cuts: list[Slice]) -> str:
    """The first lines: what changes, by how much, where it is significant."""
    lines = []
    for cut in cuts:
        for metric in figures.shown_metrics(cut):
            for name, pairs in figures.comparisons(cut, metric).items():
                clear = [(x, p) for x, p in zip(cut.xs, pairs, strict=True) if p.p < figures.SIGNIFICANT]
                if clear and all(math.isfinite(p.relative) for _, p in clear):
                    shares = [100.0 * p.relative for _, p in clear]
                    low, high = (f"{s:+.0f} %".replace("-", "−") for s in (min(shares), max(shares)))
                    change = low if low == high else f"{low} to {high}"
                    where = (
                        f"at {len(clear)} of {len(cut.xs)} values of {figures.short(cut.x)}"
                        if cut.x
                        else "significantly"
                    )
                    slice_ = f" ({_fixed(cut)})" if cut.fixed else ""
                    lines.append(f"<li><b>{escape(metric.title)}</b>{escape(slice_)}: {escape(str(name))} {change} "
                                 f"against {escape(str(cut.names[0]))}, {where}.</li>")  # fmt: skip
    if not any(len(cut.names) > 1 for cut in cuts):
        return ""
    if not lines:
        return f"<p>No paired difference is significant (p &lt; {figures.SIGNIFICANT:g}).</p>"
    return f"<p>Significant paired differences (p &lt; {figures.SIGNIFICANT:g}):</p><ul>{''.join(lines)}</ul>"
