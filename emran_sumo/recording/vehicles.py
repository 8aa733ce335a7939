"""Everybody else: boxes colored by speed, and the other egos of the run, each with its id."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from emran_sumo.recording.colors import COMPANION, packed, speed_colors
from emran_sumo.recording.stream import Stream, turns
from emran_sumo.world.records import Traffic

TRAFFIC, EGOS = "/world/traffic", "/world/traffic/egos"
# Positions are rounded to 1/64 m, turns to 1/4096: invisible, and a fifth smaller.
_GRID, _TURN = 64.0, 4096.0


class Vehicles:
    """Sends the traffic of a chunk at a time."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._company = False  # whether there ever was another ego
        stream.static(TRAFFIC, rr.Boxes3D.from_fields(fill_mode="solid", show_labels=False))
        stream.static(EGOS, rr.Boxes3D.from_fields(fill_mode="solid", colors=packed([COMPANION]), show_labels=True))

    def send(self, times: np.ndarray, instants: Sequence[tuple[Traffic, frozenset[str]]]) -> None:
        """Send the traffic at `times` (n,) [ms], and at each the ids of those in it that are egos too."""
        counts = [len(traffic.ids) for traffic, _ in instants]
        is_ego = np.array([name in egos for traffic, egos in instants for name in traffic.ids], dtype=bool)
        numbers = np.array([np.concatenate(column) for column in zip(*(t[1:] for t, _ in instants), strict=True)])
        company = _per_instant(is_ego, counts)
        plain = numbers[:, ~is_ego]
        centers, halves, turned = _boxes(plain)
        colors = speed_colors(plain[-1])
        columns = rr.Boxes3D.columns(centers=centers, half_sizes=halves, quaternions=turned, colors=colors)
        self._stream.send(TRAFFIC, times, columns.partition(counts - company))
        if self._company or is_ego.any():
            self._company = True
            centers, halves, turned = _boxes(numbers[:, is_ego])
            names = [name for traffic, egos in instants for name in traffic.ids if name in egos]
            columns = rr.Boxes3D.columns(centers=centers, half_sizes=halves, quaternions=turned, labels=names)
            self._stream.send(EGOS, times, columns.partition(company))


def _per_instant(flags: np.ndarray, counts: Sequence[int]) -> np.ndarray:
    """(n,) how many of the flags, `counts` of which belong to each of n instants, are set."""
    ends = np.concatenate(([0], np.cumsum(counts)))
    return np.diff(np.concatenate(([0], np.cumsum(flags)))[ends])


def _boxes(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (n, 3), half sizes (n, 3) and quaternions (n, 4) of x, y, yaw, length, width, height and speed (7, n)."""
    x, y, yaw, length, width, height, _ = numbers
    centers = np.column_stack((np.rint(x * _GRID) / _GRID, np.rint(y * _GRID) / _GRID, height / 2))
    halves = np.column_stack((length, width, height)) / 2
    return centers.astype(np.float32), halves.astype(np.float32), np.rint(turns(yaw) * _TURN) / np.float32(_TURN)
