"""How compared runs are arranged on the screen: one scene and one curve per controller in every plot."""

from collections.abc import Mapping
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from emran_sumo.recording.colors import NIGHT, SLATE, packed
from emran_sumo.recording.layout import LETTERS, TIMELINE, line, road_map, whole_run
from emran_sumo.recording.plots import Curve, Plot, heading, ticked

TRAIL = 10.0  # s of the way behind that is shown


def _measured(title: str, unit: str, column: str, shown: str = "", note: str = "", steps: bool = False) -> Plot:
    """A plot of one trace column, in SI units or in the unit `shown`; each controller has a curve of its own."""
    return Plot(title, unit, (Curve(column, title, SLATE, shown),), note, steps)


PLOTS = {
    "cross_track_error": _measured("Cross-track error", "m", "cross_track_error", note="positive: path to the left"),
    "heading_error": _measured("Heading error", "deg", "heading_error", "deg"),
    "speed": _measured("Speed", "m/s", "speed_long", note="gray: the reference of the first"),
    "speed_error": _measured("Speed error", "m/s", "speed_error"),
    "steering": _measured("Steering command", "deg", "steer_command", "deg"),
    "steering_network": _measured("Steering by the network", "deg", "steer_network", "deg"),
    "acceleration": _measured("Acceleration command", "m/s²", "accel_command"),
    "acceleration_network": _measured("Acceleration by the network", "m/s²", "accel_network"),
    "accel_lat": _measured("Lateral acceleration", "m/s²", "accel_lat"),
    "neurons_steering": _measured("Neurons of the steering network", "", "neurons_steering", steps=True),
    "neurons_speed": _measured("Neurons of the speed network", "", "neurons_speed", steps=True),
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
    return tuple(curve._replace(label=of.label, color=of.color) for plot in PLOTS.values() for curve in plot.curves)


def comparison_layout(
    controllers: tuple[Shown, ...],
    bounds: tuple[float, float, float, float],
    end: float,
    reached: Mapping[str, tuple[float, float]],
) -> rrb.Blueprint:
    """The layout that follows the first of the controllers.

    Args:
        controllers: in their order.
        bounds: (x_min, y_min, x_max, y_max) [m] of the road.
        end: s, of the longest run.
        reached: smallest and largest value of the curves of each plot, over all controllers.
    """
    first = controllers[0].label
    above = rrb.EyeControls3D(kind="Orbital", position=(12, 0, 42), look_target=(12.01, 0, 0), eye_up=(0, 1, 0))
    near = rrb.EyeControls3D(kind="Orbital", position=(1, 0, 11), look_target=(1.01, 0, 0), eye_up=(0, 1, 0))
    behind = rrb.EyeControls3D(kind="Orbital", position=(-14, 0, 6), look_target=(9, 0, 0.5), eye_up=(0, 0, 1))
    left = rrb.Vertical(
        _scene(
            f"Top-down, follows {first}; teal: path ahead, gray: traffic of its run",
            "/world/ego_frame",
            above,
            controllers,
        ),
        rrb.Horizontal(
            _scene("Close-up", "/world/ego_frame", near, controllers),
            rrb.Tabs(_scene("Chase camera", "/world/ego_frame", behind, controllers), road_map(bounds), active_tab=0),
        ),
        rrb.StateTimelineView(origin="/state", name="Maneuvers", time_view=whole_run()),
        row_shares=[3.6, 3.6, 1.2 + 0.45 * min(len(controllers), 4)],  # each maneuver takes 40 of 730 pixels
    )
    table = rrb.TextDocumentView(origin="/summary", name="Table")  # all columns and rows have room here
    right = rrb.Tabs(
        table, *(_tab(name, plots, controllers, end, reached) for name, plots in TABS.items()), active_tab=1
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.15, 1]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _tab(
    name: str, plots: tuple[str, ...], controllers: tuple[Shown, ...], end: float, reached: Mapping
) -> rrb.Vertical:
    axis = whole_run(end)
    # one legend for all: the colors are the same
    views = [_plot(plot, axis, controllers, reached[plot], legend=plot == plots[0]) for plot in plots]
    return rrb.Vertical(*views, row_shares=[1.5] + [1.0] * (len(views) - 1), name=name)


def _plot(
    name: str, axis: rrb.TimeAxis, controllers: tuple[Shown, ...], reached: tuple[float, float], legend: bool
) -> rrb.TimeSeriesView:
    plot = PLOTS[name]
    (curve,) = plot.curves
    overrides: dict = {
        f"/plots/{of.key}": [line(curve._replace(label=of.label, color=of.color), plot.steps)] for of in controllers
    }
    if name == "speed":
        overrides["/plots/reference"] = [
            line(Curve("speed_reference", f"reference of {controllers[0].label}", SLATE), False)
        ]
    return rrb.TimeSeriesView(
        origin="/plots",
        name=heading(plot, reached, LETTERS[1]),
        contents=list(overrides),
        axis_x=axis,
        axis_y=rrb.ScalarAxis(range=ticked(*reached, 5)),
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
