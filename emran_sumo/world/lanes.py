"""From a chain of lanes to a smooth path that a car can follow."""

import math

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.linalg import solveh_banded
from scipy.ndimage import maximum_filter1d

from emran_sumo.path import Path, first_near, nearest, point_at, shifted, wrap
from emran_sumo.world.drivable import drivable
from emran_sumo.world.records import Pose

SPACING = 0.25  # m between points of a path
SAMPLING = 1.0  # m between the points that are smoothed
# third differences are penalized so that waves shorter than this are noise of the lane's polyline
SHORTEST_WAVE = 60.0  # m
LANE_TOLERANCE = 0.25  # m beside the center line of a lane
JUNCTION_TOLERANCE = 0.6  # m inside junctions
KINK = 0.6  # rad within 4 m: sharper than any lane is driven
TIGHTEST = 6.0  # m, radius that a car can turn
MOST = 1.0 / 4.5  # 1/m that a car of 5 m can steer, with some to spare
ROUNDS = 20
SHIFT_TURN = 0.35  # rad between two lanes that go on in the same direction
SHIFT_ACCEL = 2.0  # m/s2 across, of a lane that goes on beside its end
BESIDE_PATH, TURNED = 0.3, 0.1  # m, rad, beside the path and against it from where a vehicle is led to it
BEHIND = 10.0  # m of path behind a car that stands before the begin of its lane
WAY_IN_ACCEL, LEAST_WAY_IN = 1.5, 8.0  # m/s2 across, m
SHIFT_LEAST, SHIFT_MOST = 0.4, 4.0  # m


def joined(shapes: list[np.ndarray], tolerances: list[float] | None = None) -> np.ndarray:
    """One polyline (n, 4) of x, y, z [m] and tolerance [m] from the center lines of successive lanes.

    tolerances: how far the path may leave each lane's center line; LANE_TOLERANCE where not given. Points that repeat
    the one before are left out.
    """
    given = tolerances or [LANE_TOLERANCE] * len(shapes)
    points = np.vstack(
        [np.column_stack((shape, np.full(len(shape), t))) for shape, t in zip(shapes, given, strict=True)]
    )
    distance = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return points[np.concatenate(([True], distance > 0.01))]


def dense(shape: np.ndarray) -> np.ndarray:
    """The polyline with further points, no more than 2 m apart."""
    steps = np.hypot(*np.diff(shape[:, :2], axis=0).T)
    parts = np.maximum(np.ceil(steps / 2.0), 1).astype(int)
    index = np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(parts))])
    return np.column_stack([np.interp(index, np.arange(len(shape)), column) for column in shape.T])


def shift_between(before: np.ndarray, after: np.ndarray) -> float:
    """Lateral distance [m], left positive, between the end of one lane and the start of the lane that follows it
    behind a junction; 0 where the road turns there."""
    out, on = before[-1, :2] - before[-2, :2], after[1, :2] - after[0, :2]
    turn = abs(float(wrap(np.arctan2(on[1], on[0]) - np.arctan2(out[1], out[0]))))
    if turn > SHIFT_TURN:
        return 0.0
    middle = out / max(np.hypot(*out), 1e-9) + on / max(np.hypot(*on), 1e-9)
    across = np.array([-middle[1], middle[0]]) / np.hypot(*middle)
    return float(across @ (after[0, :2] - before[-1, :2]))


def _shift_length(height: float, accel: float, speed: float) -> float:
    """Length [m] of a lateral move by `height` [m] at `speed` [m/s] with at most `accel` [m/s2] across.

    A quintic of length L and height h has the curvature 5.77 h / L^2 at the most.
    """
    return math.sqrt(5.77 * height / accel) * speed


def loosened(points: np.ndarray, place: np.ndarray, shift: float, speed: float) -> np.ndarray:
    """The points (n, 4) with as much tolerance around `place` [m] as a lateral `shift` [m] needs at `speed` [m/s].

    A lane that goes on a lane's width beside its end is drawn by the network as a kink: here it is moved to like a lane
    change.
    """
    length = _shift_length(abs(shift), SHIFT_ACCEL, speed)
    distance = np.hypot(*(points[:, :2] - place).T)
    out = points.copy()
    near = distance < 0.5 * max(length, 10.0)
    out[near, 3] = np.maximum(out[near, 3], min(abs(shift), SHIFT_MOST))
    return out


