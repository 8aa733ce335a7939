"""A loop that a car can drive where the network turns back within a lane's width."""

import math

import numpy as np

from emran_sumo.path import wrap

RADIUS = 5.5  # m, of a car with some steering left
TURN = 2.6  # rad between two lanes from which on a junction turns back
BEFORE = 4.0  # m of the lanes on both sides of the junction that the loop uses
SAMPLING = 0.5  # m between its points


def turned(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The end of one lane, a loop and the start of the lane that leads back, or None where the turn is wide enough.

    A turn of 180 degrees between lanes w apart has the radius w / 2, in SUMO 1 to 2 m. Here the car swings out to the
    other side first and comes back: three arcs of radius r that touch, around a, m and b with |m - a| = |m - b| = 2 r
    (the shape C C C of Dubins, 1957).

    Args:
        before, after: (n, 3) center lines of the lanes [m].
    """
    back = min(BEFORE, 0.25 * _length(before), 0.25 * _length(after))
    into, onward = _cut(before[::-1], back)[::-1], _cut(after, back)
    start, end = into[-1], onward[0]
    heading, away = _direction(into[-2:]), _direction(onward[:2])
    turn = float(wrap(away - heading))
    if abs(turn) < TURN:
        return None
    across = -math.sin(heading) * (end[0] - start[0]) + math.cos(heading) * (end[1] - start[1])
    side = 1.0 if across >= 0.0 else -1.0  # of the lane that leads back: left positive
    a, b = _beside(start, heading, -side), _beside(end, away, -side)
    half = 0.5 * (b - a)
    reach = 4.0 * RADIUS**2 - float(half @ half)
    if reach <= 0.0:
        return None
    forward = np.array([-half[1], half[0]]) / max(float(np.hypot(*half)), 1e-9)
    if forward @ (math.cos(heading), math.sin(heading)) < 0.0:
        forward = -forward
    m = 0.5 * (a + b) + math.sqrt(reach) * forward
    out, home = _angle(a, m), _angle(b, m)
    arcs = (
        _arc(a, _angle(a, start[:2]), out, -side),
        _arc(m, out + math.pi, home + math.pi, side),
        _arc(b, home, _angle(b, end[:2]), -side),
    )
    loop = np.vstack(arcs)
    return into, np.column_stack((loop, np.linspace(start[2], end[2], len(loop)))), onward


def _length(line: np.ndarray) -> float:
    return float(np.hypot(*np.diff(line[:, :2], axis=0).T).sum())


def _cut(line: np.ndarray, length: float) -> np.ndarray:
    """The line without its first `length` [m]."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))))
    first = np.array([np.interp(length, along, column) for column in line.T])
    return np.vstack((first, line[along > length + 0.01]))


def _direction(two: np.ndarray) -> float:
    return math.atan2(two[1, 1] - two[0, 1], two[1, 0] - two[0, 0])


def _beside(point: np.ndarray, heading: float, side: float) -> np.ndarray:
    """The center of a turn to `side` (left positive) that begins at `point`."""
    return point[:2] + side * RADIUS * np.array([-math.sin(heading), math.cos(heading)])


def _angle(center: np.ndarray, point: np.ndarray) -> float:
    return math.atan2(point[1] - center[1], point[0] - center[0])


def _arc(center: np.ndarray, begin: float, end: float, side: float) -> np.ndarray:
    """(n, 2) points around `center` from angle `begin` to `end`, counter-clockwise for a left turn."""
    sweep = side * (side * (end - begin) % (2.0 * math.pi))
    angles = begin + sweep * np.linspace(0.0, 1.0, max(int(abs(sweep) * RADIUS / SAMPLING), 1) + 1)
    return center + RADIUS * np.column_stack((np.cos(angles), np.sin(angles)))
