"""The figures of a study's report: drawn by matplotlib. Colors, markers and dashes tell the series apart."""

from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from emran_sumo.print_style import COLORS, STYLE
from emran_sumo.study import statistics
from emran_sumo.study.statistics import Estimate, Paired
from emran_sumo.study.tables import GRAVITY, HORIZON, LEAST_TTC, METRICS, TRAVEL_TIME, Metric, Slice

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 2)), (0, (2, 2)))
SIGNIFICANT = 0.05
TIMES = (0.3, 60.0)  # s, axis of times to collision
CONFLICT = 3.0  # s, SUMO's SSM device calls less a conflict
_WIDTH = 7.2  # in, the text width of a page
_PANELS = 6  # of one figure of distributions
_WORDS = {
    "traffic.density": "density (vehicles/km per lane)",
    "road.friction": "road friction",
    "track.speed": "speed (m/s)",
    "duration": "duration (s)",
    "": "",
}


class Drawn(NamedTuple):
    """A figure with the name of its files, its title and what it shows."""

    name: str
    title: str
    caption: str
    figure: Figure


def draw(cut: Slice) -> list[Drawn]:
    """All figures of a slice that its rows can fill."""
    with mpl.rc_context(STYLE):
        made = [_metrics(cut), _paired(cut), _least_ttc(cut), _collisions(cut), _traffic(cut)]
    return [drawn for drawn in made if drawn is not None]


def words(key: str) -> str:
    """A factor in words, for axes."""
    return _WORDS.get(key, key)


def short(key: str) -> str:
    """A factor in words without its unit."""
    return words(key).partition(" (")[0]


