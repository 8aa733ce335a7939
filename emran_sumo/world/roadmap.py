"""Lanes as SUMO knows them: shapes, chains along a route, and what lies beside a point."""

import itertools
import math
from typing import NamedTuple

import libsumo
import numpy as np

from emran_sumo.path import Path
from emran_sumo.world.crossings import Crossing, crossings, inside, sampled
from emran_sumo.world.lanes import (
    JUNCTION_TOLERANCE,
    LANE_TOLERANCE,
    SHIFT_LEAST,
    dense,
    joined,
    loosened,
    shift_between,
    smooth_path,
)
from emran_sumo.world.records import Lane, Road
from emran_sumo.world.turnaround import SAMPLING, turned

BESIDE_LOOP = 3.0  # m
BEHIND_LOOP = 8.0  # m of the lane behind it that have to be free before it is driven
HORIZON = 6000.0  # m that a path looks ahead at the most


class Beside(NamedTuple):
    """Nearest point of a line: coordinates [m], direction [rad], signed distance to it [m], left positive."""

    x: float
    y: float
    yaw: float
    offset: float


class Loop(NamedTuple):
    """Where paths turn back wider than the road.

    points: (n, 2) [m]; lanes: that turn back; beside: (n, 3) places on them, x, y [m] and yaw [rad], for each point;
    way: the points and some of the lane behind them (m, 2) [m]; crossings: the ways through the junction that cross it.
    """

    points: np.ndarray
    lanes: tuple[str, ...]
    beside: np.ndarray
    way: np.ndarray
    crossings: tuple[Crossing, ...]

    def is_near(self, x: float, y: float) -> bool:
        """Whether (x, y) [m] is beside the loop."""
        return bool((np.hypot(*(self.points - (x, y)).T) < BESIDE_LOOP).any())

    def on_lanes(self, x: float, y: float) -> Beside:
        """The place on the lanes that turn back for a body at (x, y) [m] on the loop: as far along, in shares."""
        k = int(np.hypot(*(self.points - (x, y)).T).argmin())
        x, y, yaw = map(float, self.beside[k])
        return Beside(x, y, yaw, 0.0)


