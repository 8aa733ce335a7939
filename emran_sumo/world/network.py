"""Lanes and speed limits of a SUMO network file, read without SUMO."""

import gzip
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple


class Piece(NamedTuple):
    """One lane of a chain along the main line; `start` is its arc length along the chain [m]."""

    edge: str
    lane: int
    start: float
    length: float


def main_limit(network_file: Path) -> float:
    """Highest speed limit of the network [m/s]."""
    return max((float(lane.get("speed", 0.0)) for lane in _read(network_file).iter("lane")), default=0.0)


def main_lanes(network_file: Path, edges: Sequence[str]) -> list[tuple[Piece, ...]]:
    """Chains of connected lanes along `edges`, one for each lane of the first edge, rightmost first.

    Raises:
        ValueError: the first edge is not in the network.
    """
    net = _read(network_file)
    length = {lane.get("id", ""): float(lane.get("length", 0.0)) for lane in net.iter("lane")}
    follow = _connections(net, length)
    chains = []
    while f"{edges[0]}_{len(chains)}" in length:
        chains.append(_chain(len(chains), edges, length, follow))
    if not chains:
        raise ValueError(f'found the edge "{edges[0]}", which is not in the network')
    return chains


_Connections = dict[tuple[str | None, int, str | None], tuple[int, float]]


def _connections(net: ET.Element, length: dict[str, float]) -> _Connections:
    """(edge, lane, next edge) -> (lane on the next edge, length of the junction's lane between [m])."""
    follow: _Connections = {}
    for c in net.iter("connection"):
        key = (c.get("from"), int(c.get("fromLane", 0)), c.get("to"))
        follow.setdefault(key, (int(c.get("toLane", 0)), length.get(c.get("via", ""), 0.0)))
    return follow


def _chain(lane: int, edges: Sequence[str], length: dict[str, float], follow: _Connections) -> tuple[Piece, ...]:
    """Lanes from `lane` of the first edge on, as far along `edges` as they connect."""
    chain: list[Piece] = []
    start = 0.0
    for edge, following in zip(edges, [*edges[1:], ""], strict=True):
        chain.append(Piece(edge, lane, start, length[f"{edge}_{lane}"]))
        if (edge, lane, following) not in follow:
            break
        lane, inside = follow[edge, lane, following]
        start += chain[-1].length + inside
    return tuple(chain)


def _read(network_file: Path) -> ET.Element:
    """Root of a network file, plain or .gz."""
    opened = gzip.open if Path(network_file).suffix == ".gz" else open
    with opened(network_file, "rb") as stream:
        return ET.parse(stream).getroot()
