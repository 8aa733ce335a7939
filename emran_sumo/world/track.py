"""An open road without SUMO and without traffic: the paper's test bench."""

from collections.abc import Iterator
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.path import LaneChange, Path, lane_change_offset, path_length, point_at, shifted
from emran_sumo.units import Unit
from emran_sumo.world.records import NOBODY, Intent, Lane, Pose, Road, TakeOver, Traffic

LEAD_IN = 20.0  # m of straight road behind the start, for the rear of the car
RUN_OUT = 100.0  # m of road beyond the distance to drive, for the preview
LANE_WIDTH = 3.5  # m, for the picture
# Eq. 23 as printed: out 4.05 m, back 5.7 m
OUT, BACK = LaneChange(4.05, 27.19, 25.0), LaneChange(-5.7, 56.46, 21.95)


class TrackParams(NamedTuple):
    """Shape of the road and the speed to drive.

    shape: straight; double_lane_change (Eq. 23 as a function of x); slalom (a sine, `amplitude` and `wavelength`);
    bend (`radius` and `angle` between clothoids of length `transition`, after 40 m). `laps` repeats the shape every
    `lap` meters. speed holds until the first of speed_times, then moves linearly from one of speed_values to the next;
    a sinusoid may be added. grade_values [rad] at grade_positions [m], linear between them.
    """

    shape: Literal["straight", "double_lane_change", "slalom", "bend"] = "straight"
    laps: Annotated[int, Field(ge=1, le=1000), Unit("-")] = 1
    lap: Annotated[float, Field(gt=0, le=10_000), Unit("m")] = 140.0
    amplitude: Annotated[float, Field(ge=-20, le=20), Unit("m")] = 1.5
    wavelength: Annotated[float, Field(ge=10, le=10_000), Unit("m")] = 60.0
    radius: Annotated[float, Field(ge=5, le=10_000), Unit("m")] = 15.0
    angle: Annotated[float, Field(ge=-6.3, le=6.3), Unit("rad")] = 1.5708
    transition: Annotated[float, Field(gt=0, le=1000), Unit("m")] = 8.0
    speed: Annotated[float, Field(ge=0, le=60), Unit("m/s")] = 10.0
    speed_times: tuple[float, ...] = ()
    speed_values: tuple[float, ...] = ()
    speed_amplitude: Annotated[float, Field(ge=0, le=30), Unit("m/s")] = 0.0
    speed_frequency: Annotated[float, Field(ge=0, le=10), Unit("rad/s")] = 0.5
    grade_positions: tuple[float, ...] = ()
    grade_values: tuple[float, ...] = ()

    @property
    def maneuver(self) -> str:
        """What a car does that follows the road."""
        return "double lane change" if self.shape == "double_lane_change" else "keep lane"


def speed_reference(track: TrackParams, time: np.ndarray) -> np.ndarray:
    """Speed to drive [m/s] at times (n,) [s]."""
    held = np.full_like(time, track.speed)
    if track.speed_times:
        held = np.interp(time, track.speed_times, track.speed_values)
    return held + track.speed_amplitude * np.sin(track.speed_frequency * time)


def accel_reference(track: TrackParams, time: np.ndarray) -> np.ndarray:
    """Derivative of the speed reference [m/s2] at times (n,) [s]."""
    slope = np.zeros_like(time)
    if len(track.speed_times) > 1:
        pieces = np.diff(track.speed_values) / np.diff(track.speed_times)
        piece = np.searchsorted(track.speed_times, time, side="right") - 1
        inside = (piece >= 0) & (piece < len(pieces))
        slope[inside] = pieces[piece[inside]]
    w = track.speed_frequency
    return slope + track.speed_amplitude * w * np.cos(w * time)


def distance(track: TrackParams, duration: float) -> float:
    """Distance [m] that the speed reference covers in `duration` [s]."""
    time = np.linspace(0.0, duration, 2000)
    return float(np.trapezoid(speed_reference(track, time), time))


def track_path(track: TrackParams, duration: float) -> Path:
    """The road from LEAD_IN meters behind the start to RUN_OUT beyond what is driven in `duration` [s]."""
    spacing = 0.5 if track.shape == "straight" else 0.05
    end = max(distance(track, duration), track.lap * track.laps) + RUN_OUT
    x = np.arange(-LEAD_IN, end, spacing)
    grade = np.zeros_like(x)
    if track.grade_positions:
        grade = np.interp(x, track.grade_positions, track.grade_values)
    flat = np.zeros_like(x)
    base = Path(x, flat, flat, flat, grade, spacing)
    if track.shape == "straight":
        return base
    if track.shape == "bend":
        return _bend(track, base)
    offset = sum_of_laps(track, x)
    return shifted(base, *offset)


