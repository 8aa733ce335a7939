"""What is driven: the cases of each table, in dotted scenario keys, with what coupled-emran must reach."""

import itertools
import math
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from scipy.stats import qmc

SPEED = ("speed_error_rms", "speed_error_max")
LATERAL = ("cross_track_error_rms", "cross_track_error_max", "heading_error_rms", "heading_error_max")
ACCURACY = "coupled-emran, accuracy mode"
MAIN = "coupled-emran"
FORCES = tuple(250.0 * step for step in range(1, 61))  # N, side forces of the sweep
DRAWS, DRAW_SEED = 64, 1
Given = dict[str, Any]
Limits = tuple[float | None, ...]


class Case(NamedTuple):
    """One line of a table.

    given: dotted keys; draws: keys of each car that the case is an average over; required: row name -> largest
    allowed value of each metric, None where free; sweep: whether to look for the side force that loses the car.
    """

    name: str
    given: Given
    required: dict[str, Limits]
    draws: tuple[Given, ...] = ({},)
    sweep: bool = False


class Table(NamedTuple):
    """title; half: "lateral" or "longitudinal"; window: what the metrics are taken over; cases."""

    title: str
    half: str
    window: str
    cases: tuple[Case, ...]

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics in the order of the published cells."""
        return SPEED if self.half == "longitudinal" else LATERAL


def published() -> dict[str, Any]:
    """The published numbers as they lie in published.toml."""
    return tomllib.loads(Path(__file__).with_name("published.toml").read_text(encoding="utf-8"))


def printed_rows(table: dict[str, Any]) -> dict[str, tuple[float, ...]]:
    """Row name -> cells of one of published()["tables"]."""
    return {name: tuple(cells) for name, cells in table.items() if name not in ("compared", "quoted")}


def compared(table: dict[str, Any], aided: bool) -> tuple[float, ...]:
    """Published cells that a row is held against: the row named by `compared`, or the one without EMRAN, if printed.

    Args:
        table: one of published()["tables"].
        aided: whether the row of ours has feed-forward or networks.
    """
    rows = printed_rows(table)
    without = next((rows[name] for name in ("PID", "Stanley") if name in rows), None)
    if without and not aided:
        return without
    if table["compared"] == "best":
        return tuple(min(cells) for cells in zip(*(v for n, v in rows.items() if "EMRAN" in n), strict=True))
    return rows[table["compared"]]


def dlc(speed: float, duration: float, **disturbance: float) -> Given:
    """Eq. 23 at a constant speed [m/s]; disturbance keys without their section."""
    keys = {f"disturbance.{key}": value for key, value in disturbance.items()}
    return {
        "world": "track",
        "track.shape": "double_lane_change",
        "track.speed": speed,
        "duration": duration,
        **keys,
    }


def cruise(duration: float, speed: float = 25.0, **disturbance: float) -> Given:
    """A straight road at a constant speed [m/s]."""
    keys = {f"disturbance.{key}": value for key, value in disturbance.items()}
    return {"world": "track", "track.speed": speed, "duration": duration, **keys}


def _ramp(slope: float) -> Given:
    """28 to 25 m/s from t = 30 s at `slope` [m/s2]."""
    times, speeds = (0.0, 30.0, 30.0 + 3.0 / slope), (28.0, 28.0, 25.0)
    return {**cruise(60.0), "track.speed_times": times, "track.speed_values": speeds}


def _hill(transition: float) -> Given:
    up = math.radians(40.0)
    return cruise(55.0, grade_pulse=up, grade_return=-up, grade_transition=transition)


def _car(mass: float, inertia: float, front: float, rear: float) -> Given:
    names = ("mass_factor", "inertia_factor", "stiffness_front", "stiffness_rear")
    return {f"disturbance.{n}": float(v) for n, v in zip(names, (mass, inertia, front, rear), strict=True)}


def _corners() -> tuple[Given, ...]:
    wide, narrow = (0.8, 1.2), (0.85, 1.15)
    return tuple(_car(*factors) for factors in itertools.product(wide, wide, narrow, narrow))


def _draws() -> tuple[Given, ...]:
    """Latin-hypercube draws over the ranges of Table X."""
    points = qmc.LatinHypercube(4, rng=DRAW_SEED).random(DRAWS)
    low, high = (0.8, 0.8, 0.85, 0.85), (1.2, 1.2, 1.15, 1.15)
    return tuple(_car(*point) for point in qmc.scale(points, low, high))


def _with(given: Given, friction: float) -> Given:
    return {**given, "road.friction": friction}


FOUR_VI = (0.0218, 0.0462, 0.0089, 0.0256)
FOUR_VIII = (0.0943, 0.2968, 0.0304, 0.1168)
FOUR_XI = (0.0223, 0.0554, 0.0089, 0.0263)
CORNERS = "16 corners"
SLOW, FAST = "T = 14 s at 10 m/s", "T = 7 s at 20 m/s"
_GUST = dlc(20.0, 7.0, gust_force=1500.0)
_SINES = {"mass_amplitude": 0.15, "inertia_amplitude": 0.2, "friction_amplitude": 0.5, "wind_amplitude": 15.0}

TABLES = {
    "III": Table(
        "Cruise from 28 to 25 m/s at t = 30 s", "longitudinal", "T = 60 s",
        tuple(Case(f"ramp {slope:g} m/s2", _ramp(slope), {MAIN: (0.0017, 0.0332)}) for slope in (0.28, 1.0)),
    ),
    "IV": Table(
        "Cruise at 25 m/s over +40 and -40 degrees of grade", "longitudinal", "T = 55 s",
        tuple(Case(f"transitions {t:g} s", _hill(t), {MAIN: (0.0163, 0.0817)}) for t in (0.3, 1.0, 3.0)),
    ),
    "V": Table(
        "Cruise at 25 m/s with sinusoidal mass, inertia, friction and headwind", "longitudinal", "T = 60 s",
        (Case("all at once", cruise(60.0, **_SINES), {MAIN: (0.0076, 0.0340)}),),
    ),
    "VI": Table(
        "Double lane change at 10 m/s", "lateral", SLOW,
        (Case("nominal", dlc(10.0, 14.0), {MAIN: FOUR_VI, ACCURACY: (0.004, 0.012, None, None)}),),
    ),
    "VII": Table(
        "Double lane change at 10 m/s with a side force of 1500 N", "lateral", SLOW,
        (
            Case(
                "+1500 N", dlc(10.0, 14.0, lateral_force=1500.0),
                {MAIN: (0.025, 0.045, 0.0145, 0.0372), ACCURACY: (0.006, 0.016, None, None)},
            ),
        ),
    ),
    "VIII": Table(
        "Double lane change at 20 m/s", "lateral", FAST,
        (
            Case("friction 1.2", _with(dlc(20.0, 7.0), 1.2), {MAIN: (0.05, 0.15, *FOUR_VIII[2:])}),
            Case("friction 1.0", _with(dlc(20.0, 7.0), 1.0), {MAIN: FOUR_VIII}),
        ),
    ),
    "IX": Table(
        "Double lane change at 20 m/s with a side gust of 1.5 kN from t = 2 s on", "lateral", FAST,
        (
            Case("friction 1.2", _with(_GUST, 1.2), {MAIN: (0.15, 0.5, None, None)}, sweep=True),
            Case("friction 1.0", _with(_GUST, 1.0), {MAIN: (0.3, 1.0, None, None)}, sweep=True),
        ),
    ),
    "XI": Table(
        "Double lane change at 10 m/s, other mass, yaw inertia and cornering stiffness", "lateral", SLOW,
        tuple(
            Case(name, dlc(10.0, 14.0), {MAIN: FOUR_XI, ACCURACY: (0.006, 0.016, None, None)}, draws)
            for name, draws in ((CORNERS, _corners()), (f"{DRAWS} draws", _draws()))
        ),
    ),
    "XII": Table(
        "Double lane change at 10 m/s, against controllers of the literature", "lateral", SLOW,
        (Case("nominal", dlc(10.0, 14.0), {MAIN: FOUR_VI, ACCURACY: (0.004, 0.012, None, None)}),),
    ),
}  # fmt: skip

# Every law alone and with the network beside it
ADD_ON = {
    "add-on": Table(
        "EMRAN as an add-on: every law alone and aided", "lateral", f"{SLOW}, {FAST}",
        (
            Case("10 m/s, +1500 N", dlc(10.0, 14.0, lateral_force=1500.0), {}),
            Case(f"10 m/s, {CORNERS} of table XI", dlc(10.0, 14.0), {}, _corners()),
            Case("10 m/s, no disturbance", dlc(10.0, 14.0), {}),
            Case("20 m/s, friction 1.2", _with(dlc(20.0, 7.0), 1.2), {}),
            Case("20 m/s, friction 1.0", _with(dlc(20.0, 7.0), 1.0), {}),
        ),
    ),
}  # fmt: skip

# Chosen before any controller drove them, and never used for tuning.
_BEND = {"track.shape": "bend", "track.radius": 25.0, "track.angle": 1.5708, "track.transition": 12.0}
_SLALOM = {"track.shape": "slalom", "track.wavelength": 45.0, "track.amplitude": 1.5}
_UP_AND_DOWN = {
    "track.speed_times": (10.0, 15.0, 30.0, 36.0),
    "track.speed_values": (20.0, 24.0, 24.0, 18.0),
}
BLIND = {
    "blind": Table(
        "Cases nobody looked at before the values were frozen", "lateral", "T with each case",
        (
            Case("DLC 12 m/s, friction 0.85, 12 s", _with(dlc(12.0, 12.0), 0.85), {}),
            Case("DLC 17 m/s, friction 0.9, 8.5 s", _with(dlc(17.0, 8.5), 0.9), {}),
            Case("DLC 14 m/s, steering 15 % weak, 10 s", dlc(14.0, 10.0, steer_effectiveness=0.85), {}),
            Case(
                "DLC 11 m/s, stiffness +-20 % at 2 rad/s, 13 s",
                dlc(11.0, 13.0, stiffness_amplitude=0.2, stiffness_frequency=2.0), {},
            ),
            Case(
                "DLC 13 m/s, friction 0.6 from 60 to 100 m, inertia 0.8, 11 s",
                dlc(13.0, 11.0, patch_start=80.0, patch_end=120.0, patch_friction=0.6, inertia_factor=0.8), {},
            ),
            Case("slalom 45 m, 12 m/s, +900 N, 20 s", {**cruise(20.0, 12.0, lateral_force=900.0), **_SLALOM}, {}),
            Case("bend R 25 m, 9 m/s, mass 1.15, 14 s", {**cruise(14.0, 9.0, mass_factor=1.15), **_BEND}, {}),
        ),
    ),
    "blind cruise": Table(
        "Cases nobody looked at before the values were frozen", "longitudinal", "T with each case",
        (
            Case(
                "20-24-18 m/s, -8 degrees, headwind +-10 m/s, 60 s",
                {**cruise(60.0, grade_pulse=math.radians(-8.0), grade_transition=2.0, wind_amplitude=10.0),
                 **_UP_AND_DOWN}, {},
            ),
        ),
    ),
}  # fmt: skip
