"""A vehicle as SUMO itself drives it: what an ego is compared with."""

from typing import NamedTuple

import libsumo

from emran_sumo.world.session import SUMO_ERRORS
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.wake import Wake


class Native(NamedTuple):
    """One vehicle under SUMO's own driver.

    ended: "arrived" or "finished"; time [s] and distance [m] since it was first seen; wake: see Wake.results.
    """

    ended: str
    time: float
    distance: float
    wake: dict[str, float]


def watch(world: SumoWorld, name: str, duration: float) -> Native:
    """Let SUMO drive on until `name` has arrived, or for `duration` [s]."""
    wake = Wake(name)
    start, begin = world.time, libsumo.vehicle.getDistance(name)
    distance = 0.0
    while world.time - start < duration - 0.5 * world.step:
        world.advance()
        try:
            distance = libsumo.vehicle.getDistance(name) - begin
        except SUMO_ERRORS:
            return Native("arrived", world.time - start, distance, wake.results())
        wake.look()
    return Native("finished", world.time - start, distance, wake.results())
