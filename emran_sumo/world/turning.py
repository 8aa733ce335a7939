"""Egos that turn back on a loop wider than the road, of which SUMO's right of way does not know."""

import math
from collections.abc import Callable

import libsumo
import numpy as np

from emran_sumo.world.records import Traffic
from emran_sumo.world.roadmap import Beside, Loop, RoadMap
from emran_sumo.world.session import SUMO_ERRORS
from emran_sumo.world.turnaround import BEFORE, RADIUS

OFF_LANE = 1.5  # m beside the center of its lane, on a loop, from where SUMO has the ego on the lane's center
DURATION = 10.0  # s that a loop takes from standstill
SLOW = 0.5  # m/s: who stands lets the ego go
REACH = 60.0  # m before a loop from where its traffic is looked at
BEGUN = 1.0  # m behind the begin of the loop from where the ego goes on


class Turning:
    """Which egos are on such a loop now."""

    def __init__(self, roads: RoadMap) -> None:
        self._map = roads
        self._loops: dict[str, Loop] = {}  # the next or the last one of each ego
        self._on: set[str] = set()

    def look(self, ego: str, lane: str, x: float, y: float) -> Beside | None:
        """Where SUMO is to have an ego whose front bumper is at (x, y) [m] on a loop; None where it is as it is.

        lane: that it is on in SUMO, "" for none.
        """
        self._on.discard(ego)
        loop = self._loops.get(ego)
        if loop is None or not loop.is_near(x, y):
            return None
        beside = [self._map.beside(name, x, y) for name in loop.lanes]
        nearest = min(beside, key=lambda point: math.hypot(point.x - x, point.y - y))
        if lane in loop.lanes and math.hypot(nearest.x - x, nearest.y - y) < OFF_LANE:
            return None
        self._on.add(ego)
        return nearest

    def is_on(self, ego: str) -> bool:
        """Whether SUMO has the ego on the lane beside its loop."""
        return ego in self._on

    def speed(self, ego: str, lane: str, look: Callable[[str], Traffic]) -> float:
        """Speed [m/s] that stops the ego before a loop on which it would be in somebody's way; else infinite.

        look: tells the traffic around an ego; it is asked near a loop only.
        """
        vehicle = libsumo.vehicle
        route, index = vehicle.getRoute(ego), vehicle.getRouteIndex(ego)
        loop = self._map.loop(lane, route[index + 1] if index + 1 < len(route) else "")
        if loop is None:
            return math.inf
        self._loops[ego] = loop
        gap = libsumo.lane.getLength(lane) - vehicle.getLanePosition(ego) - BEFORE
        if not -BEGUN < gap < REACH or _is_clear(loop.points, look(ego), libsumo.lane.getEdgeID(lane)):
            return math.inf
        speed = vehicle.getSpeed(ego)
        return max(vehicle.getStopSpeed(ego, speed, max(gap, 0.0)), 0.0)


def _is_clear(loop: np.ndarray, traffic: Traffic, edge: str) -> bool:
    """Whether nobody, but on the ego's own `edge`, comes to the loop (n, 2) [m] while it is driven."""
    center = 0.5 * (loop.min(axis=0) + loop.max(axis=0))
    away = center - np.column_stack((traffic.x, traffic.y))
    distance = np.maximum(np.hypot(*away.T) - 2.0 * RADIUS, 0.0)
    toward = away[:, 0] * np.cos(traffic.yaw) + away[:, 1] * np.sin(traffic.yaw) > 0.0
    coming = (toward | (distance == 0.0)) & (traffic.speed > SLOW) & (distance < DURATION * traffic.speed)
    return all(_is_gone_or_on(traffic.ids[k], edge) for k in np.flatnonzero(coming))


def _is_gone_or_on(name: str, edge: str) -> bool:
    """Whether a vehicle is on an edge, or has left the road since it was seen."""
    try:
        return libsumo.vehicle.getRoadID(name) == edge
    except SUMO_ERRORS:
        return True
