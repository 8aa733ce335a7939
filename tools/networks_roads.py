"""The shipped networks: motorway, hills, curves and bridge from alignments; urban streets; a generated town."""

from typing import NamedTuple

import numpy as np
from networks_geometry import alignment, curve, height, offset, samples

LANE_WIDTH = 3.5  # [m]
OPTIONS = ("--precision", "4", "--offset.disable-normalization", "true", "--no-turnarounds", "true",
           "--rectangular-lane-cut", "true", "--junctions.corner-detail", "0")  # fmt: skip

Link = tuple[str, str, int, int]  # from edge, to edge, from lane, to lane


class Edge(NamedTuple):
    """One edge of a network; `left_border` (n, 2 or 3) is the left edge of its leftmost lane [m]."""

    start: str
    end: str
    lanes: int
    speed: float
    left_border: np.ndarray
    priority: int
    width: float = LANE_WIDTH


class Network(NamedTuple):
    """Edges by id, all connections (None: netconvert's own), options of netconvert, attributes of its nodes."""

    edges: dict[str, Edge]
    connections: list[Link] | None = None
    options: tuple[str, ...] = OPTIONS
    nodes: dict[str, dict[str, str]] = {}  # noqa: RUF012  node id -> attributes other than type="priority"


def _straight(*steps: Link, lanes: int = 3) -> list[Link]:
    """Connections of `lanes` lanes side by side from each first to each second edge."""
    return [(a, b, i + lane, j + lane) for a, b, i, j in steps for lane in range(lanes)]


# The center line of the middle main lane, 5 km. The ramps join and leave on straights.
HIGHWAY = alignment(
    [
        *((300.0, 0.0), *curve(900.0, 150.0, 250.0), (150.0, 0.0), *curve(-750.0, 120.0, 250.0)),  # 1490 m
        *((450.0, 0.0), *curve(700.0, 150.0, 200.0), (380.0, 0.0), *curve(-800.0, 160.0, 300.0)),  # 3440 m
        *(*curve(1000.0, 160.0, 300.0), (340.0, 0.0), *curve(-900.0, 150.0, 200.0), (100.0, 0.0)),  # 5000 m
    ]
)
HIGHWAY_NODES = {"west": 0.0, "merge_start": 2500.0, "merge_end": 2780.0, "diverge_start": 4080.0,
                 "diverge_end": 4360.0, "east": 5000.0}  # fmt: skip
RAMP_LENGTH = 350.0  # [m] along the main line
RAMP_AWAY = 30.0  # [m] sideways from the lane it joins to its far end


def highway() -> Network:
    """Three lanes with an on-ramp and an off-ramp."""
    at = HIGHWAY_NODES
    border = 1.5 * LANE_WIDTH
    edges = {}
    for name, start, end, lanes in (
        ("main_in", "west", "merge_start", 3),
        ("merge", "merge_start", "merge_end", 4),
        ("main_mid", "merge_end", "diverge_start", 3),
        ("diverge", "diverge_start", "diverge_end", 4),
        ("main_out", "diverge_end", "east", 3),
    ):
        left = offset(HIGHWAY, samples(at[start], at[end]), border)
        edges[name] = Edge(start, end, lanes, 33.33, left, 2)
    # A ramp is the main line moved sideways by a quintic step: where it meets the fourth lane it agrees in
    # position, heading and curvature. Its left border is the right border of the three main lanes there.
    u = np.linspace(0.0, 1.0, len(samples(0.0, RAMP_LENGTH)))
    away = -border - RAMP_AWAY * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    join, leave = at["merge_start"], at["diverge_end"]
    on = offset(HIGHWAY, samples(join - RAMP_LENGTH, join), away[::-1])
    off = offset(HIGHWAY, samples(leave, leave + RAMP_LENGTH), away)
    edges["on_ramp"] = Edge("on_ramp_start", "merge_start", 1, 22.22, on, 1)
    edges["off_ramp"] = Edge("diverge_end", "off_ramp_end", 1, 22.22, off, 1)
    main = _straight(
        *(("main_in", "merge", 0, 1), ("merge", "main_mid", 1, 0)),
        *(("main_mid", "diverge", 0, 1), ("diverge", "main_out", 1, 0)),
    )
    return Network(edges, [*main, ("on_ramp", "merge", 0, 0), ("diverge", "off_ramp", 0, 0)])


