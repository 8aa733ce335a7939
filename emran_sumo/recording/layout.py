"""How a run is arranged on the screen: the layout that every file carries."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from emran_sumo.recording.colors import LEGEND, NIGHT, packed
from emran_sumo.recording.insight import AXES, DRAWN, Insight
from emran_sumo.recording.plots import ARCHETYPE, CURVES, INSIGHTS, PLOTS, Curve, Plot, heading, ticked
from emran_sumo.recording.stream import TIMELINE

LEGEND_ROOM = 1.25  # times the run is what a plot of the whole run spans
LETTERS = {1: 75, 2: 29, 3: 12}  # that a heading has room for in a window of 1366 pixels, by the views in its row
FORCES, SPACE_STEERING, SPACE_SPEED = "tire forces", "space steering", "space speed"  # views that are no plots
# Tab -> rows of views; more tabs, longer names or a fifth row do not fit a window of 1366 x 768 pixels.
TABS = {
    "Overview": (("speed",), ("cross_track_error",), ("steering",), ("neurons",)),
    "Tracking": (("cross_track_error",), ("heading_error",), ("speed", "speed_error"), ("grade", "force_external")),
    "Tires": ((FORCES, "friction_use"), ("slip_angle", "slip_ratio"), ("load", "friction"), ("yaw_rate", "accel_lat")),
    "Speed network": (
        ("acceleration",),
        ("signal_speed", "structure_speed"),
        ("torque", "share_learned_speed", "covariance_speed"),
        (SPACE_SPEED, "weights_speed", "widths_speed"),
    ),
    "Steering network": (
        ("steering",),
        ("signal_steering", "structure_steering"),
        ("learned", "share_learned_steering", "covariance_steering"),
        (SPACE_STEERING, "weights_steering", "widths_steering"),
    ),
    "Safety": (("gap",), ("time_to_collision",), ("deceleration_to_avoid",)),
}


class Extents:
    """How far the curves and the centers of the networks have reached so far; the layout is drawn to them."""

    def __init__(self, curves: int = len(CURVES)) -> None:
        self._low, self._high = np.full(curves, np.inf), np.full(curves, -np.inf)
        self._boxes: dict[str, tuple[np.ndarray, float]] = {}
        self.end: float | None = None  # s, of the run, once it is known

    def include(self, values: np.ndarray) -> None:
        """Take in values (curves, n); NaN counts for nothing."""
        self._low = np.fmin(self._low, np.fmin.reduce(values, axis=1))
        self._high = np.fmax(self._high, np.fmax.reduce(values, axis=1))

    def include_space(self, network: str, seen: Sequence[Insight]) -> None:
        """Widen the space that a network's neurons, and the car's inputs, have been in."""
        places = np.concatenate([np.vstack((one.centers, one.point))[:, :3] for one in seen])
        widest = DRAWN * max(float(one.widths.max(initial=1.0)) for one in seen)
        box = np.array((places.min(axis=0), places.max(axis=0)))
        if network in self._boxes:
            before, wide = self._boxes[network]
            box, widest = np.array((np.fmin(box[0], before[0]), np.fmax(box[1], before[1]))), max(widest, wide)
        self._boxes[network] = box, widest

    @property
    def spaces(self) -> dict[str, tuple[np.ndarray, float]]:
        """Middle (3,) of each network's space, and how far it reaches from there."""
        return {
            network: (0.5 * (low + high), 0.5 * float((high - low)[:2].max()) + widest)
            for network, ((low, high), widest) in self._boxes.items()
        }

    def of(self, plot: Plot) -> tuple[float, float] | None:
        """Range (low, high) of a plot's vertical axis; None before anything was seen: the viewer finds it."""
        if plot.fixed:
            return plot.least
        reached = self.reached(plot)
        if reached is None:
            return plot.least
        low, high = reached
        if plot.least is not None:
            low, high = min(low, plot.least[0]), max(high, plot.least[1])
        return ticked(low, high, 5 if len(plot.curves) > 3 else 3)

    def reached(self, plot: Plot) -> tuple[float, float] | None:
        """Smallest and largest value of a plot's curves; None before anything was seen."""
        at = [k for k, curve in enumerate(CURVES) if curve in plot.curves]
        if not at or not np.isfinite(self._low[at]).any():
            return None
        return float(np.nanmin(self._low[at])), float(np.nanmax(self._high[at]))


def layout(bounds: tuple[float, float, float, float], extents: Extents) -> rrb.Blueprint:
    """The layout that follows the ego.

    Args:
        bounds: (x_min, y_min, x_max, y_max) [m] of the road, for the map.
        extents: of what has been driven; before anything has, the viewer finds the ranges itself.
    """
    left = rrb.Vertical(
        _top_down(),
        rrb.Horizontal(
            rrb.Tabs(_chase(), road_map(bounds), active_tab=0),
            _events(),
            column_shares=[1, 1.3],
        ),
        rrb.StateTimelineView(origin="/state", name="Maneuver, learning, disturbance", time_view=whole_run()),
        row_shares=[5, 4, 2.9],
    )
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/summary", name="Summary"),
        rrb.Tabs(*(_tab(name, entities, extents) for name, entities in TABS.items()), active_tab=0),
        row_shares=[1.3, 4.3],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.3, 1]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _events() -> rrb.TextLogView:
    """Time and text; the color of a text is its level, and a column for that would cut off the text."""
    return rrb.TextLogView(origin="/events", name="Events", columns=rrb.TextLogColumns(text_log_columns=["Body"]))


