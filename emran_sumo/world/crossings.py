"""Ways through a junction that cross a loop, and bodies that stand on it."""

import math
from collections.abc import Callable
from typing import NamedTuple

import libsumo
import numpy as np

from emran_sumo.world.records import Traffic

CLOSE = 2.4  # m between the loop and the center of a lane from where two cars touch: two halves of them and some room
ROOM = 0.4  # m beside the body that drives a loop
FORESIGHT = 0.7  # s that others are looked ahead
BESIDE = 0.5  # m between two bodies of which one lets the other pass


class Crossing(NamedTuple):
    """A way through a junction that crosses a loop.

    edges: before and after it; before: the lane that leads in; lanes: inside; x, y [m] and yaw [rad]: its last place
    before the loop; along: of that from the junction's border on [m].
    """

    edges: tuple[str, str]
    before: str
    lanes: tuple[str, ...]
    x: float
    y: float
    yaw: float
    along: float


def crossings(loop: np.ndarray, turning: tuple[str, ...], shape: Callable[[str], np.ndarray]) -> tuple[Crossing, ...]:
    """All ways that cross a loop (n, 2) [m], but that of the lanes that turn back themselves.

    Args:
        turning: lane before the junction, those inside, lane behind.
        shape: tells the center line (n, 3) of a lane [m].
    """
    junction = libsumo.edge.getToJunction(libsumo.lane.getEdgeID(turning[0]))
    found = []
    for edge in libsumo.junction.getIncomingEdges(junction):
        if edge.startswith(":"):
            continue
        for k in range(libsumo.edge.getLaneNumber(edge)):
            before = f"{edge}_{k}"
            for link in libsumo.lane.getLinks(before):
                lanes = inside(link[4])
                if lanes and lanes[0] not in turning:
                    place = _last_place(loop, [shape(name)[:, :2] for name in lanes])
                    after = libsumo.lane.getEdgeID(link[0])
                    found += [Crossing((edge, after), before, lanes, *place)] if place else []
    return tuple(found)


def inside(via: str) -> tuple[str, ...]:
    """Lanes inside a junction from `via` on; there may be two in a row."""
    found: list[str] = []
    while via.startswith(":"):
        found.append(via)
        links = libsumo.lane.getLinks(via)
        via = links[0][4] if links else ""
    return tuple(found)


def sampled(line: np.ndarray, spacing: float) -> np.ndarray:
    """Points (m, 2) about every `spacing` on a polyline (n, 2) [m]."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
    places = np.linspace(0.0, along[-1], max(int(along[-1] / spacing), 1) + 1)
    return np.column_stack([np.interp(places, along, column) for column in line.T])


def _last_place(loop: np.ndarray, shapes: list[np.ndarray]) -> tuple[float, float, float, float] | None:
    """x, y [m], yaw [rad] and position [m] on lanes in a row where they come close to the loop; None if they do not."""
    line = sampled(np.vstack(shapes), 0.5)
    distance = np.hypot(line[:, None, 0] - loop[None, :, 0], line[:, None, 1] - loop[None, :, 1]).min(1)
    near = np.flatnonzero(distance < CLOSE)
    if near.size == 0:
        return None
    k = min(max(int(near[0]), 1), len(line) - 1)
    step = np.diff(line, axis=0)
    yaw = math.atan2(step[k - 1, 1], step[k - 1, 0])
    return float(line[k, 0]), float(line[k, 1]), yaw, float(np.hypot(*step[:k].T).sum())


def free_length(way: np.ndarray, width: float, traffic: Traffic) -> float:
    """How far a body of some width can go along a way (n, 2) until it meets another, now or soon [m]; else infinite."""
    if not traffic.ids:
        return math.inf
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))))
    cosine, sine = np.cos(traffic.yaw), np.sin(traffic.yaw)
    met = np.zeros(len(way), dtype=bool)
    for ahead in (0.0, FORESIGHT * traffic.speed):
        east = way[:, :1] - (traffic.x + ahead * cosine)
        north = way[:, 1:] - (traffic.y + ahead * sine)
        beyond = np.maximum(np.abs(east * cosine + north * sine) - 0.5 * traffic.length, 0.0)
        beside = np.maximum(np.abs(north * cosine - east * sine) - 0.5 * traffic.width, 0.0)
        met |= (np.hypot(beyond, beside) < 0.5 * width + ROOM).any(1)
    return float(along[np.argmax(met)]) if met.any() else math.inf


def is_past(other: str, lane: str, own: str, width: float) -> bool:
    """Whether a vehicle on a lane has come by another lane with its whole body.

    What is left of its lane, from its rear bumper on, then stays clear of a body of some width [m] on lane `own`.
    """
    vehicle = libsumo.vehicle
    rear = vehicle.getLanePosition(other) - vehicle.getLength(other)
    line, way = (sampled(np.array(libsumo.lane.getShape(name))[:, :2], 0.5) for name in (lane, own))
    left = line[int(max(rear, 0.0) / libsumo.lane.getLength(lane) * (len(line) - 1)) :]
    near = 0.5 * (width + vehicle.getWidth(other)) + BESIDE
    return bool(np.hypot(*(left[:, None] - way[None]).transpose(2, 0, 1)).min() > near)