def sum_of_laps(track: TrackParams, x: np.ndarray) -> tuple[np.ndarray, ...]:
    """Lateral offset, slope and bend of all laps at x (n,) [m]."""
    if track.shape == "slalom":
        k = 2.0 * np.pi / track.wavelength
        on = (x >= 0.0).astype(float)
        # a quintic fade over the first half wave starts without a kink
        u = np.clip(x / (0.5 * track.wavelength), 0.0, 1.0)
        f, df, ddf = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
        g = 1.0 / (0.5 * track.wavelength)
        s, c = np.sin(k * x), np.cos(k * x)
        a = track.amplitude * on
        return a * f * s, a * (df * g * s + f * k * c), a * (ddf * g * g * s + 2 * df * g * k * c - f * k * k * s)
    total = [np.zeros_like(x) for _ in range(3)]
    for lap in range(track.laps):
        shift = lap * track.lap
        # every lap ends 1.65 m right of where it began; the next begins there
        changes = tuple(change._replace(start=change.start + shift) for change in (OUT, BACK))
        for sum_, part in zip(total, lane_change_offset(changes, x), strict=True):
            sum_ += part
    return tuple(total)


def _bend(track: TrackParams, base: Path) -> Path:
    """Straight, clothoid, arc, clothoid, straight; integrated by the midpoint rule on the fine grid."""
    peak = np.sign(track.angle) / track.radius
    arc = max(abs(track.angle) * track.radius - track.transition, 0.0)
    knots = np.cumsum([40.0, track.transition, arc, track.transition])
    position = base.x
    curvature = np.interp(position, knots, [0.0, peak, peak, 0.0])
    middle = 0.5 * (curvature[1:] + curvature[:-1])
    yaw = np.concatenate(([0.0], np.cumsum(middle * base.spacing)))
    half = 0.5 * (yaw[1:] + yaw[:-1])
    x = np.concatenate(([0.0], np.cumsum(np.cos(half)))) * base.spacing - LEAD_IN
    y = np.concatenate(([0.0], np.cumsum(np.sin(half)))) * base.spacing
    return Path(x, y, yaw, curvature, base.grade, base.spacing)


class TrackWorld:
    """The test bench in the place of SUMO: it hands over one car and asks for the speed of the profile."""

    def __init__(self, track: TrackParams, duration: float, step: float, period: float, preview: float) -> None:
        self.step = step
        self.time = 0.0
        self._track, self._path = track, track_path(track, duration)
        self._shares = np.arange(round(step / period) + 1) * period
        self._preview = preview

    def __enter__(self) -> "TrackWorld":
        return self

    def __exit__(self, *_) -> None:
        pass

    def warm_up(self, duration: float) -> Iterator[float]:
        """Nothing to settle."""
        del duration
        yield 0.0

    def take_over(self, ego: str, front: float, width: float, lane_changes: bool = True) -> TakeOver:
        """The car at the start of the road, at the speed of the profile."""
        del ego, front, width, lane_changes
        start = point_at(self._path, LEAD_IN)
        speed = float(speed_reference(self._track, np.zeros(1))[0])
        pose = Pose(start.x, start.y, start.yaw, speed, 0.0)
        return TakeOver(pose, self._path, LANE_WIDTH, 0, 0, {}, 0.0, self.length - LEAD_IN)

    def propose(self, poses: dict[str, Pose]) -> dict[str, Intent]:
        """The speed profile over the step that begins now."""
        times = self.time + self._shares
        speeds = speed_reference(self._track, times)
        accels = accel_reference(self._track, times[:-1] + self._preview)
        return {ego: Intent(float(speeds[-1]), 0, speeds, accels) for ego in poses}

    def commit(self, poses: dict[str, Pose]) -> None:
        """Time goes on."""
        del poses
        self.time = round(self.time / self.step + 1) * self.step

    def ask_for_room(self, ego: str, side: int) -> None:
        """Nobody to ask."""

    def hold(self, ego: str, side: int) -> None:
        """Nobody to keep out."""

    def changed_lane(self, ego: str) -> None:
        """Nobody wishes."""

    def lane_path(self, ego: str, side: int) -> Path | None:
        """There is no other lane."""
        del ego, side

    def arrived(self, ego: str) -> bool:
        """The road is longer than the run."""
        del ego
        return False

    def release(self, ego: str) -> None:
        """Nothing to hand back."""

    def mirror_error(self, ego: str, pose: Pose) -> float:
        """There is no copy that could differ."""
        del ego, pose
        return 0.0

    def neighbors(self, ego: str) -> Traffic:
        """Nobody."""
        del ego
        return NOBODY

    def lane_of(self, ego: str) -> str:
        """The only lane."""
        del ego
        return "track"

    def collisions(self) -> list[tuple[str, str]]:
        """None."""
        return []

    def vehicle_count(self) -> int:
        """The car alone."""
        return 1

    def road(self) -> Road:
        """A straight road under a path that swerves; the path itself where it bends."""
        line = np.column_stack((self._path.x, self._path.y, np.zeros_like(self._path.x)))[
            :: int(2.0 / self._path.spacing)
        ]
        if self._track.shape in ("straight", "double_lane_change", "slalom"):
            line = line[[0, -1]] * (1.0, 0.0, 0.0)
        offsets = (-LANE_WIDTH, 0.0, LANE_WIDTH) if len(line) == 2 else (0.0,)
        lanes = tuple(
            Lane(f"track_{i}", "track", i, len(offsets), LANE_WIDTH, line + np.array((0.0, y, 0.0)))
            for i, y in enumerate(offsets)
        )
        return Road(lanes, ())

    @property
    def length(self) -> float:
        """Length of the road [m]."""
        return path_length(self._path)

    def close(self) -> None:
        """Nothing to close."""
