"""The traffic of the shipped town: random trips from SUMO's own randomTrips.py with a fixed seed."""

import importlib.util
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

OPTIONS = ("--seed", "6", "--min-distance", "500", "--remove-loops", "--random-routing-factor", "2")
# 300 vehicles within 20 s, then nearly as many as arrive
INTERVALS = (
    ("--prefix", "first.", "--begin", "0", "--end", "20", "--period", "0.066"),
    ("--prefix", "later.", "--begin", "20", "--end", "170", "--period", "1.2"),
)


def write_trips(network: Path, file: Path) -> None:
    """Write vehicles of the type "traffic" with their routes through the network, in the order of departure.

    Raises:
        CalledProcessError: randomTrips.py refuses the network.
        FileNotFoundError: SUMO's tools are not installed for the running Python.
    """
    home = _sumo_home()
    head = "; then ".join(" ".join((*OPTIONS, *interval)).replace("--", "") for interval in INTERVALS)
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f"<!-- tools/build_networks, randomTrips.py: {head} -->"]
    lines += ["<routes>"]
    with tempfile.TemporaryDirectory() as scratch:
        for interval in INTERVALS:
            trips, routes = Path(scratch) / "trips.xml", Path(scratch) / "routes.xml"
            subprocess.run(
                [sys.executable, home / "tools" / "randomTrips.py", "--net-file", network.resolve(), *OPTIONS, *interval,
                 "--output-trip-file", trips, "--route-file", routes],
                check=True, stdout=subprocess.DEVNULL, env=os.environ | {"SUMO_HOME": str(home)}, cwd=scratch,
            )  # fmt: skip
            lines += [_vehicle(v) for v in ET.parse(routes).getroot().iter("vehicle")]
    file.write_text("\n".join([*lines, "</routes>", ""]), encoding="utf-8")


def _vehicle(vehicle: ET.Element) -> str:
    route = vehicle.find("route")
    assert route is not None
    attributes = f'id="{vehicle.get("id")}" type="traffic" depart="{vehicle.get("depart")}"'
    attributes += ' departLane="best" departPos="random_free" departSpeed="max"'
    return f'    <vehicle {attributes}><route edges="{route.get("edges")}"/></vehicle>'


def _sumo_home() -> Path:
    """Folder of SUMO's tools: of the package eclipse-sumo, or what SUMO_HOME says."""
    package = importlib.util.find_spec("sumo")
    places = list(package.submodule_search_locations or ()) if package else []
    for place in [*places, os.environ.get("SUMO_HOME", "")]:
        if place and (Path(place) / "tools" / "randomTrips.py").is_file():
            return Path(place)
    raise FileNotFoundError("randomTrips.py is missing: install it with `pip install 'eclipse-sumo==1.28.*'`.")
