"""Stand-ins of egos in a second lane: they hold it while the body overlaps it, and give its traffic a leader.

Others close the ways across a loop (`closing.py`).
"""

import contextlib

import libsumo

from emran_sumo.world.roadmap import Beside
from emran_sumo.world.session import SUMO_ERRORS, move

PREFIX = "emran_sumo.phantom."  # of their ids
NEVER_CHANGES_LANE = 0


def real(names: tuple[str, ...]) -> tuple[str, ...]:
    """The names that are no phantoms."""
    return tuple(name for name in names if not name.startswith(PREFIX))


def add(phantom: str, ego: str) -> None:
    """Let a phantom of the ego's type come; it needs a route and a place in the same step."""
    vehicle = libsumo.vehicle
    # the ego's own copy of its type ("type@ego") dies with the first vehicle that has it: take the original
    vehicle.add(phantom, "", vehicle.getTypeID(ego).removesuffix(f"@{ego}"))
    vehicle.setLaneChangeMode(phantom, NEVER_CHANGES_LANE)


def remove(phantom: str) -> None:
    """Take a phantom from the road."""
    with contextlib.suppress(*SUMO_ERRORS):
        libsumo.vehicle.remove(phantom)


class Phantoms:
    """The phantoms that are on the road."""

    def __init__(self) -> None:
        self._egos: set[str] = set()

    def __contains__(self, ego: str) -> bool:
        return ego in self._egos

    def __len__(self) -> int:
        return len(self._egos)

    def place(self, ego: str, point: Beside, step: float) -> None:
        """Put the phantom of an ego at a point of the second lane."""
        if ego not in self._egos:
            self._add(ego, step)
        move(PREFIX + ego, point.x, point.y, point.yaw)

    def set_speed(self, ego: str, speed: float, accel: float) -> None:
        """Tell SUMO the speed [m/s] and acceleration [m/s2] of the ego's phantom, if it has one."""
        if ego in self._egos:
            libsumo.vehicle.setPreviousSpeed(PREFIX + ego, speed, accel)

    def drop(self, ego: str) -> None:
        """Take the ego's phantom from the road, if it has one."""
        if ego in self._egos:
            self._egos.remove(ego)
            remove(PREFIX + ego)

    def _add(self, ego: str, step: float) -> None:
        vehicle, phantom = libsumo.vehicle, PREFIX + ego
        add(phantom, ego)
        vehicle.setRoute(phantom, vehicle.getRoute(ego)[vehicle.getRouteIndex(ego) :])
        vehicle.setActionStepLength(phantom, step)
        self._egos.add(ego)
