"""What a world and an ego tell each other: road, traffic, poses and intents."""

from typing import NamedTuple

import numpy as np

from emran_sumo.path import Path


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


class StopLine(NamedTuple):
    """Where a lane stops: (2, 2) ends [m]; light: at a traffic light, else where it gives way."""

    ends: np.ndarray
    light: bool


class Road(NamedTuple):
    """All lanes outside junctions, the junctions as (m, 2) polygons [m], and the stop lines, those of lights first."""

    lanes: tuple[Lane, ...]
    junctions: tuple[np.ndarray, ...]
    stop_lines: tuple[StopLine, ...] = ()


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


class Others(NamedTuple):
    """Traffic seen from the lane that an ego follows or changes to.

    ahead: position of the center of each body ahead of the ego's center [m], negative behind; offset: lateral, from the
    lane's center [m], left positive; speed [m/s]; length, width: extent of each body along and across the lane, however
    it is turned [m]; arrays (n,). own_offset: of the ego itself [m]. alignment: cosine of the angle between each body
    and the lane, (n,) or 1 for all.
    """

    ahead: np.ndarray
    offset: np.ndarray
    speed: np.ndarray
    length: np.ndarray
    width: np.ndarray
    own_offset: float = 0.0
    alignment: np.ndarray | float = 1.0


NOBODY = Traffic((), *(np.zeros(0) for _ in range(7)))


class Pose(NamedTuple):
    """Center of gravity of an ego [m], yaw [rad], speed [m/s] and acceleration [m/s2] along the body."""

    x: float
    y: float
    yaw: float
    speed: float
    accel: float


class Intent(NamedTuple):
    """What the world wants of an ego in one step.

    speed [m/s] at the end of the step. side: +1 to change to the lane on the left, -1 right, 0 stay; only a change that
    nobody blocks; blocked: the same for one that somebody blocks. top [m/s]: what the road and the car allow. Where the
    profile within the step is known: speeds (n + 1,) [m/s] at the borders of the n control periods and accels (n,)
    [m/s2], ahead by the lag of the drive.
    """

    speed: float
    side: int = 0
    speeds: np.ndarray | None = None
    accels: np.ndarray | None = None
    top: float = np.inf
    blocked: int = 0


class TakeOver(NamedTuple):
    """An ego as the world hands it over.

    pose; path: center of its lane along the route; lane_width [m]; lanes_left, lanes_right: lanes beside its own;
    params: of the vehicle; route_position: how far along its route the pose is [m]; route_length [m].
    """

    pose: Pose
    path: Path
    lane_width: float
    lanes_left: int
    lanes_right: int
    params: dict[str, str]
    route_position: float
    route_length: float
