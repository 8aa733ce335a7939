"""How a figure of the paper looks in print: column width, dashes and colors, disturbances shaded."""

from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from emran_sumo.loop import AT
from emran_sumo.paper.cases import ACCURACY, MAIN
from emran_sumo.paper.plates import DRIVERS, Panel, Plate
from emran_sumo.paper.rows import OWN
from emran_sumo.print_style import COLORS, STYLE

DOTS = 300  # per inch
NARROW, WIDE, TALL = 3.4, 7.0, 2.2  # in: one column, two columns, one row of panels
_SMALL = 7.0  # pt
# color, dashes and width per row; the heaviest line below, so that none hides another
LOOKS = dict(
    zip(
        DRIVERS,
        ((COLORS[1], (0, (5, 1.5)), 1.3), (COLORS[2], (0, (1, 1)), 1.5), (COLORS[4], (0, (5, 1, 1, 1)), 1.0),
         (COLORS[0], "-", 1.3)),
        strict=True,
    )
)  # fmt: skip
# counts jump at once: dashes would hide when, so widths tell them apart, the widest below
STEPS = {OWN: (COLORS[2], "-", 0.8), ACCURACY: (COLORS[4], (0, (5, 1, 1, 1)), 1.2), MAIN: (COLORS[0], "-", 2.4)}
_REFERENCE: dict[str, Any] = {"color": "#9a9a9a", "linewidth": 3.0, "label": "reference", "zorder": 1.5}
_SHADE, _EDGE = "#ececec", "#8a8a8a"


class Band(NamedTuple):
    """A disturbance: from [s], to [s], what it is."""

    start: float
    end: float
    words: str


class Driven(NamedTuple):
    """One case under the rows of a plate.

    traces: (n, loop.WIDTH) by row name; lost: when a row lost the car [s]; longest of the traces; bands: disturbances.
    """

    name: str
    traces: dict[str, np.ndarray]
    lost: dict[str, float]
    longest: np.ndarray
    bands: tuple[Band, ...]


def draw(plate: Plate, cases: list[Driven]) -> Figure:
    """A row of panels per case, one panel per signal; (a), (b), ... as in the paper."""
    many = len(cases) * len(plate.panels)
    width = NARROW if len(plate.panels) == 1 else WIDE
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, TALL * len(cases) + (0.55 if width == NARROW else 0.25)))
        grid = figure.subplots(len(cases), len(plate.panels), squeeze=False, sharex=True)
        for row, case in zip(grid, cases, strict=True):
            for axes, panel in zip(row, plate.panels, strict=True):
                _fill(axes, plate, panel, case)
        for label, axes in zip("abcdefgh", grid.flat, strict=False):
            if many > 1:
                axes.set_title(f"({label}) {axes.get_title(loc='left')}", loc="left")
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        handles: dict[str, Any] = {}
        for axes in grid.flat:
            handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        figure.legend(
            handles.values(), handles.keys(), loc="outside upper center", ncols=2 if width == NARROW else len(handles),
            fontsize=_SMALL, handlelength=2.4, handletextpad=0.5, columnspacing=1.0,
        )  # fmt: skip
    return figure


def _fill(axes: Axes, plate: Plate, panel: Panel, case: Driven) -> None:
    if panel.reference:
        time, reference = case.longest[:, AT.time], case.longest[:, getattr(AT, panel.reference)]
        axes.plot(time, reference, **_REFERENCE)
    for name, trace in case.traces.items():
        color, dashes, line_width = (STEPS if panel.steps else LOOKS)[name]
        axes.plot(
            trace[:, AT.time], trace[:, getattr(AT, panel.column)], color=color, linestyle=dashes,
            linewidth=line_width, label=name, drawstyle="steps-post" if panel.steps else "default",
            zorder=3.0 - 0.1 * line_width if panel.steps else 2.0,
        )  # fmt: skip
    where = f", {case.name}" if len(plate.cases) > 1 else ""
    axes.set_title(f"{panel.words}{where}".replace("m/s2", "m/s²"), loc="left")
    axes.set_ylabel(panel.axis)
    axes.set_xlim(span(plate, case))
    axes.set_ylim(limits(plate, panel, case))
    if panel.steps:
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    _shade(axes, case.bands)
    _say_lost(axes, case.lost)


def _shade(axes: Axes, bands: tuple[Band, ...]) -> None:
    first, last = axes.get_xlim()
    for band in bands:
        start, end = max(band.start, first), min(band.end, last)
        axes.axvspan(start, end, facecolor=_SHADE, edgecolor="none", zorder=0.5)
        for edge in (start, end):
            if first < edge < last:
                axes.axvline(edge, color=_EDGE, linewidth=0.6, zorder=0.6)
        axes.annotate(
            band.words, (0.5 * (start + end), 1.0), xycoords=("data", "axes fraction"), xytext=(0, -2),
            textcoords="offset points", ha="center", va="top", fontsize=_SMALL, color="#333333",
            bbox={"facecolor": _SHADE, "edgecolor": "none", "pad": 1.0}, zorder=4.0,
        )  # fmt: skip


def _say_lost(axes: Axes, lost: dict[str, float]) -> None:
    """Where a car was lost its line leaves the picture; the words say which and when."""
    if lost:
        words = "\n".join(f"{name}: lost at {when:.1f} s" for name, when in lost.items())
        axes.annotate(
            words, (0.0, 0.0), xycoords="axes fraction", xytext=(3, 3), textcoords="offset points", ha="left",
            va="bottom", fontsize=_SMALL, bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0}, zorder=4.0,
        )  # fmt: skip


def span(plate: Plate, case: Driven) -> tuple[float, float]:
    """Time [s] that is shown."""
    return plate.window or (0.0, float(case.longest[-1, AT.time]))


def limits(plate: Plate, panel: Panel, case: Driven) -> tuple[float, float]:
    """The range that holds every row which kept the car, with room for words above and below."""
    first, last = span(plate, case)
    low, high = np.inf, -np.inf
    for name, trace in case.traces.items():
        if name not in case.lost:
            shown = trace[(trace[:, AT.time] >= first) & (trace[:, AT.time] <= last), getattr(AT, panel.column)]
            low, high = min(low, float(shown.min())), max(high, float(shown.max()))
    if panel.steps:
        return 0.0, max(high, 1.0) * 1.15
    size = high - low
    return low - (0.07 + 0.11 * len(case.lost)) * size, high + (0.17 if case.bands else 0.07) * size
