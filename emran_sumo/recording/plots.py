"""What is plotted: trace columns as labeled curves, curves as plots; and the lanes of the state timeline."""

from typing import NamedTuple

import numpy as np

from emran_sumo.recording.colors import AMBER, BLUE, GREEN, PINK, RED, SLATE, TEAL, VIOLET

ARCHETYPE = "trace"  # prefix of the component names of all curves

LINE_WIDTH = 2.0  # points

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
    """One plot of several curves.

    steps: counts, drawn as stairs; entity: where its curves are; least: (low, high) that the vertical axis always
    shows; fixed: and nothing beyond it.
    """

    title: str
    curves: tuple[Curve, ...]
    steps: bool = False
    entity: str = "/plots/ego"
    least: tuple[float, float] | None = None
    fixed: bool = False


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
    "speed": Plot("Speed [m/s]", (Curve("speed_reference", "reference", SLATE), Curve("speed_long", "actual", PINK))),
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
    "grade": Plot("Grade [deg]", (Curve("grade", "grade", TEAL, "deg"),), least=(-1.1, 1.1)),
    "friction": Plot("Road friction", (Curve("friction", "friction", TEAL),), least=(0.0, 1.1)),
    "force_external": Plot(
        "Side force [kN]", (Curve("force_external_lat", "side force", RED, "kN"),), least=(-1.1, 1.1)
    ),
    "gap": Plot("Gap to the vehicle ahead [m]", (Curve("lead_gap", "gap", BLUE),), least=(0.0, 110.0), fixed=True),
    "time_to_collision": Plot(
        "Time to collision [s], while closing in",
        (Curve("time_to_collision", "TTC", AMBER),),
        least=(0.0, 15.0),
        fixed=True,
    ),
    "deceleration_to_avoid": Plot(
        "Deceleration to avoid a collision [m/s²]",
        (Curve("deceleration_to_avoid", "DRAC", RED),),
        least=(0.0, 11.0),
        fixed=True,
    ),
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
INSIGHTS = {
    f"{what}_{network}": Plot(
        f"{title}, {network} network", (Curve(what, label, color),), True, f"/plots/{network}_network"
    )
    for network, color in (("steering", VIOLET), ("speed", TEAL))
    for what, title, label in (
        ("weights", "Weights", "weight"),
        ("widths", "Widths", "width"),
        ("covariance", "Trace of P of the winner", "trace of P"),
        ("share_learned", "Share of samples used [%]", "share"),
    )
}
CURVES = tuple(curve for plot in PLOTS.values() for curve in plot.curves)

STATES = {
    "maneuver": {
        "keep lane": (51, 65, 85),
        "change left": (14, 116, 144),
        "change right": (109, 40, 217),
        "double lane change": (21, 128, 61),
        "waiting for a gap": (180, 83, 9),
        "waiting to return": (161, 98, 7),
    },
    "learning": {"off": (71, 85, 105), "learning": (91, 33, 182), "settled": (22, 101, 52)},
    "disturbance": {
        "none": (51, 65, 85),
        "side force": (185, 28, 28),
        "low friction": (29, 78, 216),
        "side force on low friction": (157, 23, 77),
    },
}

EVENT_COLORS = {"DEBUG": SLATE, "INFO": BLUE, "WARN": AMBER, "ERROR": RED}


def ticked(low: float, high: float, most: int = 5) -> tuple[float, float]:
    """The range of an axis that holds low..high and at least two of its labels, where `most` labels have room.

    The viewer labels powers of ten only, about 20 pixels apart at the least: a curve of +-0.07 would show "0" alone.
    """
    if not (np.isfinite(low) and np.isfinite(high)):
        return 0.0, 1.1
    if high == low:  # nothing happens: a count that stays at 0 is shown between 0 and 1
        high = low + 1.0
    margin = 0.06 * max(high - low, 1e-6)
    low, high = float(low - margin), float(high + margin)
    step = 10.0 ** np.floor(np.log10(high - low))
    if high - low > most * step:
        step *= 10.0
    first, last = np.ceil(low / step), np.floor(high / step)
    while last - first < 1:  # widen to the nearer label, if need be on both sides
        below, above = low - (first - 1) * step, (last + 1) * step - high
        if below <= above:
            first -= 1
        else:
            last += 1
    edge = 0.1 * step
    return float(min(low, first * step - edge)), float(max(high, last * step + edge))
