"""Corners sharper than a car can steer, widened as little as the car needs."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from emran_sumo.path import Path, hermite
from emran_sumo.world.squares import normal_equations, solved

AROUND = 20.0  # m on both sides of a corner in which the path may leave the lane for it
TOGETHER = 24.0  # m between corners that are widened as one
STEERING = 0.07  # 1/m2: how fast the curvature may change; 0.8 rad/s of steering at 4 m/s
LEAST = 0.25  # m: with less tolerance no point of the way holds the path
SPARE = 0.98  # of the curvature that may be, to which the corner is widened
COARSE = 2  # points of the path to one of the search
BEND_WEIGHT, END_WEIGHT, CALM_WEIGHT, HARD = 300.0, 1e3, 4.0, 10.0
SEARCH = 6.0  # m along the path in which the nearest point is looked for
ROUNDS = 80
DAMPING_LEAST, DAMPING_MOST = 1e-9, 1e9
GAIN = 1e-4  # relative, below which a round is the last


def drivable(path: Path, most: float, tolerance: np.ndarray | None = None, begin: int = 0) -> Path:
    """The path with no more curvature than `most` [1/m] from its point `begin` on, wherever that is possible.

    tolerance: how far the path may leave its way, (n,) [m]; the same everywhere where not given. A path that bends
    less is returned as it is.
    """
    sharp = begin + np.flatnonzero(np.abs(path.curvature[begin:]) > most)
    if not sharp.size:
        return path
    room = np.ones(path.x.size) if tolerance is None else np.maximum(tolerance, LEAST)
    apart = np.flatnonzero(np.diff(sharp) > TOGETHER / path.spacing) + 1
    # from the last to the first: what is replaced moves nothing before it
    for corner in reversed(np.split(sharp, apart)):
        margin = int(AROUND / path.spacing)
        first, last = max(corner[0] - margin, begin), min(corner[-1] + margin, path.x.size - 1)
        last -= (last - first) % COARSE
        path, room = _replaced(path, room, first, last, _Corner(path, room, first, last, most).widened())
    return path


class _Normal(NamedTuple):
    """A sum of squares, and the normal equations of its Gauss-Newton step: matrix (n, n) and gradient (n,)."""

    cost: float
    matrix: np.ndarray
    downhill: np.ndarray


class _Corner:
    """A stretch of a path, every COARSE-th point from `first` to `last`, and the way that a car can drive instead.

    The unknowns are the curvature at its `count` + 1 places and the length of the way; it ends where the stretch does.
    Minimized are the squares of the distance to the path, in tolerances, and of the steering, with the bounds as
    penalties (Levenberg-Marquardt).
    """

    def __init__(self, path: Path, room: np.ndarray, first: int, last: int, most: float) -> None:
        own = slice(first, last + 1, COARSE)
        self._x, self._y, self._yaw, self._curvature = (v[own] for v in (path.x, path.y, path.yaw, path.curvature))
        self._room, self._most, self._spacing = room[own], most, path.spacing * COARSE
        self._count = self._x.size - 1

    def widened(self) -> tuple[np.ndarray, float]:
        """Columns x, y, yaw, curvature of the way (n, 4), and its length [m]."""
        at = np.append(self._spread(), self._count * self._spacing)
        damping, now = 1e-2, self._weighed(at)
        for _ in range(ROUNDS):
            scale = np.diag(np.diag(now.matrix) + 1e-9)
            while damping < DAMPING_MOST:
                step = solved(now.matrix + damping * scale, now.downhill)
                tried = self._weighed(at - step)
                if tried.cost < now.cost:
                    break
                damping *= 4.0
            else:
                break
            gain, at, now = 1.0 - tried.cost / now.cost, at - step, tried
            damping = max(0.3 * damping, DAMPING_LEAST)
            if gain < GAIN:
                break
        return np.column_stack((*self._driven(at), at[:-1])), float(at[-1])

    def _spread(self) -> np.ndarray:
        """Curvature (n,) with the same turn in all, spread until it is within the bounds."""
        for width in range(1, self._count, 2):
            spread = uniform_filter1d(self._curvature, width, mode="nearest")
            if np.abs(spread).max() <= self._most:
                return spread
        return np.clip(self._curvature, -self._most, self._most)

    def _driven(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x, y [m] and yaw [rad] of a car that steers so."""
        curvature, step = at[:-1], at[-1] / self._count
        turn = 0.5 * (curvature[1:] + curvature[:-1]) * step
        yaw = self._yaw[0] + np.concatenate(([0.0], np.cumsum(turn)))
        chord, middle = step * (1.0 - turn**2 / 24.0), 0.5 * (yaw[1:] + yaw[:-1])
        x = self._x[0] + np.concatenate(([0.0], np.cumsum(chord * np.cos(middle))))
        y = self._y[0] + np.concatenate(([0.0], np.cumsum(chord * np.sin(middle))))
        return x, y, yaw

    def _weighed(self, at: np.ndarray) -> _Normal:
        """How good a way is, and where it gets better."""
        x, y, yaw = self._driven(at)
        dx, dy, dyaw = self._slopes(at, x, y, yaw)
        beside, east, north, room = self._beside(x, y)
        weight = np.sqrt(self._spacing) / room
        ends = (x[-1] - self._x[-1], y[-1] - self._y[-1], yaw[-1] - self._yaw[-1])
        residuals = np.concatenate((weight * beside, END_WEIGHT * np.array(ends)))
        slopes = (weight * east)[:, None] * dx + (weight * north)[:, None] * dy
        slopes = np.vstack((slopes, END_WEIGHT * dx[-1], END_WEIGHT * dy[-1], END_WEIGHT * dyaw))
        matrix, downhill = normal_equations(slopes, residuals)
        return _Normal(float((residuals * residuals).sum()) + self._steering(at, matrix, downhill), matrix, downhill)

    def _slopes(self, at: np.ndarray, x: np.ndarray, y: np.ndarray, yaw: np.ndarray) -> tuple[np.ndarray, ...]:
        """How x and y of all places (n, n + 1), and the yaw of the last, change with the unknowns."""
        count, length = self._count, float(at[-1])
        step = length / count
        # who steers at a place turns all behind it around that place
        behind = np.tri(count + 1, k=-1) * step
        behind[:, 0] *= 0.5
        turned = (yaw - yaw[0]) / length
        share = np.full(count + 1, 1.0 / count)
        share[0] = 0.0
        longer_x = np.cumsum(share * (np.cos(yaw) - length * np.sin(yaw) * turned))
        longer_y = np.cumsum(share * (np.sin(yaw) + length * np.cos(yaw) * turned))
        dx = np.column_stack(((y[None] - y[:, None]) * behind, longer_x))
        dy = np.column_stack(((x[:, None] - x[None]) * behind, longer_y))
        dyaw = np.append(behind[-1], turned[-1])
        dyaw[count] = 0.5 * step
        return dx, dy, dyaw

    def _steering(self, at: np.ndarray, matrix: np.ndarray, downhill: np.ndarray) -> float:
        """What the steering costs; adds its part to the normal equations. They are sparse here."""
        curvature, step = at[:-1], at[-1] / self._count
        n, scale = curvature.size, np.sqrt(self._spacing)
        rate = np.diff(curvature) / step
        fast = np.abs(rate) > STEERING
        weight = np.where(fast, HARD, 1.0) * CALM_WEIGHT * scale
        off = weight * (rate - np.where(fast, 0.99 * STEERING * np.sign(rate), 0.0))
        slope = weight / step
        bound = SPARE * self._most
        over = np.sign(curvature) * np.maximum(np.abs(curvature) - bound, 0.0)
        # the curvature goes on where the stretch is joined
        ends = END_WEIGHT * (curvature[[0, -1]] - np.clip(self._curvature[[0, -1]], -bound, bound))

        main = np.where(over != 0.0, (BEND_WEIGHT * scale) ** 2, 0.0)
        main[1:] += slope**2
        main[:-1] += slope**2
        main[[0, -1]] += END_WEIGHT**2
        index = np.arange(n)
        matrix[index, index] += main
        matrix[index[1:], index[:-1]] -= slope**2
        matrix[index[:-1], index[1:]] -= slope**2
        downhill[:n] += (BEND_WEIGHT * scale) ** 2 * over
        downhill[1:n] += slope * off
        downhill[: n - 1] -= slope * off
        downhill[[0, n - 1]] += END_WEIGHT * ends
        return float((off**2).sum() + (BEND_WEIGHT * scale) ** 2 * (over**2).sum() + (ends**2).sum())

    def _beside(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Distance to the path (n,) [m], direction of that (east, north), and the tolerance there."""
        index = np.arange(self._count + 1)
        squared = (x[:, None] - self._x[None]) ** 2 + (y[:, None] - self._y[None]) ** 2
        far = np.abs(index[:, None] - index[None]) > SEARCH / self._spacing
        k = np.argmin(np.where(far, np.inf, squared), axis=1)
        dx, dy = x - self._x[k], y - self._y[k]
        # between the path's points the foot lies along its direction
        along = np.clip(dx * np.cos(self._yaw[k]) + dy * np.sin(self._yaw[k]), -self._spacing, self._spacing)
        dx, dy = dx - along * np.cos(self._yaw[k]), dy - along * np.sin(self._yaw[k])
        distance = np.hypot(dx, dy)
        near = distance < 1e-6
        east = np.where(near, -np.sin(self._yaw[k]), dx / np.maximum(distance, 1e-6))
        north = np.where(near, np.cos(self._yaw[k]), dy / np.maximum(distance, 1e-6))
        return distance, east, north, self._room[k]


def _replaced(
    path: Path, room: np.ndarray, first: int, last: int, way: tuple[np.ndarray, float]
) -> tuple[Path, np.ndarray]:
    """The path with the way in place of the points from `first` to `last`; and the tolerance along it."""
    columns, length = way
    own = np.column_stack((path.x, path.y, path.yaw, path.curvature))
    spacing = path.spacing
    along = np.linspace(0.0, length, len(columns)) + first * spacing
    knots = np.concatenate((np.arange(first) * spacing, along, along[-1] + np.arange(1, len(own) - last) * spacing))
    before = np.concatenate((np.arange(first), np.linspace(first, last, len(columns)), np.arange(last + 1, len(own))))
    x, y, yaw, curvature = np.vstack((own[:first], columns, own[last + 1 :])).T
    grid = np.arange(0.0, knots[-1] + 1e-9, spacing)
    places = np.interp(grid, knots, before)
    new = Path(
        hermite(grid, knots, x, np.cos(yaw)),
        hermite(grid, knots, y, np.sin(yaw)),
        hermite(grid, knots, yaw, curvature),
        np.interp(grid, knots, curvature),
        np.interp(places, np.arange(len(own)), path.grade),
        spacing,
    )
    return new, np.interp(places, np.arange(len(own)), room)