class RoadMap:
    """Geometry of the running simulation's network; every shape is asked of SUMO once."""

    def __init__(self) -> None:
        self._shapes: dict[str, np.ndarray] = {}
        self._paths: dict[tuple[str, ...], Path] = {}
        self._loops: dict[tuple[str, str], Loop] = {}

    def shape(self, lane: str) -> np.ndarray:
        """Center line (n, 3) of a lane [m]."""
        if lane not in self._shapes:
            flat = np.array(libsumo.lane.getShape(lane), dtype=float)[:, :2]
            self._shapes[lane] = np.column_stack((flat, _heights(lane, flat)))
        return self._shapes[lane]

    def beside(self, lane: str, x: float, y: float) -> Beside:
        """The point of a lane's center line nearest to (x, y) [m]."""
        line = self.shape(lane)[:, :2]
        start, along = line[:-1], np.diff(line, axis=0)
        squared = np.maximum((along**2).sum(1), 1e-12)
        share = np.clip(((x - start[:, 0]) * along[:, 0] + (y - start[:, 1]) * along[:, 1]) / squared, 0.0, 1.0)
        foot = start + share[:, None] * along
        k = int(np.argmin((foot[:, 0] - x) ** 2 + (foot[:, 1] - y) ** 2))
        yaw = math.atan2(along[k, 1], along[k, 0])
        offset = -(x - foot[k, 0]) * math.sin(yaw) + (y - foot[k, 1]) * math.cos(yaw)
        return Beside(float(foot[k, 0]), float(foot[k, 1]), yaw, float(offset))

    def path(self, lane: str, route: tuple[str, ...], index: int) -> Path:
        """Smooth path from before `lane` along the route, whose edge `index` the lane belongs to (or leads to)."""
        chain = self._chain(lane, route, index)
        if chain not in self._paths:
            if len(self._paths) > 256:
                self._paths.clear()
            points = joined(*self._lines(chain))
            self._paths[chain] = smooth_path(_extended(self._loosened(points, chain)))
        return self._paths[chain]

    def _lines(self, chain: tuple[str, ...]) -> tuple[list[np.ndarray], list[float]]:
        """Center lines to follow, with room to turn where the route turns back, and the tolerance of each [m]."""
        lines = [self.shape(name) for name in chain]
        tolerances = [JUNCTION_TOLERANCE if name.startswith(":") else LANE_TOLERANCE for name in chain]
        outside = [k for k, name in enumerate(chain) if not name.startswith(":")]
        for one, following in reversed(list(itertools.pairwise(outside))):
            loop = turned(lines[one], lines[following])
            if loop is not None:
                turning = chain[one : following + 1]
                self._note_loop(turning, loop[1][:, :2], loop[2][:, :2])
                lines[one : following + 1] = loop
                tolerances[one : following + 1] = [LANE_TOLERANCE] * 3
        # dense: a tolerance ends where its lane ends
        return [dense(line) for line in lines], tolerances

    def _note_loop(self, turning: tuple[str, ...], points: np.ndarray, onward: np.ndarray) -> None:
        key = turning[0], libsumo.lane.getEdgeID(turning[-1])
        if key not in self._loops or self._loops[key].lanes != turning:
            way = np.vstack((points, sampled(onward, SAMPLING)[1 : 1 + int(BEHIND_LOOP / SAMPLING)]))
            shapes = [self.shape(name)[:, :2] for name in turning]
            turn = sampled(
                np.vstack((points[:1], shapes[0][-1:], *shapes[1:-1], shapes[-1][:1], points[-1:])), SAMPLING
            )
            share = np.linspace(0.0, len(turn) - 1.0, len(points))
            yaw = np.unwrap(np.arctan2(*np.gradient(turn, axis=0).T[::-1]))
            beside = np.column_stack([np.interp(share, np.arange(len(turn)), of) for of in (*turn.T, yaw)])
            self._loops[key] = Loop(points, turning, beside, way, crossings(points, turning, self.shape))

    @property
    def has_loops(self) -> bool:
        """Whether a path turns back somewhere."""
        return bool(self._loops)

    def loop(self, lane: str, following: str) -> Loop | None:
        """The loop on which paths turn back from a lane to an edge, if they do."""
        return self._loops.get((lane, following))

    def _loosened(self, points: np.ndarray, chain: tuple[str, ...]) -> np.ndarray:
        """The points with room for lanes that go on beside their end."""
        lanes = [name for name in chain if not name.startswith(":")]
        for one, following in itertools.pairwise(lanes):
            before, after = self.shape(one), self.shape(following)
            shift = shift_between(before, after)
            if abs(shift) > SHIFT_LEAST:
                place = 0.5 * (before[-1, :2] + after[0, :2])
                points = loosened(points, place, shift, libsumo.lane.getMaxSpeed(one))
        return points

    def _chain(self, lane: str, route: tuple[str, ...], index: int) -> tuple[str, ...]:
        """Lane ids from the lane before `lane` to the end of the route, or as far as lanes connect."""
        ahead = self._ahead(lane, route, index)
        if lane.startswith(":"):
            return (*self._before_inside(lane, route[index]), *ahead)
        return (*(self._before(lane, route[index - 1]) if index > 0 else ()), *ahead)

    def _ahead(self, lane: str, route: tuple[str, ...], index: int) -> list[str]:
        """The chain that follows the route farthest; of equal ones the one with the fewest turns of lane."""
        chain = [lane]
        if lane.startswith(":"):
            chain += self._through(lane)
            lane = chain[-1]
            edge = libsumo.lane.getEdgeID(lane)
            index = route.index(edge, index) if edge in route[index:] else index
        reach = self._reach(route, index)
        length = libsumo.lane.getLength(lane)
        for following in route[index + 1 :]:
            links = [link for link in libsumo.lane.getLinks(lane) if libsumo.lane.getEdgeID(link[0]) == following]
            if not links or length > HORIZON:
                break
            best = max(links, key=lambda link: reach.get(link[0], 0))
            chain += inside(best[4])
            lane = best[0]
            chain.append(lane)
            length += libsumo.lane.getLength(lane)
        return chain

    def _reach(self, route: tuple[str, ...], index: int) -> dict[str, int]:
        """How many further edges of the route can be followed from each of its lanes, without a lane change."""
        reach: dict[str, int] = {}
        edges = route[index : index + 30]
        for i in range(len(edges) - 1, -1, -1):
            for k in range(libsumo.edge.getLaneNumber(edges[i])):
                lane = f"{edges[i]}_{k}"
                following = [reach[link[0]] + 1 for link in libsumo.lane.getLinks(lane) if link[0] in reach]
                if i + 1 < len(edges):
                    reach[lane] = max(following, default=0)
                else:
                    reach[lane] = 0
        return reach

    def _through(self, internal: str) -> list[str]:
        """What follows a lane inside a junction, up to the lane behind it."""
        links = libsumo.lane.getLinks(internal)
        if not links:
            return []
        return [*inside(links[0][4]), links[0][0]]

    def _before(self, lane: str, edge: str) -> list[str]:
        """The lane of `edge` that leads into `lane`, and the junction between."""
        for k in range(libsumo.edge.getLaneNumber(edge)):
            name = f"{edge}_{k}"
            for link in libsumo.lane.getLinks(name):
                if link[0] == lane:
                    return [name, *inside(link[4])]
        return []

    def _before_inside(self, internal: str, edge: str) -> list[str]:
        """What of `edge` and of the junction behind it leads to a lane inside that junction."""
        for k in range(libsumo.edge.getLaneNumber(edge)):
            for link in libsumo.lane.getLinks(f"{edge}_{k}"):
                lanes = inside(link[4])
                if internal in lanes:
                    return [f"{edge}_{k}", *lanes[: lanes.index(internal)]]
        return []

    def neighbor(self, lane: str, side: int) -> str | None:
        """The lane beside (side +1 left, -1 right) on the same edge, or None."""
        edge, _, index = lane.rpartition("_")
        beside = int(index) + side
        return f"{edge}_{beside}" if 0 <= beside < libsumo.edge.getLaneNumber(edge) else None

    def road(self) -> Road:
        """Lanes outside junctions and the junctions' outlines."""
        lanes = []
        for edge in libsumo.edge.getIDList():
            if edge.startswith(":"):
                continue
            count = libsumo.edge.getLaneNumber(edge)
            for index in range(count):
                name = f"{edge}_{index}"
                lanes.append(Lane(name, edge, index, count, libsumo.lane.getWidth(name), self.shape(name)))
        shapes = [np.array(libsumo.junction.getShape(name)) for name in libsumo.junction.getIDList()]
        return Road(tuple(lanes), tuple(shape[:, :2] for shape in shapes if shape.ndim == 2 and len(shape) > 2))


def _heights(lane: str, line: np.ndarray) -> list[float]:
    """Heights [m] of the points (n, 2) of a lane, which SUMO leaves out of its shape; 0 in a flat network."""
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
    edge, _, index = lane.rpartition("_")
    length = libsumo.lane.getLength(lane)
    places = np.minimum(along * length / max(along[-1], 1e-9), length)  # SUMO has no place that rounds beyond the end
    points = (libsumo.simulation.convert3D(edge, float(place), int(index)) for place in places)
    return [point[2] if len(point) > 2 else 0.0 for point in points]


def _extended(points: np.ndarray) -> np.ndarray:
    """The line with 60 m straight on at its end: the preview looks beyond the end of the route."""
    direction = points[-1, :2] - points[-2, :2]
    end = points[-1].copy()
    end[:2] += 60.0 * direction / max(float(np.hypot(*direction)), 1e-9)
    return np.vstack((points, end))
