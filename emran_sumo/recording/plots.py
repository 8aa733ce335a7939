"""What is plotted: trace columns as labeled curves, curves as plots; and the lanes of the state timeline."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo.recording.colors import AMBER, BLUE, GREEN, PINK, RED, SLATE, TEAL, VIOLET

ARCHETYPE = "trace"  # prefix of the component names of all curves

LINE_WIDTH = 2.0  # points
WASTE = 0.4  # of an axis may be empty so that it has two labels

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

    note: what its heading says besides; steps: counts, drawn as stairs; entity: where its curves are; least: (low,
    high) that the vertical axis always shows; fixed: and nothing beyond it; legend: whether it has one.
    """

    title: str
    unit: str
    curves: tuple[Curve, ...]
    note: str = ""
    steps: bool = False
    entity: str = "/plots/ego"
    least: tuple[float, float] | None = None
    fixed: bool = False
    legend: bool = False


def heading(plot: Plot, reached: tuple[float, float] | None, room: int) -> str:
    """Title, range of the values reached (None: the unit alone) and note, as far as `room` letters hold them."""
    plain = f"{plot.title} [{plot.unit}]" if plot.unit else plot.title
    fine, coarse = plain, plain
    if reached is not None:
        fine, coarse = (
            f"{plot.title} {between(*reached, 0 if plot.steps else n)} {plot.unit}".rstrip() for n in (2, 1)
        )
    wishes = (f"{fine}; {plot.note}", fine, coarse) if plot.note else (fine, coarse)
    return next((wish for wish in wishes if _letters(wish) <= room), plain)


def _letters(text: str) -> float:
    """Length in the viewer's font, whose digits are wider than its average letter."""
    return len(text) + 0.25 * sum(letter.isdigit() for letter in text)


def _axles(name: str, unit: str = "") -> tuple[Curve, ...]:
    return (Curve(f"{name}_front", "front", BLUE, unit), Curve(f"{name}_rear", "rear", AMBER, unit))


def _networks(name: str) -> tuple[Curve, ...]:
    return (
        Curve(f"{name}_steering", "steering", VIOLET),
        Curve(f"{name}_speed", "speed", TEAL),
    )


def _structure(network: str) -> tuple[Curve, ...]:
    return (
        Curve(f"grown_{network}", "grown", GREEN),
        Curve(f"pruned_{network}", "pruned", RED),
        Curve(f"merged_{network}", "merged", BLUE),
    )


