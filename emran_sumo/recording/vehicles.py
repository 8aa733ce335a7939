"""Everybody else: boxes colored by speed, and the other egos of the run, each with its id."""

from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from emran_sumo.recording.colors import COMPANION, packed, speed_colors
from emran_sumo.recording.stream import Stream, turns
from emran_sumo.world.records import Traffic

TRAFFIC, EGOS = "/world/traffic", "/world/traffic/egos"
# Positions are rounded to 1/64 m, turns to 1/4096: invisible, and a fifth smaller.
_GRID, _TURN = 64.0, 4096.0


class Seen(NamedTuple):
    """Traffic at one instant: numbers (7, n) as in Traffic, which of them are egos (n,), and their ids."""

    numbers: np.ndarray
    egos: np.ndarray
    ids: tuple[str, ...]


def seen(traffic: Traffic, egos: Container[str]) -> Seen:
    """A copy of the traffic, with those told apart that are egos too."""
    flags = np.array([name in egos for name in traffic.ids], dtype=bool)
    ids = tuple(name for name, is_ego in zip(traffic.ids, flags, strict=True) if is_ego)
    return Seen(np.array(traffic[1:], dtype=np.float64), flags, ids)


class Vehicles:
    """Sends the traffic of a chunk at a time."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._company = False  # whether there ever was another ego
        stream.static(TRAFFIC, rr.Boxes3D.from_fields(fill_mode="solid", show_labels=False))
        stream.static(EGOS, rr.Boxes3D.from_fields(fill_mode="solid", colors=packed([COMPANION]), show_labels=True))

    def send(self, times: np.ndarray, instants: Sequence[Seen]) -> None:
        """Send the instants at `times` (n,) [ms]."""
        plain = [one.numbers[:, ~one.egos] for one in instants]
        *_, speed = np.concatenate(plain, axis=1)
        centers, halves, turned = _boxes(plain)
        columns = rr.Boxes3D.columns(centers=centers, half_sizes=halves, quaternions=turned, colors=speed_colors(speed))
        self._stream.send(TRAFFIC, times, columns.partition([part.shape[1] for part in plain]))
        if self._company or any(one.ids for one in instants):
            self._company = True
            egos = [one.numbers[:, one.egos] for one in instants]
            centers, halves, turned = _boxes(egos)
            names = [name for one in instants for name in one.ids]
            columns = rr.Boxes3D.columns(centers=centers, half_sizes=halves, quaternions=turned, labels=names)
            self._stream.send(EGOS, times, columns.partition([len(one.ids) for one in instants]))


def _boxes(instants: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centers (n, 3), half sizes (n, 3) and quaternions (n, 4) of all instants in a row."""
    x, y, yaw, length, width, height, _ = np.concatenate(instants, axis=1)
    centers = np.column_stack((np.rint(x * _GRID) / _GRID, np.rint(y * _GRID) / _GRID, height / 2))
    halves = np.column_stack((length, width, height)) / 2
    return centers.astype(np.float32), halves.astype(np.float32), np.rint(turns(yaw) * _TURN) / np.float32(_TURN)
