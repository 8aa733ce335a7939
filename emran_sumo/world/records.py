"""What a world shows of itself: its road, drawn once, and its traffic, one instant at a time."""

from typing import NamedTuple

import numpy as np


class Lane(NamedTuple):
    """One driving lane.

    id: SUMO's lane id; edge: its edge; index: 0 is the rightmost of `count` lanes; width [m];
    shape: (n, 3) points of the center line [m].
    """

    id: str
    edge: str
    index: int
    count: int
    width: float
    shape: np.ndarray


class Road(NamedTuple):
    """All lanes outside junctions, and the junctions as (m, 2) polygons [m]."""

    lanes: tuple[Lane, ...]
    junctions: tuple[np.ndarray, ...]


class Traffic(NamedTuple):
    """Vehicles other than the egos at one instant; arrays of shape (n,), x and y at the center of the body."""

    ids: tuple[str, ...]
    x: np.ndarray  # m
    y: np.ndarray  # m
    yaw: np.ndarray  # rad, counter-clockwise from east
    length: np.ndarray  # m
    width: np.ndarray  # m
    height: np.ndarray  # m
    speed: np.ndarray  # m/s
