"""What is plotted: trace columns as labeled curves, curves as plots; and the lanes of the state timeline."""

from typing import NamedTuple

import numpy as np

from emran_sumo.recording.colors import AMBER, BLUE, GREEN, PINK, RED, SLATE, TEAL, VIOLET

ARCHETYPE = "trace"  # prefix of the component names of all curves

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