def whole_run(end: float | None = None) -> rrb.TimeAxis:
    """All of the time; with the `end` [s] of the run, room behind it, so that the legend hides no curve."""
    last = (
        rrb.TimeRangeBoundary.infinite() if end is None else rrb.TimeRangeBoundary.absolute(seconds=LEGEND_ROOM * end)
    )
    first = rrb.TimeRangeBoundary.infinite() if end is None else rrb.TimeRangeBoundary.absolute(seconds=0.0)
    return rrb.TimeAxis(view_range=rr.TimeRange(start=first, end=last))


def _tab(name: str, rows: tuple[tuple[str, ...], ...], extents: Extents) -> rrb.Vertical:
    """The overview spans the whole run; the plots of the other tabs zoom together."""
    axis = whole_run(extents.end) if name == "Overview" else rrb.TimeAxis(link="LinkToGlobal")
    parts, shares = [], []
    for row in rows:
        views = [_view(view, axis, extents, LETTERS[len(row)]) for view in row]
        parts.append(views[0] if len(views) == 1 else rrb.Horizontal(*views))
        legend = max((len(PLOTS[view].curves) for view in row if view in PLOTS and PLOTS[view].legend), default=0)
        tall = any(view not in PLOTS and view not in INSIGHTS for view in row)
        least = 1.1 if len(row) == 3 else 1.0
        shares.append(1.4 if tall else {4: 2.1, 3: 1.4}.get(legend, least))  # room for the picture, for the legend
    return rrb.Vertical(*parts, row_shares=shares, name=name)


def _view(name: str, axis: rrb.TimeAxis, extents: Extents, room: int) -> rrb.View:
    if name == FORCES:
        return _tire_forces()
    if name in (SPACE_STEERING, SPACE_SPEED):
        return _space(name.split()[1], extents)
    plot = INSIGHTS.get(name) or PLOTS[name]
    words = heading(plot, None if plot.fixed else extents.reached(plot), room)
    return _plot(plot, words, axis, extents.of(plot))


def _plot(plot: Plot, words: str, axis: rrb.TimeAxis, span: tuple[float, float] | None) -> rrb.TimeSeriesView:
    sliding = axis.link is not None  # without room behind the end: counts grow away from the left
    corner = rrb.Corner2D.LeftTop if plot.steps and sliding else rrb.Corner2D.RightTop
    # All curves of an ego are components of one entity: a fifth of the size of one entity per curve.
    return rrb.TimeSeriesView(
        origin=plot.entity,
        name=words,
        axis_x=axis,
        axis_y=None if span is None else rrb.ScalarAxis(range=span),
        plot_legend=rrb.PlotLegend(corner) if plot.legend else rrb.PlotLegend(visible=False),
        overrides={plot.entity: [line(curve, plot.steps) for curve in plot.curves]},
    )


def _tire_forces() -> rrb.Spatial2DView:
    return rrb.Spatial2DView(
        origin="/tires",
        name="Tire forces in friction × load",
        background=list(NIGHT),
        visual_bounds=rrb.VisualBounds2D(x_range=[-20.5, 20.5], y_range=[-14.5, 10.0]),
    )


def _space(network: str, extents: Extents) -> rrb.Spatial3DView:
    """Small spheres about the centers, seen from above; the amber one is where the car is."""
    (x, y, z), reach = extents.spaces.get(network, (np.zeros(3), 5.0))
    eye = rrb.EyeControls3D(
        kind="Orbital", position=(x, y - 0.4 * reach, z + 2.4 * reach), look_target=(x, y, z), eye_up=(0, 1, 0)
    )
    return rrb.Spatial3DView(
        origin=f"/networks/{network}",
        name=f"Centers: {AXES[network]}",
        background=list(NIGHT),
        line_grid=False,
        eye_controls=eye,
    )


def line(curve: Curve, steps: bool) -> rrb.Visualizer:
    style = rr.SeriesLines(
        names=curve.label,
        colors=packed([curve.color]),
        interpolation_mode="StepAfter" if steps else None,
    )
    source = VisualizerComponentMapping(
        target="Scalars:scalars",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=f"{ARCHETYPE}:{curve.component}",
    )
    return style.visualizer(mappings=[source])


def _top_down() -> rrb.Spatial3DView:
    # Looking exactly down leaves the turn of the picture open; 1 cm aside settles it.
    eye = rrb.EyeControls3D(kind="Orbital", position=(14, 0, 46), look_target=(14.01, 0, 0), eye_up=(0, 1, 0))
    return _scene(f"Top-down: pink ego, teal its path; {LEGEND}", "/world/ego_frame", eye)


def _chase() -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(kind="Orbital", position=(-13, 0, 5.5), look_target=(9, 0, 0.5), eye_up=(0, 0, 1))
    return _scene("Chase camera", "/world/ego", eye, ("- /world/road/patch/label",))  # it would hide the road


def _scene(name: str, origin: str, eye: rrb.EyeControls3D, without: tuple[str, ...] = ()) -> rrb.Spatial3DView:
    recent = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-10.0),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=["/world/**", "- /world/map/**", "- /world/ego/marker", *without],
        background=list(NIGHT),
        line_grid=False,
        eye_controls=eye,
        overrides={"/world/trail": recent},
    )


def road_map(bounds: tuple[float, float, float, float]) -> rrb.Spatial3DView:
    x_min, y_min, x_max, y_max = bounds
    x, y = (x_min + x_max) / 2, (y_min + y_max) / 2
    height = 1.15 * max((x_max - x_min) / 1.2, y_max - y_min, 50.0)
    return rrb.Spatial3DView(
        name="Map",
        origin="/world",
        contents=["/world/map/**", "/world/ego/marker"],
        background=list(NIGHT),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind="Orbital", position=(x, y, height), look_target=(x, y + 1e-4 * height, 0), eye_up=(0, 1, 0)
        ),
    )
