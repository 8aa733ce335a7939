"""A run on one page: errors, speed, the split of both commands, lateral acceleration, neurons."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from emran_sumo.print_style import COLORS, STYLE

DOTS = 200  # per inch
_DEGREES = 180.0 / np.pi
BLUE, VERMILION, GREEN, GRAY = COLORS[0], COLORS[1], COLORS[2], "#7a7a7a"


class Line(NamedTuple):
    """One curve: trace column, its words in the legend, color, dashes, scale and width."""

    column: str
    words: str = ""
    color: str = BLUE
    dashes: str | tuple = "-"
    scale: float = 1.0
    width: float = 1.2


class Panel(NamedTuple):
    """One pair of axes: what is on the vertical one, its curves, and whether they count."""

    title: str
    lines: tuple[Line, ...]
    steps: bool = False


def _split(name: str, scale: float = 1.0) -> tuple[Line, ...]:
    return (
        Line(f"{name}_command", "command", GRAY, "-", scale, 2.4),
        Line(f"{name}_law", "law", BLUE, "-", scale),
        Line(f"{name}_network", "network", VERMILION, (0, (4, 1.5)), scale),
    )


PANELS = (
    Panel("cross-track error (m)", (Line("cross_track_error"),)),
    Panel("heading error (deg)", (Line("heading_error", scale=_DEGREES),)),
    Panel(
        "speed (m/s)",
        (
            Line("speed_reference", "reference", GRAY, "-", 1.0, 2.4),
            Line("speed_long", "actual", BLUE, (0, (4, 1.5))),
        ),
    ),
    Panel("speed error (m/s)", (Line("speed_error"),)),
    Panel("steering angle (deg)", _split("steer", _DEGREES)),
    Panel("acceleration (m/s²)", _split("accel")),
    Panel("lateral acceleration (m/s²)", (Line("accel_lat"),)),
    Panel(
        "neurons",
        (
            Line("neurons_steering", "steering network", VERMILION, (0, (4, 1.5))),
            Line("neurons_speed", "speed network", BLUE),
        ),
        steps=True,
    ),
)


def draw_sheet(file: Path, trace: Mapping[str, np.ndarray], title: str) -> None:
    """Write the page as PNG.

    Args:
        file: to write, whatever its suffix.
        trace: (n,) columns by name.
        title: sentence on top.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 8.6))
        FigureCanvasAgg(figure)
        grid = figure.subplots(4, 2, sharex=True)
        for axes, panel in zip(grid.flat, PANELS, strict=True):
            draw_panel(axes, panel, trace)
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        for label, axes in zip("abcdefgh", grid.flat, strict=True):
            axes.set_title(f"({label}) {axes.get_title(loc='left')}", loc="left")
        figure.suptitle(textwrap.fill(title, 100), fontsize=8.5, x=0.01, ha="left")
        figure.savefig(file, format="png", dpi=DOTS, metadata={"Software": None})


def draw_panel(axes: Axes, panel: Panel, trace: Mapping[str, np.ndarray], legend_above: bool = False) -> None:
    """Draw the curves of a panel over the whole run; the legend where it hides least, or beside the title."""
    for line in panel.lines:
        axes.plot(
            trace["time"],
            trace[line.column] * line.scale,
            color=line.color,
            linestyle=line.dashes,
            linewidth=line.width,
            label=line.words or None,
            drawstyle="steps-post" if panel.steps else "default",
        )
    axes.set_title(panel.title, loc="left")
    axes.margins(x=0.0)
    if panel.steps:
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylim(bottom=0.0)
    else:
        _open_up(axes)
    if len(panel.lines) > 1 and legend_above:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=len(panel.lines), borderaxespad=0.0)
    elif len(panel.lines) > 1:
        axes.legend(loc="best", handlelength=2.2, borderaxespad=0.2, labelspacing=0.25)


def _open_up(axes: Axes) -> None:
    """A constant signal is a line in the middle, without its rounding noise being magnified."""
    low, high = axes.get_ylim()
    least = 1e-3 * max(abs(low), abs(high), 1.0)
    if high - low < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)
