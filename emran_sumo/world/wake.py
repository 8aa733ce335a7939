"""What an ego costs those behind it: their hardest braking and their delay."""

import contextlib

import libsumo

from emran_sumo.world import phantom
from emran_sumo.world.session import SUMO_ERRORS

REACH = 100.0  # m behind the ego


class Wake:
    """The followers of one vehicle, whoever drives it."""

    def __init__(self, ego: str) -> None:
        self._ego = ego
        self._hardest = 0.0
        self._loss: dict[str, tuple[float, float]] = {}

    def look(self) -> None:
        """Note the present follower after a step."""
        with contextlib.suppress(*SUMO_ERRORS):
            name, _ = libsumo.vehicle.getFollower(self._ego, REACH)
            if not name or name.startswith(phantom.PREFIX):
                return
            self._hardest = max(self._hardest, -libsumo.vehicle.getAcceleration(name))
            lost = libsumo.vehicle.getTimeLoss(name)
            first, _ = self._loss.get(name, (lost, lost))
            self._loss[name] = (first, lost)

    def results(self) -> dict[str, float]:
        """Hardest braking of a follower [m/s2], their number, and the time they lost behind the ego [s]."""
        return {
            "follower_decel_max": self._hardest,
            "followers": len(self._loss),
            "follower_delay": sum(last - first for first, last in self._loss.values()),
        }