def smooth_path(points: np.ndarray) -> Path:
    """Path along a polyline (n, 4) of x, y, z and tolerance [m], without the corners of its vertices.

    The polyline is sampled every meter; the smoothed points p minimize

        sum w |p - q|^2 + lambda sum |third difference of p|^2,   lambda = (SHORTEST_WAVE / 2 pi)^6

    with w = 1 where that stays within the tolerance. Where it would not (real turns), w grows until it does.
    """
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))))
    count = max(int(along[-1] / SAMPLING) + 1, 8)
    grid = np.linspace(0.0, along[-1], count)
    raw = np.column_stack([np.interp(grid, along, points[:, k]) for k in range(3)])
    tolerance = np.maximum(np.interp(grid, along, points[:, 3]), _room_for_kinks(raw))
    stiffness = (SHORTEST_WAVE / (2.0 * np.pi * grid[1])) ** 6
    # where much is allowed, waves are smoothed that are longer in proportion
    weight = np.minimum((JUNCTION_TOLERANCE / np.interp(grid, along, points[:, 3])) ** 3, 1.0)
    smooth = raw
    for _ in range(ROUNDS):
        smooth = _smooth(raw, weight, stiffness)
        excess = np.hypot(*(smooth - raw)[:, :2].T) / tolerance
        if excess.max() <= 1.0:
            break
        # neighbors too: a single stiff point would only move the bulge
        weight *= np.clip(maximum_filter1d(excess, 7), 1.0, 10.0) ** 2
    curve = make_interp_spline(grid, smooth, k=5)
    path, places = _by_arc_length(curve, along[-1])
    return drivable(path, MOST, np.interp(places, grid, np.interp(grid, along, points[:, 3])))


def _room_for_kinks(points: np.ndarray) -> np.ndarray:
    """Tolerance (n,) [m] that a turn of TIGHTEST needs where the line turns by more than KINK within 4 m."""
    along = np.diff(points[:, :2], axis=0)
    heading = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
    turn = np.zeros(len(points))
    turn[3:-3] = np.abs(heading[5:] - heading[:-5])
    turn = np.where(turn > KINK, np.minimum(turn, 2.2), 0.0)
    return maximum_filter1d(TIGHTEST * (1.0 / np.cos(0.5 * turn) - 1.0), 2 * int(TIGHTEST / SAMPLING) + 1)


def _smooth(points: np.ndarray, weight: np.ndarray, stiffness: float) -> np.ndarray:
    n = len(points)
    difference = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for offset in range(4):
        for i in range(4 - offset):
            # row j of the difference matrix touches columns j .. j + 3
            bands[offset, i : i + n - 3] += stiffness * difference[i] * difference[i + offset]
    bands[0] += weight
    return solveh_banded(bands, weight[:, None] * points, lower=True)


def speed_cap(path: Path, accel_lat: float, decel: float) -> np.ndarray:
    """Highest speed (n,) [m/s] along a path that keeps the lateral acceleration and can be braked down to.

    accel_lat [m/s2] in bends; decel [m/s2] before them.
    """
    cap = np.sqrt(accel_lat / np.maximum(np.abs(path.curvature), 1e-6))
    squared = cap**2
    step = 2.0 * decel * path.spacing
    # v^2 may fall by `step` from point to point: a running minimum of v^2 plus the distance already spent
    index = np.arange(squared.size)
    return np.sqrt(np.minimum.accumulate((squared + step * index)[::-1])[::-1] - step * index)


def blended(target: Path, path: Path, position: float, target_position: float, length: float) -> Path:
    """The target path, reached from `path` by a quintic lateral move without a kink.

    At `position` on `path` (`target_position` on the target) the result agrees with `path` in place, direction and
    curvature; `length` [m] later it is on the target.
    """
    here, there = point_at(path, position), point_at(target, target_position)
    d0 = -(here.x - there.x) * np.sin(there.yaw) + (here.y - there.y) * np.cos(there.yaw)
    turn = float(np.clip(wrap(here.yaw - there.yaw), -1.0, 1.0))
    scale = 1.0 - there.curvature * d0
    d1 = scale * np.tan(turn)
    d2 = (here.curvature * scale / np.cos(turn) - there.curvature) * scale / np.cos(turn) ** 2
    u = (np.arange(target.x.size) * target.spacing - target_position) / length
    offset, slope, bend = _quintic(np.clip(u, 0.0, 1.0), d0, d1 * length, d2 * length**2)
    behind, ahead = u < 0.0, u > 1.0
    # behind the car the move goes on straight for a car's length; nobody drives there
    back = np.maximum(u[behind] * length, -10.0)
    offset[behind], slope[behind], bend[behind] = d0 + d1 * back, d1 * length, 0.0
    offset[ahead] = slope[ahead] = bend[ahead] = 0.0
    return shifted(target, offset, slope / length, bend / length**2)


