"""Traffic lights as a driver sees them: where to stop, and what is shown there."""

import libsumo
import numpy as np

from emran_sumo.world.records import StopLine
from emran_sumo.world.roadmap import RoadMap

YIELDING = "msw="  # states of a link that gives way: minor, stop, all-way stop, equal
# what a lane shows whose directions differ: the first of these that any of them has
PERMISSIVE = "GgyYuroO"


class Signals:
    """The lights of the running simulation."""

    def __init__(self) -> None:
        self._lanes: list[tuple[str, str, tuple[int, ...]]] = []  # lane, light, the places of its links
        for light in libsumo.trafficlight.getIDList():
            places: dict[str, list[int]] = {}
            for k, links in enumerate(libsumo.trafficlight.getControlledLinks(light)):
                for lane, *_ in links:
                    if not lane.startswith(":"):
                        places.setdefault(lane, []).append(k)
            self._lanes += [(lane, light, tuple(found)) for lane, found in places.items()]
        self._lights = tuple(dict.fromkeys(light for _, light, _ in self._lanes))
        self._last: dict[str, str] = {}

    @property
    def lanes(self) -> tuple[str, ...]:
        """Lanes that end at a light, in the order of the states."""
        return tuple(lane for lane, _, _ in self._lanes)

    def changed(self) -> str | None:
        """One letter of SUMO's signal states per lane, or None where nothing has changed since the last call."""
        if not self._lights:
            return None
        now = {light: libsumo.trafficlight.getRedYellowGreenState(light) for light in self._lights}
        if now == self._last:
            return None
        self._last = now
        return "".join(_shown(now[light], places) for _, light, places in self._lanes)


def stop_lines(road: RoadMap, signals: Signals) -> tuple[StopLine, ...]:
    """The line at the end of each lane that stops at a light, in their order, then those of lanes that give way."""
    with_light = set(signals.lanes)
    giving_way = [
        lane
        for lane in libsumo.lane.getIDList()
        if not lane.startswith(":")
        and lane not in with_light
        and any(link[5] in YIELDING for link in libsumo.lane.getLinks(lane))
    ]
    lines = [StopLine(_across(road, lane), True) for lane in signals.lanes]
    return (*lines, *(StopLine(_across(road, lane), False) for lane in giving_way))


def _across(road: RoadMap, lane: str) -> np.ndarray:
    """(2, 2) ends of the stop line of a lane [m]."""
    before, end = road.shape(lane)[-2:, :2]
    along = (end - before) / max(float(np.hypot(*(end - before))), 1e-9)
    left = 0.5 * libsumo.lane.getWidth(lane) * np.array((-along[1], along[0]))
    return np.stack((end + left, end - left))


def _shown(state: str, places: tuple[int, ...]) -> str:
    found = {state[k] for k in places if k < len(state)}
    return next((letter for letter in PERMISSIVE if letter in found), "O")