_SUM = "command = law + network"
PLOTS = {
    "speed": Plot(
        "Speed",
        "m/s",
        (Curve("speed_reference", "reference", SLATE), Curve("speed_long", "actual", PINK)),
        "gray: reference",
    ),
    "speed_error": Plot("Speed error", "m/s", (Curve("speed_error", "speed error", RED),)),
    "cross_track_error": Plot(
        "Cross-track error", "m", (Curve("cross_track_error", "cross-track error", RED),), "positive: path to the left"
    ),
    "heading_error": Plot("Heading error", "deg", (Curve("heading_error", "heading error", RED, "deg"),)),
    "steering": Plot(
        "Steering angle",
        "deg",
        (
            Curve("steer_law", "law", AMBER, "deg"),
            Curve("steer_network", "network", VIOLET, "deg"),
            Curve("steer_command", "command", BLUE, "deg"),
            Curve("steer", "actual", PINK, "deg"),
        ),
        _SUM,
        legend=True,
    ),
    "acceleration": Plot(
        "Acceleration",
        "m/s²",
        (
            Curve("accel_law", "law", AMBER),
            Curve("accel_network", "network", VIOLET),
            Curve("accel_command", "command", BLUE),
            Curve("accel_long", "actual", PINK),
        ),
        _SUM,
        legend=True,
    ),
    "torque": Plot("Torque", "N m", (Curve("torque", "torque", BLUE),)),
    "grade": Plot("Grade", "deg", (Curve("grade", "grade", TEAL, "deg"),), least=(-1.1, 1.1)),
    "friction": Plot("Road friction", "", (Curve("friction", "friction", TEAL),), least=(0.0, 1.1)),
    "force_external": Plot(
        "Side force", "kN", (Curve("force_external_lat", "side force", RED, "kN"),), least=(-1.1, 1.1)
    ),
    "gap": Plot("Gap to the vehicle ahead", "m", (Curve("lead_gap", "gap", BLUE),), least=(0.0, 110.0), fixed=True),
    "time_to_collision": Plot(
        "Time to collision",
        "s",
        (Curve("time_to_collision", "TTC", AMBER),),
        "while closing in",
        least=(0.0, 15.0),
        fixed=True,
    ),
    "deceleration_to_avoid": Plot(
        "Deceleration to avoid a collision",
        "m/s²",
        (Curve("deceleration_to_avoid", "DRAC", RED),),
        least=(0.0, 11.0),
        fixed=True,
    ),
    "yaw_rate": Plot("Yaw rate", "deg/s", (Curve("yaw_rate", "yaw rate", PINK, "deg"),)),
    "accel_lat": Plot("Lateral accel.", "m/s²", (Curve("accel_lat", "lateral acceleration", PINK),)),
    "slip_ratio": Plot("Slip ratio", "%", _axles("slip_ratio", "percent")),
    "slip_angle": Plot("Slip angle", "deg", _axles("slip_angle", "deg")),
    "load": Plot("Axle load", "kN", _axles("load", "kN")),
    "friction_use": Plot("Friction use", "", _axles("friction_use"), "1: limit", legend=True),
    "signal_steering": Plot("Learning signal", "deg", (Curve("signal_steering", "steering", VIOLET, "deg"),)),
    "signal_speed": Plot("Learning signal", "m/s²", (Curve("signal_speed", "speed", TEAL),)),
    "neurons": Plot("Neurons", "", _networks("neurons"), "of the two networks", True, legend=True),
    "learned": Plot("Samples", "", _networks("learned"), steps=True),
    "structure_steering": Plot("Neurons so far", "", _structure("steering"), steps=True, legend=True),
    "structure_speed": Plot("Neurons so far", "", _structure("speed"), steps=True, legend=True),
}
INSIGHTS = {
    f"{what}_{network}": Plot(title, unit, (Curve(what, label, color),), "", True, f"/plots/{network}_network")
    for network, color in (("steering", VIOLET), ("speed", TEAL))
    for what, title, unit, label in (
        ("weights", "Weights", "", "weight"),
        ("widths", "Widths", "", "width"),
        ("covariance", "Trace of P", "", "trace of P"),
        ("share_learned", "Share", "%", "share"),
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
        "at its stop": (17, 94, 89),
        "in a queue": (120, 53, 15),
        "at a red light": (153, 27, 27),
        "gives way": (133, 77, 14),
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


def between(low: float, high: float, digits: int = 2) -> str:
    """The range low..high in `digits` of the larger end, in up to two more where the ends differ by less, 0: in whole
    numbers; one number where the ends are alike even so."""
    largest, apart = max(abs(low), abs(high)), high - low
    decimals = 0
    if digits and 0.0 < largest < 100.0:
        decimals = max(digits - 1 - _decade(largest), digits - 1)
        needed = -_decade(apart) if apart > 0.0 else 0
        decimals = min(max(decimals, min(needed, decimals + 2)), 6)
    ends = [f"{end:.{decimals}f}" for end in (low, high)]
    ends = [(end if float(end) else "0").replace("-", "−") for end in ends]
    return ends[0] if ends[0] == ends[1] else "…".join(ends)


def _decade(value: float) -> int:
    return math.floor(math.log10(value))


def ticked(low: float, high: float, most: int = 3) -> tuple[float, float]:
    """The range of an axis that holds low..high, and two of its labels where that leaves at most WASTE of it empty.

    The viewer labels powers of ten only, about 20 pixels apart at the least, `most` of them: a curve of +-0.07 has "0"
    alone on its axis; the heading tells its range.
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
    edge = 0.15 * step
    wide = float(min(low, first * step - edge)), float(max(high, last * step + edge))
    return wide if high - low >= (1.0 - WASTE) * (wide[1] - wide[0]) else (low, high)
