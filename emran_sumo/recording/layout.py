"""How a run is arranged on the screen: the layout that every file carries."""

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from emran_sumo.recording.colors import LEGEND, NIGHT, packed
from emran_sumo.recording.plots import ARCHETYPE, PLOTS, Curve, Plot

TIMELINE = "sim_time"

# Tab -> rows of plots; more than four rows do not fit a window of 1080 pixels.
TABS = {
    "Overview": (("speed",), ("cross_track_error",), ("steering",), ("neurons",)),
    "Tracking": (("cross_track_error",), ("heading_error",), ("speed",), ("speed_error",)),
    "Networks": (
        ("signal_steering",),
        ("signal_speed",),
        ("neurons", "learned"),
        ("structure_steering", "structure_speed"),
    ),
    "Tires": (("slip_ratio",), ("slip_angle",), ("load",), ("friction_use",)),
    "Motion": (("acceleration",), ("torque",), ("yaw_rate",), ("accel_lat",)),
}


def layout(bounds: tuple[float, float, float, float]) -> rrb.Blueprint:
    """The layout that follows the ego; bounds = (x_min, y_min, x_max, y_max) [m] of the road, for the map."""
    left = rrb.Vertical(
        _top_down(),
        rrb.Horizontal(
            rrb.Tabs(_chase(), _road_map(bounds), active_tab=0),
            _events(),
            column_shares=[1, 1.15],
        ),
        rrb.StateTimelineView(origin="/state", name="Maneuver and learning", time_view=_whole_run()),
        row_shares=[5, 4, 1.75],
    )
    right = rrb.Vertical(
        rrb.TextDocumentView(origin="/summary", name="Summary"),
        rrb.Tabs(*(_tab(name, entities) for name, entities in TABS.items()), active_tab=0),
        row_shares=[1, 4.3],
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _events() -> rrb.TextLogView:
    return rrb.TextLogView(
        origin="/events", name="Events", columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    )


def _whole_run() -> rrb.TimeAxis:
    return rrb.TimeAxis(
        view_range=rr.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
    )


def _tab(name: str, rows: tuple[tuple[str, ...], ...]) -> rrb.Vertical:
    """The overview spans the whole run; the plots of the other tabs zoom together."""
    axis = _whole_run() if name == "Overview" else rrb.TimeAxis(link="LinkToGlobal")
    parts, shares = [], []
    for row in rows:
        plots = [_plot(PLOTS[plot], axis) for plot in row]
        parts.append(plots[0] if len(plots) == 1 else rrb.Horizontal(*plots))
        shares.append(1.3 if max(len(PLOTS[plot].curves) for plot in row) > 3 else 1.0)  # room for the legend
    return rrb.Vertical(*parts, row_shares=shares, name=name)


def _plot(plot: Plot, axis: rrb.TimeAxis) -> rrb.TimeSeriesView:
    corner = rrb.Corner2D.LeftTop if plot.steps else rrb.Corner2D.RightTop  # counts grow away from the left
    # All curves of an ego are components of one entity: a fifth of the size of one entity per curve.
    return rrb.TimeSeriesView(
        origin="/plots/ego",
        name=plot.title,
        axis_x=axis,
        defaults=[rr.SeriesLines.from_fields(widths=2.0)],
        plot_legend=rrb.PlotLegend(corner, visible=len(plot.curves) > 1),
        overrides={"/plots/ego": [_line(curve, plot.steps) for curve in plot.curves]},
    )


def _line(curve: Curve, steps: bool) -> rrb.Visualizer:
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
    eye = rrb.EyeControls3D(kind="Orbital", position=(18, 0, 60), look_target=(18.01, 0, 0), eye_up=(0, 1, 0))
    return _scene(f"Top-down; {LEGEND}", "/world/ego_frame", eye)


def _chase() -> rrb.Spatial3DView:
    eye = rrb.EyeControls3D(kind="Orbital", position=(-13, 0, 5.5), look_target=(9, 0, 0.5), eye_up=(0, 0, 1))
    return _scene("Chase camera", "/world/ego", eye)


def _scene(name: str, origin: str, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    recent = rrb.VisibleTimeRanges(
        timeline=TIMELINE,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-10.0),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=["/world/**", "- /world/map/**", "- /world/ego/marker"],
        background=list(NIGHT),
        line_grid=False,
        eye_controls=eye,
        overrides={"/world/trail": recent},
    )


def _road_map(bounds: tuple[float, float, float, float]) -> rrb.Spatial3DView:
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
