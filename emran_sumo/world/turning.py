"""Egos that turn back on a loop wider than the road, of which SUMO's right of way does not know.

An ego sets off when nobody is on the way there; from then on phantoms close the ways across its loop, and not SUMO's
wish counts, to which its own phantoms would be in the way, but what it sees of the loop ahead. Where nobody lets it go
for long it closes them first, for a while.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import libsumo
import numpy as np

from emran_sumo.world.braking import to_light, to_stop
from emran_sumo.world.closing import Closing, can_all_be_closed
from emran_sumo.world.crossings import free_length
from emran_sumo.world.records import Traffic
from emran_sumo.world.roadmap import Beside, Loop, RoadMap
from emran_sumo.world.session import SUMO_ERRORS
from emran_sumo.world.turnaround import BEFORE, RADIUS

DURATION = 10.0  # s that a loop takes from standstill
SLOW = 0.5  # m/s: who stands lets the ego go
REACH = 60.0  # m before a loop from where its traffic is looked at
BEGUN = 1.0  # m behind the begin of the loop from where the ego goes on
SETS_OFF = 2.0  # m before it from where it does not stop any more
APART = 4.0  # m between loops that two cars can drive at once
KEEPS = 1.0  # m that it stays away from who is on its way
PATIENCE = 20.0  # s after which an ego that stands closes the ways before it sets off
ASKS, HOLDS = 15.0, 25.0  # s for which they are closed at the most before it sets off, and from then on


class _Asked(NamedTuple):
    """An ego that stands before its loop since a time, and has closed the ways since another [s]."""

    stands: float
    closed: float = math.inf


class Turning:
    """Which egos are on such a loop now, or about to be."""

    def __init__(self, roads: RoadMap) -> None:
        self._map = roads
        self._loops: dict[str, Loop] = {}  # that each ego is on
        self._on: set[str] = set()
        self._under_way: dict[str, float] = {}  # when they have set off [s]
        self._waiting: dict[str, _Asked] = {}
        self._front: dict[str, tuple[float, float]] = {}  # where the bumper is [m]
        self._closing = Closing()

    @property
    def phantoms(self) -> int:
        """How many phantoms stand on the road."""
        return len(self._closing)

    def look(self, ego: str, x: float, y: float) -> Beside | None:
        """Where SUMO is to have an ego whose front bumper is at (x, y) [m] on a loop; None where it is as it is.

        Beside the loop, on the lanes that turn back: it may be nearer to lanes that its route uses another time. Its
        phantoms stay where they are.
        """
        self._on.discard(ego)
        self._closing.keep(ego)
        self._front[ego] = x, y
        loop = self._loops[ego] if ego in self._under_way else None
        if loop is None or not loop.is_near(x, y):
            return None
        self._on.add(ego)
        return loop.on_lanes(x, y)

    def is_on(self, ego: str) -> bool:
        """Whether SUMO has the ego on the lane beside its loop."""
        return ego in self._on

    def is_under_way(self, ego: str) -> bool:
        """Whether the ego has set off on a loop: what SUMO sees in its way there does not count."""
        return ego in self._under_way

    def drop(self, ego: str) -> None:
        """The ego turns back no more."""
        self._under_way.pop(ego, None)
        self._loops.pop(ego, None)
        self._waiting.pop(ego, None)
        self._closing.open(ego)

    def speed(self, ego: str, lane: str, present: float, wished: float, look: Callable[[str], Traffic]) -> float:
        """Speed [m/s] of an ego: what is wished, or less before a loop on which it would be in somebody's way.

        Args:
            lane: that it is on; present: its speed [m/s]; wished: by SUMO [m/s].
            look: tells the traffic around an ego; it is asked near a loop only.
        """
        if ego in self._under_way:
            if not self._loops[ego].is_near(*self._front[ego]):
                self.drop(ego)
            else:
                own = self._speed_on(ego, present, look(ego))
                return min(own, wished) if lane == self._loops[ego].lanes[-1] else own
        vehicle = libsumo.vehicle
        route, index = vehicle.getRoute(ego), vehicle.getRouteIndex(ego)
        loop = self._map.loop(lane, route[index + 1] if index + 1 < len(route) else "")
        if loop is None:
            if ego in self._waiting:
                self.drop(ego)
            return wished
        gap = libsumo.lane.getLength(lane) - vehicle.getLanePosition(ego) - BEFORE
        if gap > REACH or to_stop(ego) < gap + BEFORE:
            return wished
        if gap < -BEGUN:
            if _may_pass(ego, gap):
                self._set_off(ego, loop)
            return wished
        if self._may_go(ego, loop, gap, present, look(ego)):
            if gap < SETS_OFF:
                self._set_off(ego, loop)
            return wished
        return min(wished, max(vehicle.getStopSpeed(ego, present, max(gap, 0.0)), 0.0))

    def _speed_on(self, ego: str, speed: float, traffic: Traffic) -> float:
        """Speed [m/s] on the loop: as its bends allow, but not into anybody."""
        vehicle, way = libsumo.vehicle, self._loops[ego].way
        if libsumo.simulation.getTime() - self._under_way[ego] > HOLDS:
            self._closing.open(ego)
        k = int(np.hypot(*(way - self._front[ego]).T).argmin())
        gap = free_length(way[k:], vehicle.getWidth(ego), traffic) - KEEPS
        faster = min(speed + vehicle.getAccel(ego) * libsumo.simulation.getDeltaT(), vehicle.getAllowedSpeed(ego))
        return max(min(faster, vehicle.getStopSpeed(ego, speed, max(gap, 0.0))), 0.0) if gap < REACH else faster

    def _set_off(self, ego: str, loop: Loop) -> None:
        self._waiting.pop(ego, None)
        self._loops[ego] = loop
        self._closing.close(ego, loop.crossings, loop.lanes[0])
        self._under_way[ego] = libsumo.simulation.getTime()

    def _may_go(self, ego: str, loop: Loop, gap: float, speed: float, traffic: Traffic) -> bool:
        """Whether nobody will be on the loop while it is driven."""
        may_pass = _may_pass(ego, gap)
        all_closed = self._asks(ego, loop, gap, speed, may_pass)
        return (
            may_pass
            and not any(self._is_shared(loop, other) for other in self._under_way)
            and math.isinf(free_length(loop.way, libsumo.vehicle.getWidth(ego), traffic))
            and _is_clear(loop, traffic, all_closed)
            and can_all_be_closed(loop.crossings, loop.lanes[0])
        )

    def _is_shared(self, loop: Loop, other: str) -> bool:
        """Whether another ego is on its way across this loop."""
        apart = loop.points[:, None] - self._loops[other].points[None]
        return bool((np.hypot(apart[..., 0], apart[..., 1]) < APART).any())

    def _asks(self, ego: str, loop: Loop, gap: float, speed: float, may_pass: bool) -> bool:
        """Close the ways, for a while, for an ego that has stood for long; whether they are. may_pass: no red light."""
        if gap > SETS_OFF or speed > SLOW:
            self._waiting.pop(ego, None)
            return False
        now = libsumo.simulation.getTime()
        asked = self._waiting.setdefault(ego, _Asked(now))
        if now - asked.closed > ASKS:
            asked = _Asked(now)
        if not may_pass or now - asked.stands < PATIENCE:
            self._closing.open(ego)
            self._waiting[ego] = asked._replace(closed=math.inf)
            return False
        self._waiting[ego] = asked._replace(closed=min(asked.closed, now))
        return self._closing.close(ego, loop.crossings, loop.lanes[0])


def _may_pass(ego: str, gap: float) -> bool:
    """Whether no light holds the ego before its loop, which begins in a gap [m]."""
    return to_light(ego) > gap + BEFORE + BEGUN


def _is_clear(loop: Loop, traffic: Traffic, closed: bool) -> bool:
    """Whether nobody, but on the ego's own lane, comes to the loop while it is driven.

    closed: all ways are: who is not inside the junction waits before it.
    """
    points = loop.points
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    away = center - np.column_stack((traffic.x, traffic.y))
    distance = np.maximum(np.hypot(*away.T) - 2.0 * RADIUS, 0.0)
    toward = away[:, 0] * np.cos(traffic.yaw) + away[:, 1] * np.sin(traffic.yaw) > 0.0
    coming = (toward | (distance == 0.0)) & (traffic.speed > SLOW) & (distance < DURATION * traffic.speed)
    return not any(_counts(traffic.ids[k], loop, closed) for k in np.flatnonzero(coming))


def _counts(name: str, loop: Loop, closed: bool) -> bool:
    """Whether a vehicle that comes is on the road still, and neither behind the ego nor before a closed way."""
    try:
        lane = libsumo.vehicle.getLaneID(name)
    except SUMO_ERRORS:
        return False
    return lane != loop.lanes[0] and (not closed or lane.startswith(":"))
