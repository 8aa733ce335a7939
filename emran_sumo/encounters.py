"""Post-encroachment times: how soon one vehicle is where another, on a crossing way, has just been."""

import math
from collections import deque

import numpy as np

from emran_sumo.metrics import Box, boxes_overlap
from emran_sumo.world.records import Traffic

MEMORY = 3.0  # s
SAMPLING = 0.2  # s
NEAR = 40.0  # m
CROSSING = math.sin(math.radians(45.0))  # of the angle between ways that cross; who follows in a bend turns by less

Past = deque[tuple[float, Box]]


class Encounters:
    """The least post-encroachment time of one ego so far [s]; inf without an encounter.

    Time between one body's leaving a place and the other's reaching it, as SUMO's SSM device has it (PET), within 0.2 s
    and up to 3 s. Differs: bodies are oriented boxes at their true poses, not conflict areas of lanes.
    """

    def __init__(self) -> None:
        self.least = math.inf
        self._own: Past = deque(maxlen=round(MEMORY / SAMPLING))
        self._others: dict[str, Past] = {}
        self._next = -math.inf

    def look(self, time: float, own: Box, traffic: Traffic) -> float:
        """Post-encroachment time [s] that ends now, or inf."""
        if time < self._next:
            return math.inf
        self._next = time + SAMPLING - 1e-6
        found = math.inf
        pasts: dict[str, Past] = {}
        near = np.flatnonzero(np.hypot(traffic.x - own.x, traffic.y - own.y) < NEAR) if traffic.ids else ()
        for k in near:
            name, other = traffic.ids[k], body(traffic, int(k))
            past = self._others.get(name) or deque(maxlen=self._own.maxlen)
            found = min(found, _since(self._own, other, time), _since(past, own, time))
            past.append((time, other))
            pasts[name] = past
        self._own.append((time, own))
        self._others = pasts
        self.least = min(self.least, found)
        return found


def body(traffic: Traffic, k: int) -> Box:
    """Body of one vehicle of the traffic."""
    return Box(*(float(a[k]) for a in (traffic.x, traffic.y, traffic.yaw, traffic.length, traffic.width)))


def _since(past: Past, now: Box, time: float) -> float:
    """Time since a body of the past was last where `now` is, on a crossing way [s]."""
    for then, box in reversed(past):
        if abs(math.sin(box.yaw - now.yaw)) > CROSSING and boxes_overlap(box, now):
            return time - then
    return math.inf
