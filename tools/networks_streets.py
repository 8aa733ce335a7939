"""The shipped networks with streets: a few hand-made blocks with signals, and a town that netgenerate draws."""

import itertools

import numpy as np
from networks_roads import Edge, Network

STREET_WIDTH = 3.25  # [m]
STREET_SPEED = 13.89  # [m/s]
TURN_LATERAL = "3"  # [m/s2] that limits the speed of a turn on a junction: what drivers accept, not the car
URBAN_OPTIONS = ("--precision", "3", "--offset.disable-normalization", "true", "--no-turnarounds", "true",
                 "--junctions.corner-detail", "5", "--junctions.internal-link-detail", "20",
                 "--junctions.limit-turn-speed", TURN_LATERAL, "--tls.cycle.time", "60",
                 "--tls.allred.time", "3")  # fmt: skip
TURN_RADIUS = "10"  # [m] of the curb at a corner
WAITING_WIDTH = "2.6"  # [m] that who waits inside a junction leaves to those who cross: a van, and 0.3 m on each side

COLUMNS = {"a": 0.0, "b": 200.0, "c": 400.0, "d": 600.0}  # x of the streets from south to north [m]
ROWS = {"1": 0.0, "2": 180.0, "3": 360.0}  # y of the streets from west to east; row 2 is the main road [m]
OUTSIDE = 150.0  # [m] of street beyond the outermost junctions
SIGNALS = {"b2": "static", "c2": "actuated"}


def urban() -> Network:
    """Four streets cross three; the main road in the middle has two lanes each way, and two signals.

    Streets that run from north to south have priority over the others, and the main road over all.
    """
    places = {c + r: (x, y) for c, x in COLUMNS.items() for r, y in ROWS.items()}
    x, y = list(COLUMNS.values()), list(ROWS.values())
    places |= {f"west{r}": (x[0] - OUTSIDE, v) for r, v in ROWS.items()}
    places |= {f"east{r}": (x[-1] + OUTSIDE, v) for r, v in ROWS.items()}
    places |= {f"south_{c}": (v, y[0] - OUTSIDE) for c, v in COLUMNS.items()}
    places |= {f"north_{c}": (v, y[-1] + OUTSIDE) for c, v in COLUMNS.items()}
    edges = {}
    for r in ROWS:
        _street(edges, places, [f"west{r}", *(c + r for c in COLUMNS), f"east{r}"], r == "2", 3 if r == "2" else 1)
    for c in COLUMNS:
        _street(edges, places, [f"south_{c}", *(c + r for r in ROWS), f"north_{c}"], False, 2)
    nodes = {c + r: {"radius": TURN_RADIUS} for c in COLUMNS for r in ROWS}
    for name, kind in SIGNALS.items():
        nodes[name] |= {"type": "traffic_light", "tlType": kind}
    return Network(edges, None, URBAN_OPTIONS, nodes)


def _street(
    edges: dict[str, Edge], places: dict[str, tuple[float, float]], names: list[str], main: bool, priority: int
) -> None:
    """Add both directions of a street through the named nodes; an edge from a1 to b1 is called a1.b1."""
    for a, b in itertools.pairwise(names):
        for start, end in ((a, b), (b, a)):
            line = np.array([places[start], places[end]])
            lanes = 2 if main else 1
            edges[f"{start}.{end}"] = Edge(start, end, lanes, STREET_SPEED, line, priority, STREET_WIDTH)


# a grid whose junctions are moved at random; of the first seeds the one whose tightest turn is widest (7 m)
TOWN_SIGNALS = ",".join(column + row for column in "BCDEF" for row in "1234")  # all but the outermost junctions
TOWN = ("--grid", "--grid.x-number", "7", "--grid.y-number", "6", "--grid.length", "270", "--grid.attach-length", "120",
        "--perturb-x", "normc(0,10,-18,18)", "--perturb-y", "normc(0,10,-18,18)", "--seed", "6",
        "--default.speed", "13.89", "--default.lanewidth", "3.25", "--default-junction-type", "priority",
        "--default.junctions.radius", "11", "--junctions.small-radius", "10",
        "--tls.set", TOWN_SIGNALS, "--tls.default-type", "actuated", "--tls.cycle.time", "60", "--tls.allred.time", "3",
        "--junctions.internal-link-detail", "10", "--junctions.corner-detail", "3",
        "--junctions.limit-turn-speed", TURN_LATERAL, "--no-turnarounds", "true",
        "--internal-junctions.vehicle-width", WAITING_WIDTH,
        "--offset.disable-normalization", "true", "--precision", "2")  # fmt: skip