def way_in(path: Path, pose: Pose, guess: float) -> Path:
    """The path, reached by a lateral move where SUMO has the vehicle beside it, as where lanes do not meet."""
    here = nearest(path, pose.x, pose.y, guess)
    beside = math.hypot(here.x - pose.x, here.y - pose.y)
    if beside < BESIDE_PATH and abs(float(wrap(here.yaw - pose.yaw))) < TURNED:
        return path
    length = max(_shift_length(beside, WAY_IN_ACCEL, pose.speed), LEAST_WAY_IN)
    return steered(reached(path, pose.x, pose.y, pose.yaw, here.position, length), pose.x, pose.y, pose.yaw)


def with_begin(path: Path, x: float, y: float) -> Path:
    """The path, led back straight on where a car at (x, y) [m] is behind its begin: a lane has nothing before it that
    leads there, and SUMO puts a front bumper on its first meters."""
    behind = (path.x[0] - x) * math.cos(path.yaw[0]) + (path.y[0] - y) * math.sin(path.yaw[0])
    if not 0.0 < behind < BEHIND or math.hypot(path.x[0] - x, path.y[0] - y) > BEHIND:
        return path
    back = -path.spacing * np.arange(int((behind + BEHIND) / path.spacing), 0, -1)
    before = (path.x[0] + back * math.cos(path.yaw[0]), path.y[0] + back * math.sin(path.yaw[0]))
    flat = np.zeros_like(back)
    columns = (*before, flat + path.yaw[0], flat, flat + path.grade[0])
    return Path._make([*(np.concatenate(pair) for pair in zip(columns, path[:5], strict=True)), path.spacing])


def steered(path: Path, x: float, y: float, yaw: float) -> Path:
    """The path without what a car cannot steer that is at (x, y) [m] on it, with `yaw` [rad]."""
    return drivable(path, MOST, begin=int(first_near(path, x, y, yaw) / path.spacing))


def reached(path: Path, x: float, y: float, yaw: float, position: float, length: float) -> Path:
    """The path reached within `length` [m] by a car that is at (x, y) [m] with `yaw` [rad], beside `position` on it."""
    ahead, flat = np.arange(3) * SPACING, np.zeros(3)
    straight = Path(x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), flat + yaw, flat, flat, SPACING)
    return blended(path, straight, 0.0, position, length)


def _quintic(u: np.ndarray, p0: float, v0: float, a0: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Quintic of u in [0, 1] from (p0, v0, a0) to rest at 0, with first and second derivative."""
    c3 = -10.0 * p0 - 6.0 * v0 - 1.5 * a0
    c4 = 15.0 * p0 + 8.0 * v0 + 1.5 * a0
    c5 = -6.0 * p0 - 3.0 * v0 - 0.5 * a0
    p = np.polynomial.Polynomial([p0, v0, 0.5 * a0, c3, c4, c5])
    return p(u), p.deriv()(u), p.deriv(2)(u)


def _by_arc_length(curve, end: float) -> tuple[Path, np.ndarray]:
    """A path along a curve of u in [0, end], and u at its points."""
    u = np.linspace(0.0, end, int(end / SPACING) * 4 + 1)
    first = curve(u, 1)
    stretch = np.hypot(first[:, 0], first[:, 1])
    length = np.concatenate(([0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * np.diff(u))))
    grid = np.arange(0.0, length[-1], SPACING)
    at = CubicSpline(length, u)(grid)
    p, d1, d2 = curve(at), curve(at, 1), curve(at, 2)
    speed = np.hypot(d1[:, 0], d1[:, 1])
    curvature = (d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / speed**3
    yaw = np.unwrap(np.arctan2(d1[:, 1], d1[:, 0]))
    grade = np.arctan(d1[:, 2] / speed)
    return Path(p[:, 0].copy(), p[:, 1].copy(), yaw, curvature, grade, SPACING), at
