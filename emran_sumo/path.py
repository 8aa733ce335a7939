"""A reference path sampled by arc length: nearest point, tracking errors, and the double lane change of Eq. 23."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo.kernels import njit

NEAREST_ITERATIONS = 4
FIRST_WITHIN = 1.0  # m


class Path(NamedTuple):
    """A path on a uniform arc-length grid; every array has shape (n,).

    x, y [m], yaw [rad] (continuous, not wrapped), curvature [1/m] (positive turns left), grade [rad] (positive
    uphill), spacing [m] between points.
    """

    x: np.ndarray
    y: np.ndarray
    yaw: np.ndarray
    curvature: np.ndarray
    grade: np.ndarray
    spacing: float


class Point(NamedTuple):
    """A point on a path: position along it [m], coordinates [m], yaw [rad], curvature [1/m]."""

    position: float
    x: float
    y: float
    yaw: float
    curvature: float


@njit
def wrap(angle):
    """Angle [rad] folded into [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit
def path_length(path):
    """Length [m] of the path."""
    return (path.x.size - 1) * path.spacing


@njit
def _cell(path, position):
    """Grid index and fraction of `position`, held inside the path."""
    u = min(max(position / path.spacing, 0.0), path.x.size - 1.000001)
    i = int(u)
    return i, u - i


@njit
def interpolate(values, path, position):
    """Linear interpolation of `values` (n,) of the grid at `position` [m], held at both ends."""
    i, f = _cell(path, position)
    return values[i] + f * (values[i + 1] - values[i])


@njit
def mean_curvature(path, position, half_width):
    """Curvature [1/m] averaged over position +- half_width [m] with five points."""
    total = 0.0
    for k in range(5):
        total += interpolate(path.curvature, path, position + (k - 2) * 0.5 * half_width)
    return total / 5.0


@njit
def point_at(path, position):
    """Point at `position` [m]: cubic Hermite in x and y, so that 0.25 m spacing is exact to micrometers.

    Beyond the ends the coordinates are those of the end; the position is returned as given.
    """
    i, f = _cell(path, position)
    h = path.spacing
    a = (1.0 + 2.0 * f) * (1.0 - f) * (1.0 - f)
    b = f * (1.0 - f) * (1.0 - f) * h
    c = f * f * (3.0 - 2.0 * f)
    d = f * f * (f - 1.0) * h
    x0, x1, y0, y1 = path.x[i], path.x[i + 1], path.y[i], path.y[i + 1]
    yaw0, yaw1 = path.yaw[i], path.yaw[i + 1]
    x = a * x0 + b * math.cos(yaw0) + c * x1 + d * math.cos(yaw1)
    y = a * y0 + b * math.sin(yaw0) + c * y1 + d * math.sin(yaw1)
    k0, k1 = path.curvature[i], path.curvature[i + 1]
    # integral of the linear curvature, with its closing error spread over the cell
    bend = h * f * (k0 + 0.5 * f * (k1 - k0))
    close = yaw1 - yaw0 - 0.5 * h * (k0 + k1)
    return Point(position, x, y, yaw0 + bend + f * close, k0 + f * (k1 - k0))


@njit
def nearest(path, x, y, hint):
    """The point of the path nearest to (x, y) [m], searched from `hint` [m] by Newton steps along the tangent.

    The hint is the last position: the search finds the branch the vehicle is on, even where a path crosses itself.
    Positions outside the path are held at its ends.
    """
    position = hint
    end = path_length(path)
    for _ in range(NEAREST_ITERATIONS):
        p = point_at(path, position)
        dx, dy = x - p.x, y - p.y
        along = dx * math.cos(p.yaw) + dy * math.sin(p.yaw)
        across = -dx * math.sin(p.yaw) + dy * math.cos(p.yaw)
        slope = max(1.0 - p.curvature * across, 0.2)  # beyond the center of curvature there is no nearest point
        position = min(max(position + along / slope, 0.0), end)
    return point_at(path, position)


@njit
def tracking_errors(point, x, y, yaw):
    """Cross-track error [m], positive when the path lies to the left, and heading error [rad], path minus vehicle."""
    cross_track = -((x - point.x) * -math.sin(point.yaw) + (y - point.y) * math.cos(point.yaw))
    return cross_track, wrap(point.yaw - yaw)


def first_near(path: Path, x: float, y: float, yaw: float) -> float:
    """Position [m] of the point nearest to (x, y) [m] the first time that the path passes there the way of `yaw`.

    A path that comes back to where it was is on its first round: it begins at the car.
    """
    squared = (path.x - x) ** 2 + (path.y - y) ** 2
    along = np.where(np.cos(path.yaw - yaw) > 0.0, squared, np.inf)
    if np.isfinite(along).any():
        squared = along
    near = np.flatnonzero(np.sqrt(squared) < math.sqrt(squared.min()) + FIRST_WITHIN)
    others = np.flatnonzero(np.diff(near) > 1)
    first = near[: others[0] + 1] if others.size else near
    return float(first[np.argmin(squared[first])]) * path.spacing


def path_from_points(x: np.ndarray, y: np.ndarray, grade: np.ndarray | float = 0.0) -> Path:
    """Path through points (n,) that already lie on a smooth curve at nearly uniform distances.

    Yaw and curvature follow from central differences; the spacing is the mean distance.
    """
    dx, dy = np.gradient(x, edge_order=2), np.gradient(y, edge_order=2)
    yaw = np.unwrap(np.arctan2(dy, dx))
    spacing = float(np.hypot(np.diff(x), np.diff(y)).mean())
    curvature = np.gradient(yaw, spacing, edge_order=2)
    return Path(x.copy(), y.copy(), yaw, curvature, np.broadcast_to(grade, x.shape).astype(float).copy(), spacing)


def shifted(base: Path, offset: np.ndarray, offset_slope: np.ndarray, offset_bend: np.ndarray) -> Path:
    """The path at a lateral `offset` [m] (left positive) from `base`, given with its derivatives along the base.

    offset, offset_slope d'(s) [-] and offset_bend d''(s) [1/m] have shape (n,). Resampled to the spacing of the base;
    positions of the result differ from those of the base by the extra length of the offset curve.
    """
    k = base.curvature
    stretch_along = 1.0 - k * offset
    stretch = np.hypot(stretch_along, offset_slope)
    turn = np.arctan2(offset_slope, stretch_along)
    x = base.x - offset * np.sin(base.yaw)
    y = base.y + offset * np.cos(base.yaw)
    yaw = base.yaw + turn
    dk = np.gradient(k, base.spacing, edge_order=2)
    # derivative of the turn angle along the base, then per unit of its own length
    turn_rate = (offset_bend * stretch_along + offset_slope * (dk * offset + k * offset_slope)) / stretch**2
    curvature = (k + turn_rate) / stretch
    length = np.concatenate(([0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * base.spacing)))
    grid = np.arange(0.0, length[-1] + 1e-9, base.spacing)

    def resample(values: np.ndarray) -> np.ndarray:
        return np.interp(grid, length, values)

    if np.allclose(stretch, 1.0, atol=1e-12):
        return Path(x, y, yaw, curvature, base.grade, base.spacing)
    return Path(
        hermite(grid, length, x, np.cos(yaw)),
        hermite(grid, length, y, np.sin(yaw)),
        hermite(grid, length, yaw, curvature),
        resample(curvature),
        resample(base.grade),
        base.spacing,
    )


def hermite(grid: np.ndarray, knots: np.ndarray, values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Values (m,) at `grid` of the cubics through `values` (n,) at `knots` (n,), with those slopes."""
    from scipy.interpolate import CubicHermiteSpline

    return CubicHermiteSpline(knots, values, slopes)(grid)


class LaneChange(NamedTuple):
    """One transition of a double lane change: the tanh step of Eq. 23 as a function of position along the path.

        y(s) = height / 2 (1 + tanh(z)),   z = 2.4 (s - start) / length - 1.2                          (23)

    height [m], left positive; start [m]; length [m].
    """

    height: float
    start: float
    length: float


def lane_change_offset(changes: tuple[LaneChange, ...], position: np.ndarray) -> tuple[np.ndarray, ...]:
    """Offset [m], its slope [-] and its bend [1/m] of the sum of `changes` at `position` (n,) [m].  Eq. 23."""
    offset, slope, bend = (np.zeros_like(position) for _ in range(3))
    for change in changes:
        g = 2.4 / change.length
        z = g * (position - change.start) - 1.2
        t = np.tanh(z)
        sech2 = 1.0 - t * t
        offset += 0.5 * change.height * (1.0 + t)
        slope += 0.5 * change.height * g * sech2
        bend += -change.height * g * g * t * sech2
    return offset, slope, bend


@njit
def project(path, x, y, hint, reach):
    """Positions [m] along the path, lateral offsets [m], left positive, and yaw of the path [rad] at points x, y (n,).

    `hint` [m] is a position near which the points lie, within `reach` [m]; coarse steps of 5 m find the start. (n, 3).
    """
    out = np.empty((x.size, 3))
    for i in range(x.size):
        best, best_d2 = hint, np.inf
        position = hint - reach
        while position <= hint + reach:
            j, _ = _cell(path, position)
            d2 = (x[i] - path.x[j]) ** 2 + (y[i] - path.y[j]) ** 2
            if d2 < best_d2:
                best, best_d2 = position, d2
            position += 5.0
        p = nearest(path, x[i], y[i], best)
        out[i, 0] = p.position
        out[i, 1] = -(x[i] - p.x) * math.sin(p.yaw) + (y[i] - p.y) * math.cos(p.yaw)
        out[i, 2] = p.yaw
    return out
