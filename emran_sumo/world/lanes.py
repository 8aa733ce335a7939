"""From a chain of lanes to a smooth path that a car can follow."""

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.linalg import solveh_banded

from emran_sumo.path import Path

SPACING = 0.25  # m between points of a path
SAMPLING = 1.0  # m between the points that are smoothed
# third differences are penalized so that waves shorter than this are noise of the lane's polyline
SHORTEST_WAVE = 60.0  # m


def joined(shapes: list[np.ndarray]) -> np.ndarray:
    """One polyline (n, 3) from the center lines of successive lanes, without repeated points."""
    points = np.vstack(shapes)
    distance = np.hypot(*np.diff(points[:, :2], axis=0).T)
    return points[np.concatenate(([True], distance > 0.01))]


def smooth_path(points: np.ndarray) -> Path:
    """Path along a polyline (n, 3) [m], without the corners of its vertices.

    The polyline is sampled every meter; the smoothed points p minimize

        sum |p - q|^2 + lambda sum |third difference of p|^2,   lambda = (SHORTEST_WAVE / 2 pi)^6

    so that curves keep their shape and the curvature is smooth enough to be driven.
    """
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))))
    count = max(int(along[-1] / SAMPLING) + 1, 8)
    grid = np.linspace(0.0, along[-1], count)
    raw = np.column_stack([np.interp(grid, along, points[:, k]) for k in range(points.shape[1])])
    smooth = _smooth(raw, (SHORTEST_WAVE / (2.0 * np.pi * grid[1])) ** 6)
    curve = make_interp_spline(grid, smooth, k=5)
    return _by_arc_length(curve, along[-1])


def _smooth(points: np.ndarray, weight: float) -> np.ndarray:
    n = len(points)
    difference = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for offset in range(4):
        for i in range(4 - offset):
            # row j of the difference matrix touches columns j .. j + 3
            product = difference[i] * difference[i + offset]
            bands[offset, i : i + n - 3] += weight * product
    bands[0] += 1.0
    return solveh_banded(bands, points, lower=True)


def _by_arc_length(curve, end: float) -> Path:
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
    return Path(p[:, 0].copy(), p[:, 1].copy(), yaw, curvature, grade, SPACING)
