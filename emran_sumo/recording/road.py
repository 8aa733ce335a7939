"""The road as flat shapes to draw: asphalt triangles, border lines, lane dashes.

Vehicles are recorded without altitude, so the road is drawn without altitude too;
lines lie just above the asphalt.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import rerun as rr

from emran_sumo.recording.colors import ASPHALT, PAINT, SLATE, packed
from emran_sumo.recording.stream import Stream
from emran_sumo.world.records import Road

ASPHALT_LEVEL, LINE_LEVEL = -0.05, 0.02  # m
DASH_LENGTH, DASH_PERIOD = 3.0, 9.0  # m
_MITER_LIMIT = 0.35  # smallest 1 + cos(turn) honored exactly; sharper corners are cut


class RoadShapes(NamedTuple):
    """What is drawn of a road, all in meters.

    vertices: (n, 3); triangles: (k, 3) into vertices; borders: (m, 3) polylines along both sides of an edge;
    dashes: (2, 3) segments between its lanes; centers: (m, 2) polylines, one per edge, for the map;
    bounds: (x_min, y_min, x_max, y_max).
    """

    vertices: np.ndarray
    triangles: np.ndarray
    borders: list[np.ndarray]
    dashes: list[np.ndarray]
    centers: list[np.ndarray]
    bounds: tuple[float, float, float, float]


def road_shapes(road: Road) -> RoadShapes:
    """All shapes of a road; an empty road gives empty shapes and a 100 m square as bounds."""
    vertices, triangles, borders, dashes, centers = [], [], [], [], []
    count = 0
    for lane in road.lanes:
        line = _distinct(lane.shape)
        if len(line) < 2:
            continue
        left, right = offset(line, lane.width / 2), offset(line, -lane.width / 2)
        vertices.append(np.concatenate((left, right)))
        triangles.append(ribbon(len(line)) + count)
        count += 2 * len(line)
        if lane.index == 0:
            borders.append(_raised(right, LINE_LEVEL))
        else:
            dashes.extend(_dashed(right))
        if lane.index == lane.count - 1:
            borders.append(_raised(left, LINE_LEVEL))
        if lane.index == lane.count // 2:
            centers.append(line)
    for polygon in road.junctions:
        corners = _distinct(polygon)
        cut = triangulated(corners)
        if len(cut):
            vertices.append(corners)
            triangles.append(cut + count)
            count += len(corners)
    if not vertices:
        nothing = np.zeros((0, 3))
        return RoadShapes(nothing, nothing.astype(np.uint32), [], [], [], (-50.0, -50.0, 50.0, 50.0))
    flat = np.concatenate(vertices)
    (x_min, y_min), (x_max, y_max) = flat.min(axis=0), flat.max(axis=0)
    return RoadShapes(
        _raised(flat, ASPHALT_LEVEL),
        np.concatenate(triangles).astype(np.uint32),
        borders,
        dashes,
        centers,
        (float(x_min), float(y_min), float(x_max), float(y_max)),
    )


def draw_road(stream: Stream, shapes: RoadShapes) -> None:
    """Log the shapes once, under /world/road for the scene and /world/map for the map."""
    if not len(shapes.triangles):
        return
    asphalt, paint, gray = packed((ASPHALT, PAINT, SLATE))
    surface = rr.Mesh3D(
        vertex_positions=shapes.vertices,
        triangle_indices=shapes.triangles,
        vertex_normals=np.broadcast_to(np.array([0.0, 0.0, 1.0], dtype=np.float32), shapes.vertices.shape),
        albedo_factor=int(asphalt),
    )
    stream.static("/world/road/surface", surface)
    for entity, lines, color, radius in (
        ("/world/road/borders", shapes.borders, paint, 0.1),
        ("/world/road/dashes", shapes.dashes, paint, 0.08),
        ("/world/map/road", [_raised(line, 0.0) for line in shapes.centers], gray, rr.Radius.ui_points(1.2)),
    ):
        if lines:
            if len({len(line) for line in lines}) == 1:
                lines = np.stack(lines)  # as one array, Rerun takes thousands of dashes at once
            stream.static(entity, rr.LineStrips3D(lines, radii=radius, colors=[color]))


def offset(line: np.ndarray, distance: float) -> np.ndarray:
    """Parallel `distance` [m] to the left of an (n, 2) polyline of distinct points, mitered at corners."""
    steps = np.diff(line, axis=0)
    normals = np.column_stack((-steps[:, 1], steps[:, 0])) / np.hypot(steps[:, 0], steps[:, 1])[:, None]
    before, after = np.vstack((normals[:1], normals)), np.vstack((normals, normals[-1:]))
    turn = np.maximum(1.0 + np.sum(before * after, axis=1), _MITER_LIMIT)
    return line + distance * (before + after) / turn[:, None]


def triangulated(polygon: np.ndarray) -> np.ndarray:
    """(k, 3) corner indices that fill a simple (n, 2) polygon, concave ones too, by clipping ears."""
    index = list(range(len(polygon)))
    if len(index) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    x, y = polygon[:, 0], polygon[:, 1]
    if np.dot(x, np.roll(y, -1)) < np.dot(y, np.roll(x, -1)):
        index.reverse()
    triangles = []
    while len(index) > 3:
        ear = next((i for i in range(len(index)) if _is_ear(polygon, index, i)), 0)
        triangles.append((index[ear - 1], index[ear], index[(ear + 1) % len(index)]))
        del index[ear]
    triangles.append(tuple(index))
    return np.array(triangles, dtype=np.int64)


def _is_ear(polygon: np.ndarray, index: list[int], i: int) -> bool:
    a, b, c = (polygon[index[(i + k) % len(index)]] for k in (-1, 0, 1))
    if _cross(b - a, c - b) < 0.0:
        return False
    kept = {index[(i + k) % len(index)] for k in (-1, 0, 1)}
    others = polygon[[k for k in index if k not in kept]]
    inside = (_cross(b - a, others - a) > 0) & (_cross(c - b, others - b) > 0) & (_cross(a - c, others - c) > 0)
    return not inside.any()


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def ribbon(n: int) -> np.ndarray:
    """(2 n - 2, 3) triangles between n points on the left, which come first, and n on the right."""
    left = np.arange(n - 1)
    right = left + n
    return np.concatenate((np.column_stack((right, right + 1, left)), np.column_stack((left, right + 1, left + 1))))


def _dashed(line: np.ndarray) -> Iterable[np.ndarray]:
    steps = np.diff(line, axis=0)
    along = np.concatenate(([0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))))
    starts = np.arange(DASH_PERIOD / 2 - DASH_LENGTH / 2, along[-1] - DASH_LENGTH, DASH_PERIOD)
    ends = np.column_stack((starts, starts + DASH_LENGTH))
    x, y = np.interp(ends, along, line[:, 0]), np.interp(ends, along, line[:, 1])
    return np.stack((x, y, np.full_like(x, LINE_LEVEL)), axis=-1)


def _distinct(points: np.ndarray) -> np.ndarray:
    """The (n, 2) points in the plane, without points that repeat the one before."""
    flat = np.asarray(points, dtype=float)[:, :2]
    if len(flat) < 2:
        return flat
    return flat[np.concatenate(([True], np.abs(np.diff(flat, axis=0)).max(axis=1) > 1e-3))]


def _raised(points: np.ndarray, level: float) -> np.ndarray:
    return np.column_stack((points, np.full(len(points), level)))
