"""How a run is shown: its plots, its colors, and the layout that every file carries."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

TIMELINE = "sim_time"
ARCHETYPE = "trace"  # prefix of the component names of all curves

# Mid luminance, so that lines stay legible in the dark and in the light theme of the viewer.
PINK, SLATE, TEAL, AMBER = (244, 63, 160), (148, 163, 184), (45, 190, 175), (245, 158, 11)
VIOLET, BLUE, RED, GREEN = (155, 120, 250), (14, 165, 233), (239, 80, 80), (34, 170, 100)
NIGHT, ASPHALT, PAINT = (15, 18, 24), (44, 49, 58), (226, 232, 240)

SPEED_STOPS = np.array([0.0, 8.0, 16.0, 24.0, 32.0])  # m/s
SPEED_COLORS = np.array([(220, 50, 47), (245, 140, 40), (250, 215, 70), (95, 205, 130), (70, 150, 255)], dtype=float)
LEGEND = "traffic by speed: red 0, orange 8, yellow 16, green 24, blue 32 m/s"

_SCALES = {"": 1.0, "deg": 180.0 / np.pi, "percent": 100.0, "kN": 1e-3}


class Curve(NamedTuple):
    """One line of a plot: a trace column, shown in SI units or in `unit` (deg, percent, kN)."""

    column: str
    label: str
    color: tuple[int, int, int]
    unit: str = ""

    @property
    def component(self) -> str:
        """Its name in the file: the trace column, and the unit where it is not the SI unit."""
        return f"{self.column}_{self.unit}" if self.unit else self.column

    @property
    def scale(self) -> float:
        return _SCALES[self.unit]


class Plot(NamedTuple):
    """One plot of several curves; `steps`: counts, drawn as stairs."""

    title: str
    curves: tuple[Curve, ...]
    steps: bool = False


def _axles(name: str, unit: str = "") -> tuple[Curve, ...]:
    return (Curve(f"{name}_front", "front", BLUE, unit), Curve(f"{name}_rear", "rear", AMBER, unit))


def _networks(name: str) -> tuple[Curve, ...]:
    return (
        Curve(f"{name}_steering", "steering network", VIOLET),
        Curve(f"{name}_speed", "speed network", TEAL),
    )


def _structure(network: str) -> tuple[Curve, ...]:
    return (
        Curve(f"grown_{network}", "grown", GREEN),
        Curve(f"pruned_{network}", "pruned", RED),
        Curve(f"merged_{network}", "merged", BLUE),
    )


PLOTS = {
    "speed": Plot("Speed [m/s]", (Curve("speed_long", "actual", PINK), Curve("speed_reference", "reference", SLATE))),
    "speed_error": Plot("Speed error [m/s]", (Curve("speed_error", "speed error", RED),)),
    "cross_track_error": Plot(
        "Cross-track error [m], positive: path lies to the left",
        (Curve("cross_track_error", "cross-track error", RED),),
    ),
    "heading_error": Plot("Heading error [deg]", (Curve("heading_error", "heading error", RED, "deg"),)),
    "steering": Plot(
        "Steering angle, command = law + network [deg]",
        (
            Curve("steer_law", "law", AMBER, "deg"),
            Curve("steer_network", "network", VIOLET, "deg"),
            Curve("steer_command", "command", BLUE, "deg"),
            Curve("steer", "actual", PINK, "deg"),
        ),
    ),
    "acceleration": Plot(
        "Acceleration, command = law + network [m/s²]",
        (
            Curve("accel_law", "law", AMBER),
            Curve("accel_network", "network", VIOLET),
            Curve("accel_command", "command", BLUE),
            Curve("accel_long", "actual", PINK),
        ),
    ),
    "torque": Plot("Wheel torque [N m]", (Curve("torque", "torque", BLUE),)),
    "yaw_rate": Plot("Yaw rate [deg/s]", (Curve("yaw_rate", "yaw rate", PINK, "deg"),)),
    "accel_lat": Plot("Lateral acceleration [m/s²]", (Curve("accel_lat", "lateral acceleration", PINK),)),
    "slip_ratio": Plot("Slip ratio [%]", _axles("slip_ratio", "percent")),
    "slip_angle": Plot("Slip angle [deg]", _axles("slip_angle", "deg")),
    "load": Plot("Axle load [kN]", _axles("load", "kN")),
    "friction_use": Plot("Friction use, 1 = at the limit", _axles("friction_use")),
    "signal_steering": Plot("Learning signal, steering [deg]", (Curve("signal_steering", "steering", VIOLET, "deg"),)),
    "signal_speed": Plot("Learning signal, speed [m/s²]", (Curve("signal_speed", "speed", TEAL),)),
    "neurons": Plot("Neurons", _networks("neurons"), steps=True),
    "learned": Plot("Samples learned so far", _networks("learned"), steps=True),
    "structure_steering": Plot("Steering network: neurons so far", _structure("steering"), steps=True),
    "structure_speed": Plot("Speed network: neurons so far", _structure("speed"), steps=True),
}
CURVES = tuple(curve for plot in PLOTS.values() for curve in plot.curves)

# Tab -> rows of plots; more than four rows do not fit a window of 1080 pixels.
_TABS = {
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

STATES = {
    "maneuver": {
        "keep lane": (51, 65, 85),
        "change left": (14, 116, 144),
        "change right": (109, 40, 217),
        "waiting for a gap": (180, 83, 9),
    },
    "learning": {"off": (71, 85, 105), "learning": (91, 33, 182), "settled": (22, 101, 52)},
}

EVENT_COLORS = {"DEBUG": SLATE, "INFO": BLUE, "WARN": AMBER, "ERROR": RED}


def packed(colors: Iterable[tuple[int, int, int]]) -> np.ndarray:
    """Opaque 0xRRGGBBAA of (n, 3) colors in 0..255, the one form Rerun cannot misread."""
    rgb = np.asarray(list(colors), dtype=np.uint32).reshape(-1, 3)
    return (rgb[:, 0] << 24) | (rgb[:, 1] << 16) | (rgb[:, 2] << 8) | np.uint32(255)


def _speed_scale() -> np.ndarray:
    speeds = np.arange(0.0, SPEED_STOPS[-1] + 0.25, 0.5)
    return packed(np.column_stack([np.interp(speeds, SPEED_STOPS, c) for c in SPEED_COLORS.T]).astype(int))


_SPEED_SCALE = _speed_scale()


def speed_colors(speed: np.ndarray) -> np.ndarray:
    """(n,) packed colors of speeds [m/s], in steps of 0.5 m/s, so that steady traffic compresses well."""
    step = np.rint(2.0 * np.asarray(speed)).astype(np.int64)
    return _SPEED_SCALE[np.clip(step, 0, len(_SPEED_SCALE) - 1)]


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
        rrb.Tabs(*(_tab(name, entities) for name, entities in _TABS.items()), active_tab=0),
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
