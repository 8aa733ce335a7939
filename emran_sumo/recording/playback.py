"""Reading the scene of a recorded run back, for pictures of our own."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from emran_sumo.recording.layout import TIMELINE


class Scene(NamedTuple):
    """Road and traffic of a run in the plane.

    triangles: (k, 3, 2) corners of the asphalt [m]; lines: (m, 2) points [m] of borders and dashes;
    times: (n,) instants [ms] of the traffic; traffic: per instant (v, 5) of x, y [m], yaw [rad], length, width [m].
    """

    triangles: np.ndarray
    lines: list[np.ndarray]
    times: np.ndarray
    traffic: list[np.ndarray]


def read_scene(file: Path) -> Scene:
    """What a run's file shows besides its ego; also of a run that was killed."""
    triangles, lines = [np.zeros((0, 3, 2))], []
    for chunk in RrdReader(str(file)).stream().filter(content="/world/road/**"):
        batch = chunk.to_record_batch()
        if "Mesh3D:vertex_positions" in batch.schema.names:
            corners = _rows(batch.column("Mesh3D:vertex_positions"), 3)[:, :2]
            indices = _rows(batch.column("Mesh3D:triangle_indices"), 3).astype(np.int64)
            triangles.append(corners[indices])
        if "LineStrips3D:strips" in batch.schema.names:
            strips = batch.column("LineStrips3D:strips").flatten()
            ends = np.diff(strips.offsets).cumsum()
            lines += np.split(_rows(strips, 3)[:, :2], ends[:-1])
    return Scene(np.concatenate(triangles), lines, *_traffic(file))


def _traffic(file: Path) -> tuple[np.ndarray, list[np.ndarray]]:
    found: dict[int, list[np.ndarray]] = {}
    stream = RrdReader(str(file)).stream().filter(content="/world/traffic/**", has_timeline=TIMELINE)
    for chunk in stream:
        batch = chunk.to_record_batch()
        if "Boxes3D:centers" not in batch.schema.names:
            continue
        centers = batch.column("Boxes3D:centers")
        halves = _rows(batch.column("Boxes3D:half_sizes"), 3)
        turns = _rows(batch.column("Boxes3D:quaternions"), 4)
        boxes = np.column_stack(
            (_rows(centers, 3)[:, :2], 2.0 * np.arctan2(turns[:, 2], turns[:, 3]), 2.0 * halves[:, :2])
        )
        ends = np.diff(centers.offsets).cumsum()
        times = batch.column(TIMELINE).cast("int64").to_numpy() // 1_000_000
        for time, then in zip(times.tolist(), np.split(boxes, ends[:-1]), strict=True):
            found.setdefault(time, []).append(then)
    times = sorted(found)
    return np.array(times, dtype=np.int64), [np.concatenate(found[time]) for time in times]


def _rows(column: pa.Array, width: int) -> np.ndarray:
    """(n, width) numbers of a column of lists, however deep."""
    while pa.types.is_nested(column.type):
        column = column.flatten()
    return column.to_numpy(zero_copy_only=False).reshape(-1, width)
