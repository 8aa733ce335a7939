"""How compared runs are arranged on the screen: one scene and one curve per controller in every plot."""

from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from emran_sumo.recording.colors import NIGHT, SLATE, packed
from emran_sumo.recording.layout import TIMELINE, line, road_map, whole_run
from emran_sumo.recording.plots import Curve

TRAIL = 10.0  # s of the way behind that is shown


class Measured(NamedTuple):
    """One plot: its title, the trace column, the unit it is shown in, and whether it counts."""

    title: str
    column: str
    unit: str = ""
    steps: bool = False


PLOTS = {
    "cross_track_error": Measured("Cross-track error [m], positive: path lies to the left", "cross_track_error"),
    "heading_error": Measured("Heading error [deg]", "heading_error", "deg"),
    "speed": Measured("Speed [m/s]; gray: the reference of the first", "speed_long"),
    "speed_error": Measured("Speed error [m/s]", "speed_error"),
    "steering": Measured("Steering command [deg]", "steer_command", "deg"),
    "steering_network": Measured("Steering by the network [deg]", "steer_network", "deg"),
    "acceleration": Measured("Acceleration command [m/s²]", "accel_command"),
    "acceleration_network": Measured("Acceleration by the network [m/s²]", "accel_network"),
    "accel_lat": Measured("Lateral acceleration [m/s²]", "accel_lat"),
    "neurons_steering": Measured("Neurons of the steering network", "neurons_steering", steps=True),
    "neurons_speed": Measured("Neurons of the speed network", "neurons_speed", steps=True),
}
TABS = {
    "Overview": ("cross_track_error", "heading_error", "speed", "steering"),
    "Steering": ("cross_track_error", "heading_error", "steering", "accel_lat"),
    "Speed": ("speed", "speed_error", "acceleration"),
    "Networks": ("steering_network", "acceleration_network", "neurons_steering", "neurons_speed"),
}


class Shown(NamedTuple):
    """One controller on the screen: its name, the end of its entity paths, its color."""

    label: str
    key: str
    color: tuple[int, int, int]


def curves(of: Shown) -> tuple[Curve, ...]:
    """The curves of one controller, in the order of the plots."""
    return tuple(Curve(plot.column, of.label, of.color, plot.unit) for plot in PLOTS.values())


def comparison_layout(
    controllers: tuple[Shown, ...], bounds: tuple[float, float, float, float], end: float
) -> rrb.Blueprint:
    """The layout that follows the first of the controllers; bounds [m] of the road, end [s] of the longest run."""
    first = controllers[0].label
    above = rrb.EyeControls3D(kind="Orbital", position=(12, 0, 42), look_target=(12.01, 0, 0), eye_up=(0, 1, 0))
    near = rrb.EyeControls3D(kind="Orbital", position=(1, 0, 11), look_target=(1.01, 0, 0), eye_up=(0, 1, 0))
    behind = rrb.EyeControls3D(kind="Orbital", position=(-14, 0, 6), look_target=(9, 0, 0.5), eye_up=(0, 0, 1))
    left = rrb.Vertical(
        _scene(f"Top-down, follows {first}; traffic of its run in gray", "/world/ego_frame", above, controllers),
        rrb.Horizontal(
            _scene("Close-up", "/world/ego_frame", near, controllers),
            rrb.Tabs(_scene("Chase camera", "/world/ego_frame", behind, controllers), road_map(bounds), active_tab=0),
        ),
        rrb.StateTimelineView(origin="/state", name="Maneuvers", time_view=whole_run()),
        row_shares=[3.6, 4.2, 1.6],
    )
    table = rrb.TextDocumentView(origin="/summary", name="Table")  # all columns and rows have room here
    right = rrb.Tabs(table, *(_tab(name, plots, controllers, end) for name, plots in TABS.items()), active_tab=1)
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.15, 1]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _tab(name: str, plots: tuple[str, ...], controllers: tuple[Shown, ...], end: float) -> rrb.Vertical:
    axis = whole_run(end)
    # one legend for all: the colors are the same
    views = [_plot(PLOTS[plot], axis, controllers, legend=plot == plots[0]) for plot in plots]
    return rrb.Vertical(*views, row_shares=[1.5] + [1.0] * (len(views) - 1), name=name)


def _plot(plot: Measured, axis: rrb.TimeAxis, controllers: tuple[Shown, ...], legend: bool) -> rrb.TimeSeriesView:
    overrides: dict = {
        f"/plots/{of.key}": [line(Curve(plot.column, of.label, of.color, plot.unit), plot.steps)] for of in controllers
    }
    if plot.column == "speed_long":
        overrides["/plots/reference"] = [
            line(Curve("speed_reference", f"reference of {controllers[0].label}", SLATE), False)
        ]
    return rrb.TimeSeriesView(
        origin="/plots",
        name=plot.title,
        contents=list(overrides),
        axis_x=axis,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightTop) if legend else rrb.PlotLegend(visible=False),
        overrides=overrides,
    )


def _scene(name: str, origin: str, eye: rrb.EyeControls3D, controllers: tuple[Shown, ...]) -> rrb.Spatial3DView:
    from_cursor = rrb.TimeRangeBoundary.cursor_relative
    recent = rrb.VisibleTimeRanges(timeline=TIMELINE, start=from_cursor(seconds=-TRAIL), end=from_cursor())
    overrides: dict = {f"/world/trail/{of.key}": recent for of in controllers}
    overrides["/world/traffic"] = rr.Boxes3D.from_fields(colors=packed([SLATE]))  # only the compared have colors
    contents = ["/world/**", "- /world/map/**", "- /world/ego/marker"]
    return rrb.Spatial3DView(
        origin=origin, name=name, contents=contents, eye_controls=eye, overrides=overrides,
        background=list(NIGHT), line_grid=False,
    )  # fmt: skip