# 4.2 km; wide curves, so that the hills are what is felt
HILLS = alignment(
    [
        *((600.0, 0.0), *curve(1500.0, 200.0, 300.0), (500.0, 0.0), *curve(-1200.0, 200.0, 300.0)),  # 2500 m
        *((500.0, 0.0), *curve(1400.0, 200.0, 300.0), (500.0, 0.0)),  # 4200 m
    ]
)
# a climb, a crest, a descent, a sag, a shorter climb and descent; the vertical curves have radii of 5300 to 7500 m
HILLS_GRADES = [
    *((350.0, 0.0), (300.0, 0.05), (350.0, 0.05), (600.0, -0.055), (300.0, -0.055)),  # 1900 m
    *((500.0, 0.04), (300.0, 0.04), (450.0, -0.03), (250.0, -0.03), (200.0, 0.0), (600.0, 0.0)),  # 4200 m
]
HILLS_LIMITS = ((0.0, 28.0), (2000.0, 25.0), (4200.0, 0.0))  # from where on which limit [m, m/s]


def hills() -> Network:
    """Three lanes over hills, with a lower limit from halfway down the longest descent on."""
    edges = {}
    nodes = ("west", "limit", "east")
    for k, name in enumerate(("fast", "slow")):
        s = samples(HILLS_LIMITS[k][0], HILLS_LIMITS[k + 1][0])
        left = np.column_stack((offset(HILLS, s, 1.5 * LANE_WIDTH), height(HILLS_GRADES, s)))
        edges[name] = Edge(nodes[k], nodes[k + 1], 3, HILLS_LIMITS[k][1], left, 2)
    return Network(edges, _straight(("fast", "slow", 0, 0)))


# 2330 m of center line; the radii are those of the line between the two lanes
CURVES = alignment(
    [
        *((350.0, 0.0), *curve(250.0, 70.0, 120.0), (60.0, 0.0), *curve(-150.0, 60.0, 100.0), (40.0, 0.0)),  # 930 m
        *(*curve(100.0, 50.0, 90.0), (80.0, 0.0), *curve(-60.0, 40.0, 60.0), (30.0, 0.0)),  # 1370 m
        *(*curve(80.0, 45.0, 70.0), (100.0, 0.0), *curve(-120.0, 55.0, 100.0), (50.0, 0.0)),  # 1890 m
        *(*curve(180.0, 60.0, 120.0), (200.0, 0.0)),  # 2330 m
    ]
)
CURVES_SAMPLING = 2.5  # [m]; an arc of radius 60 m deviates 1.3 cm from its chord


def curves() -> Network:
    """A country road, one lane each way."""
    line = offset(CURVES, samples(0.0, float(CURVES.station[-1]), CURVES_SAMPLING), 0.0)
    return Network(
        {
            "east": Edge("start", "end", 1, 22.22, line, 1),
            "west": Edge("end", "start", 1, 22.22, line[::-1], 1),
        },
        [],
    )


BRIDGE_NODES = {"west": 0.0, "bridge_start": 900.0, "bridge_end": 2300.0, "east": 3000.0}


def bridge() -> Network:
    """Three straight lanes, of which the middle edge is the bridge."""
    x = list(BRIDGE_NODES.values())
    ids = list(BRIDGE_NODES)
    edges = {}
    for k, name in enumerate(("approach", "bridge", "beyond")):
        left = np.array([(x[k], 1.5 * LANE_WIDTH), (x[k + 1], 1.5 * LANE_WIDTH)])
        edges[name] = Edge(ids[k], ids[k + 1], 3, 25.0, left, 2)
    return Network(edges, _straight(("approach", "bridge", 0, 0), ("bridge", "beyond", 0, 0)))
