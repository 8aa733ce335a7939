"""Plots without a scene as one Rerun file: a tab per group, each plot with its own span of time."""

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from emran_sumo.recording.colors import COMPARED, SLATE, packed
from emran_sumo.recording.plots import ticked
from emran_sumo.recording.recorder import PLOT_PERIOD
from emran_sumo.recording.stream import TIMELINE, Stream

APPLICATION = "emran_sumo_figures"
_COLUMNS = 2  # plots beside one another
_LABELS = 8  # that their vertical axes have room for


class Line(NamedTuple):
    """One curve: name, place in the order of colors (None: the reference, gray), times [s] and values (n, 2)."""

    label: str
    color: int | None
    points: np.ndarray


class View(NamedTuple):
    """One plot: title, entity path, curves (later ones above), span of time [s], range of values, if they count."""

    title: str
    entity: str
    lines: tuple[Line, ...]
    span: tuple[float, float]
    range: tuple[float, float]
    steps: bool = False


def write_panels(file: Path, tabs: Mapping[str, Sequence[View]], captions: str, name: str) -> None:
    """Write the file; it appears complete or not at all.

    Args:
        file: path of the .rrd file.
        tabs: plots by the name of their tab.
        captions: Markdown, a tab of its own.
        name: sentence shown as the recording's name; equal names and plots give equal files.
    """
    part = file.with_name(f"{file.name}.{os.getpid()}.part")
    stream = Stream(part, APPLICATION, name)
    try:
        stream.arrangement.send(_layout(tabs))
        stream.name(name)
        stream.static("/captions", rr.TextDocument(captions, media_type=rr.MediaType.MARKDOWN))
        for view in (view for views in tabs.values() for view in views):
            for i, line in enumerate(view.lines):
                _write(stream, view, f"{_origin(view)}/{i}_{_plain(line.label)}", line)
        stream.close()
        os.replace(part, file)
    finally:
        stream.close()
        part.unlink(missing_ok=True)


def _write(stream: Stream, view: View, entity: str, line: Line) -> None:
    color = SLATE if line.color is None else COMPARED[line.color]
    style = rr.SeriesLines(
        names=line.label, widths=3.0 if line.color is None else 1.8, colors=packed([color]),
        interpolation_mode="StepAfter" if view.steps else None, aggregation_policy="Off" if view.steps else None,
    )  # fmt: skip
    stream.static(entity, style)
    times = np.rint(line.points[:, 0] * 1e3).astype(np.int64)
    shown = (times % PLOT_PERIOD == 0) | view.steps  # counts can change from row to row
    stream.send(entity, times[shown], rr.Scalars.columns(scalars=line.points[shown, 1]))


def _origin(view: View) -> str:
    """Path of a plot, in letters that need no escape."""
    return "/" + "/".join(map(_plain, view.entity.split("/")))


def _plain(words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")


def _layout(tabs: Mapping[str, Sequence[View]]) -> rrb.Blueprint:
    pages = [
        rrb.Grid(*(_plot(view) for view in views), grid_columns=_COLUMNS, name=name) for name, views in tabs.items()
    ]
    return rrb.Blueprint(
        rrb.Tabs(*pages, rrb.TextDocumentView(origin="/captions", name="Captions"), active_tab=0),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _plot(view: View) -> rrb.TimeSeriesView:
    start, end = (rrb.TimeRangeBoundary.absolute(seconds=second) for second in view.span)
    return rrb.TimeSeriesView(
        origin=_origin(view),
        name=view.title,
        axis_x=rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end)),
        axis_y=rrb.ScalarAxis(range=ticked(*view.range, _LABELS)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop if view.steps else rrb.Corner2D.RightTop),
    )
