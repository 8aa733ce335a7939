"""Phantoms that stand in the ways across a loop while it is driven: SUMO's traffic waits behind them."""

import contextlib

import libsumo

from emran_sumo.world.braking import MOVING
from emran_sumo.world.crossings import Crossing
from emran_sumo.world.phantom import PREFIX, add, remove
from emran_sumo.world.session import SUMO_ERRORS, move

LENGTH = 0.5  # m of such a phantom
BRAKING = 2.5  # m/s2 that nobody is to exceed for one
SPARE = 2.0  # m


class Closing:
    """The ways that are closed for each ego."""

    def __init__(self) -> None:
        self._closed: dict[str, dict[str, Crossing]] = {}  # ego: phantom: way

    def __len__(self) -> int:
        return sum(map(len, self._closed.values()))

    def close(self, ego: str, ways: tuple[Crossing, ...], own: str) -> bool:
        """Close those ways whose next user can stop; whether all are closed. own: lane that the ego is on."""
        closed = self._closed.setdefault(ego, {})
        for k, way in enumerate(ways):
            name = f"{PREFIX}{ego}#{k}"  # no other ego's own
            if name not in closed and _can_be_closed(way, own):
                try:
                    _stand(name, ego, way)
                    closed[name] = way
                except SUMO_ERRORS:
                    remove(name)
        return len(closed) == len(ways)

    def keep(self, ego: str) -> None:
        """Hold the phantoms where they stand for this step: SUMO would drive them on."""
        for name, way in self._closed.get(ego, {}).items():
            with contextlib.suppress(*SUMO_ERRORS):  # the scenario may take vehicles from the road
                move(name, way.x, way.y, way.yaw)

    def open(self, ego: str) -> None:
        """Take the ego's phantoms from the road."""
        for name in self._closed.pop(ego, {}):
            remove(name)


def can_all_be_closed(ways: tuple[Crossing, ...], own: str) -> bool:
    """Whether whoever comes next on each way can stop before the loop; on the ego's own lane they follow it."""
    return all(_can_be_closed(way, own) for way in ways)


def _can_be_closed(way: Crossing, own: str) -> bool:
    if way.before == own:
        return True
    vehicle, lane = libsumo.vehicle, libsumo.lane
    start = -lane.getLength(way.before)
    for name in (way.before, *way.lanes):
        for other in lane.getLastStepVehicleIDs(name):
            speed = vehicle.getSpeed(other)
            left = way.along - LENGTH - start - vehicle.getLanePosition(other)
            if not other.startswith(PREFIX) and 0.0 < left < 0.5 * speed * speed / BRAKING + SPARE and speed > MOVING:
                return False
        start += lane.getLength(name)
    return True


def _stand(name: str, ego: str, way: Crossing) -> None:
    vehicle = libsumo.vehicle
    add(name, ego)
    vehicle.setVehicleClass(name, "ignoring")  # may be on any lane
    vehicle.setLength(name, LENGTH)
    vehicle.setRoute(name, way.edges)
    move(name, way.x, way.y, way.yaw)