def _sheet(panels: int, columns: int, height: float = 1.6) -> tuple[Figure, list[Axes]]:
    columns = min(columns, panels)
    rows = -(-panels // columns)
    figure = Figure(figsize=(_WIDTH, height * rows + 0.35))
    grid = figure.subplots(rows, columns, squeeze=False)
    axes = list(grid.flat)
    for spare in axes[panels:]:
        spare.set_visible(False)
    return figure, axes[:panels]


def _places(cut: Slice) -> np.ndarray:
    """Where the values of x lie on the axis."""
    if cut.x and all(isinstance(x, int | float) for x in cut.xs):
        return np.array(cut.xs, dtype=float)
    return np.arange(len(cut.xs), dtype=float)


def _label_x(axes: Axes, cut: Slice) -> None:
    axes.set_xticks(_places(cut), [f"{x:g}" if isinstance(x, float) else str(x) for x in cut.xs] if cut.x else [""])
    if len(cut.xs) == 1:
        axes.set_xlim(_places(cut)[0] - 1.0, _places(cut)[0] + 1.0)


def _dodge(cut: Slice, i: int, count: int) -> np.ndarray:
    """Places moved a little, so that intervals do not hide one another."""
    at = _places(cut)
    room = float(np.diff(at).min()) if at.size > 1 else 1.0
    return at + (i - 0.5 * (count - 1)) * 0.12 * room


def _line(axes: Axes, cut: Slice, i: int, found: list[Estimate]) -> None:
    value, low, high = (np.array([getattr(e, name) for e in found]) for name in ("value", "low", "high"))
    style: dict[str, Any] = {"color": COLORS[i % 7], "marker": MARKERS[i % 7], "linestyle": DASHES[i % 7]}
    if len(cut.xs) > 1:
        axes.fill_between(_places(cut), low, high, color=COLORS[i % 7], alpha=0.18, linewidth=0)
        axes.plot(_places(cut), value, **style, label=str(cut.names[i]))
    else:
        _bars(axes, _dodge(cut, i, len(cut.names)), found, i, str(cut.names[i]))


def _bars(axes: Axes, at: np.ndarray, found: list[Any], i: int, label: str, filled: bool = True) -> None:
    value, low, high = (np.array([getattr(e, name) for e in found]) for name in ("value", "low", "high"))
    axes.errorbar(
        at, value, yerr=(np.maximum(value - low, 0.0), np.maximum(high - value, 0.0)), fmt=MARKERS[i % 7],
        color=COLORS[i % 7], capsize=2.5, elinewidth=1.1, markerfacecolor=COLORS[i % 7] if filled else "white",
        label=label,
    )  # fmt: skip


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside upper center", ncols=min(len(once), 4))


def shown_metrics(cut: Slice) -> list[Metric]:
    """Metrics of which the slice has any value."""
    seeds = cut.seeds()
    return [m for m in METRICS if any(np.isfinite(cut.values(m, n, x, seeds)).any() for n, x in cut.cells)]


def _means(cut: Slice, metric: Metric, name: Any) -> list[Estimate]:
    return [statistics.mean(cut.values(metric, name, x, cut.seeds())) for x in cut.xs]


def _metrics(cut: Slice) -> Drawn | None:
    metrics = shown_metrics(cut)
    if not metrics:
        return None
    figure, sheet = _sheet(len(metrics), 3)
    for axes, metric in zip(sheet, metrics, strict=True):
        for i, name in enumerate(cut.names):
            _line(axes, cut, i, _means(cut, metric, name))
        axes.set_title(f"{metric.title} ({metric.unit})")
        _label_x(axes, cut)
        axes.margins(y=0.08)
        axes.set_ylim(bottom=0.0)
    figure.supxlabel(words(cut.x), fontsize=8.0)
    _legend(figure, sheet[0])
    caption = (
        f"Mean over the seeds with its 95 % bootstrap band. Time to collision and deceleration to avoid are the worst "
        f"of a run; they count as {HORIZON:g} s where no vehicle ahead was closer than that, and as at most "
        f"{GRAVITY:g} m/s², which no brake exceeds."
    )
    return Drawn("metrics", f"Tracking, comfort and safety against {words(cut.x) or 'one another'}", caption, figure)


def comparisons(cut: Slice, metric: Metric) -> dict[Any, list[Paired]]:
    """Each later name against the first: one comparison per x, p corrected over them after Holm."""
    seeds, found = cut.seeds(), {}
    for name in cut.names[1:]:
        pairs = [
            statistics.paired(cut.values(metric, cut.names[0], x, seeds), cut.values(metric, name, x, seeds))
            for x in cut.xs
        ]
        corrected = statistics.holm([pair.p for pair in pairs])
        found[name] = [pair._replace(p=p) for pair, p in zip(pairs, corrected, strict=True)]
    return found


def _paired(cut: Slice) -> Drawn | None:
    metrics = shown_metrics(cut)
    if len(cut.names) < 2 or not metrics:
        return None
    figure, sheet = _sheet(len(metrics), 3)
    others = len(cut.names) - 1
    for axes, metric in zip(sheet, metrics, strict=True):
        axes.axhline(0.0, color="#444444", linewidth=0.8)
        for i, (name, pairs) in enumerate(comparisons(cut, metric).items()):
            at = _dodge(cut, i, others)
            label = f"{name} minus {cut.names[0]}"
            for k, pair in enumerate(pairs):
                _bars(axes, at[k : k + 1], [pair], i + 1, label, filled=pair.p < SIGNIFICANT)
        axes.set_title(f"{metric.title} ({metric.unit})")
        _label_x(axes, cut)
    figure.supxlabel(words(cut.x), fontsize=8.0)
    handles, labels = sheet[0].get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside upper center", ncols=2)
    caption = (
        "Mean of the differences between runs of equal seed with its 95 % bootstrap interval; below zero, the named "
        "one is lower. Filled where Wilcoxon's signed-rank test, corrected after Holm over the values on the axis, "
        f"gives p < {SIGNIFICANT:g}."
    )
    return Drawn("differences", f"Paired differences to {cut.names[0]}", caption, figure)


def _least_ttc(cut: Slice) -> Drawn | None:
    metric = next(m for m in METRICS if m.key == LEAST_TTC)
    if metric not in shown_metrics(cut):
        return None
    metric, (first, last) = metric._replace(most=np.inf), TIMES
    chosen = sorted(set(np.linspace(0, len(cut.xs) - 1, min(len(cut.xs), _PANELS)).round().astype(int).tolist()))
    figure, sheet = _sheet(len(chosen), 4 if len(chosen) == 4 else 3, 1.9)
    for axes, x in zip(sheet, (cut.xs[k] for k in chosen), strict=True):
        axes.axvline(CONFLICT, color="#777777", linewidth=0.8, linestyle=(0, (1, 1.5)))
        for i, name in enumerate(cut.names):
            values = cut.values(metric, name, x, cut.seeds())
            values = np.sort(values[~np.isnan(values)])  # infinite where no vehicle ahead was ever approached
            below = np.searchsorted(values, steps := np.unique(np.clip(values, first, last)), side="right")
            if values.size:
                share = np.concatenate(([0.0], below / values.size, [np.mean(values < last)]))
                style: dict[str, Any] = {"color": COLORS[i % 7], "linestyle": DASHES[i % 7], "label": str(name)}
                axes.step(np.concatenate(([first], steps, [last])), np.minimum(share, share[-1]), where="post", **style)
        axes.set_title(f"{short(cut.x)} {x:g}" if isinstance(x, int | float) else str(x or ""))
        axes.set_xscale("log")
        axes.set_xlim(first, last)
        axes.set_xticks(ticks := [0.3, 1, 3, 10, 30], [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set_ylim(0.0, 1.02)
    figure.supxlabel("least time to collision of a run (s)", fontsize=8.0)
    figure.supylabel("share of runs below", fontsize=8.0)
    _legend(figure, sheet[0])
    caption = (
        f"Share of runs that came closer than the time on the axis; dotted at {CONFLICT:g} s, the conflict threshold "
        f"of SUMO's SSM device. What is missing to 1 never came below {last:g} s."
    )
    return Drawn("least_ttc", "Distribution of the least time to collision", caption, figure)


def collision_rates(cut: Slice, name: Any) -> list[Estimate]:
    """Collisions per 1000 km for each x."""
    found = []
    for x in cut.xs:
        rows = [row.metrics for row in cut.cells.get((name, x), {}).values() if row.metrics]
        driven = sum(m.get("run.distance") or 0.0 for m in rows) / 1e6
        found.append(statistics.rate(sum(m.get("safety.collisions") or 0 for m in rows), driven))
    return found


def _collisions(cut: Slice) -> Drawn | None:
    found = {name: collision_rates(cut, name) for name in cut.names}
    if not any(np.isfinite(e.value) for rates in found.values() for e in rates):
        return None
    figure, (axes,) = _sheet(1, 1, 2.1)
    for i, (name, rates) in enumerate(found.items()):
        _bars(axes, _dodge(cut, i, len(cut.names)), rates, i, str(name))
    _label_x(axes, cut)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(words(cut.x))
    axes.set_ylabel("collisions per 1000 km")
    _legend(figure, axes)
    caption = (
        "Collisions of the ego per 1000 km driven, with the exact 95 % Poisson interval: without any collision, its "
        "upper end says what the distance driven can rule out."
    )
    return Drawn("collisions", "Collisions", caption, figure)


def _traffic(cut: Slice) -> Drawn | None:
    density, flow, speed = (Metric(f"traffic.{key}", key, "") for key in ("density_measured", "flow", "speed_mean"))
    seeds = cut.seeds()
    some = any(np.isfinite(cut.values(flow, n, x, seeds)).any() for n, x in cut.cells)
    figure, sheet = _sheet(3 if some else 1, 3, 2.2)
    for i, name in enumerate(cut.names):
        _line(sheet[0], cut, i, _means(cut, TRAVEL_TIME, name))
        if some:
            k, q, v = (
                np.concatenate([cut.values(metric, name, x, seeds) for x in cut.xs])
                for metric in (density, flow, speed)
            )
            dots: dict[str, Any] = {
                "marker": MARKERS[i % 7],
                "s": 10 - 4 * min(i, 1),
                "facecolors": "none",
                "linewidths": 0.7,
            }
            sheet[1].scatter(k, q, color=COLORS[i % 7], **dots)
            sheet[2].scatter(k, v, color=COLORS[i % 7], **dots)
    sheet[0].set_title("Travel time of the ego (s/km)")
    sheet[0].set_xlabel(short(cut.x))
    _label_x(sheet[0], cut)
    if some:
        sheet[1].set_title("Flow (vehicles/h per lane)")
        sheet[2].set_title("Mean speed of the traffic (m/s)")
        for axes in sheet[1:]:
            axes.set_xlabel("measured density")
            axes.set_xlim(0.0, 1.08 * axes.get_xlim()[1])
            axes.set_ylim(0.0, 1.08 * axes.get_ylim()[1])
    _legend(figure, sheet[0])
    caption = "Travel time: mean with its 95 % bootstrap band." + (
        " Fundamental diagram of the study's own traffic: one point per run, means over all lanes outside junctions "
        "and the time of the drive (Edie's definitions)." if some else ""
    )  # fmt: skip
    return Drawn("traffic", "Travel time, and flow of the traffic", caption, figure)
