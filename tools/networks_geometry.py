"""Alignments: roads as surveyors describe them, sampled into the points that netconvert reads.

A road is a list of (length, curvature at the end) in which the curvature runs linearly, so that lines, arcs and
clothoids are one thing; its height is a list of (length, grade at the end) with straight grades and parabolas.
"""

from typing import NamedTuple

import numpy as np

SAMPLING = 15.0  # [m]; an arc of radius 700 m deviates 4 cm from its chord; SUMO slows down with more points
QUADRATURE = 5.0  # [m] between the knots of the integration


class Alignment(NamedTuple):
    """A line in the plane that starts in the origin heading east; curvature positive to the left."""

    station: np.ndarray  # (n,) arc length where an element ends, first 0 [m]
    curvature: np.ndarray  # (n,) curvature there [1/m]
    heading: np.ndarray  # (n,) heading there [rad]


def alignment(elements: list[tuple[float, float]]) -> Alignment:
    """Chain of (length [m], curvature at the end [1/m]) elements; the first one starts straight."""
    length, end = np.array([(0.0, 0.0), *elements]).T
    mean = np.concatenate(([0.0], 0.5 * (end[1:] + end[:-1])))
    return Alignment(np.cumsum(length), end, np.cumsum(mean * length))


def heading(line: Alignment, s: np.ndarray) -> np.ndarray:
    """Heading [rad] at arc length s [m]: the exact integral of the piecewise linear curvature."""
    k = np.clip(np.searchsorted(line.station, s, side="right") - 1, 0, len(line.station) - 2)
    ds = s - line.station[k]
    rate = (line.curvature[k + 1] - line.curvature[k]) / (line.station[k + 1] - line.station[k])
    return line.heading[k] + (line.curvature[k] + 0.5 * rate * ds) * ds


def height(grades: list[tuple[float, float]], s: np.ndarray) -> np.ndarray:
    """Height [m] at s [m] of a chain of (length [m], grade at the end) elements that starts level.

    Height is to grade what heading is to curvature.
    """
    return heading(alignment(grades), s)


def position(line: Alignment, s: np.ndarray) -> np.ndarray:
    """Points (n, 2) [m] at increasing arc lengths s (n,) [m], by quadrature over short steps."""
    knots = np.union1d(np.union1d(np.arange(0.0, s[-1], QUADRATURE), line.station[line.station < s[-1]]), s)
    node, weight = np.polynomial.legendre.leggauss(6)
    half = 0.5 * np.diff(knots)
    angle = heading(line, (knots[:-1] + half)[:, None] + half[:, None] * node)
    steps = half[:, None] * np.stack(((np.cos(angle) * weight).sum(1), (np.sin(angle) * weight).sum(1)), axis=1)
    return np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))[np.searchsorted(knots, s)]


def offset(line: Alignment, s: np.ndarray, left: np.ndarray | float) -> np.ndarray:
    """Points (n, 2) of the line at s (n,), moved by `left` [m] (a number or one per point)."""
    angle = heading(line, s)
    normal = np.stack((-np.sin(angle), np.cos(angle)), axis=1)
    return position(line, s) + np.broadcast_to(left, s.shape)[:, None] * normal


def corners(points: np.ndarray) -> np.ndarray:
    """The points (n, 2 or 3) without those on the straight between their neighbors: SUMO is faster with fewer."""
    space = np.column_stack((points, np.zeros(len(points)))) if points.shape[1] == 2 else points
    along = np.diff(space, axis=0)
    turn = np.linalg.norm(np.cross(along[:-1], along[1:]), axis=1) / np.linalg.norm(along[1:], axis=1)
    return points[np.r_[True, turn > 1e-4, True]]


def samples(start: float, end: float, spacing: float = SAMPLING) -> np.ndarray:
    """Arc lengths from start to end, evenly spaced by at most `spacing`."""
    return np.linspace(start, end, int(np.ceil((end - start) / spacing)) + 1)


def curve(radius: float, transition: float, arc: float) -> list[tuple[float, float]]:
    """Clothoid, arc, clothoid; radius [m] positive to the left, lengths [m]."""
    return [(transition, 1.0 / radius), (arc, 1.0 / radius), (transition, 0.0)]
