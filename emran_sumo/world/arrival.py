"""Where the route of an ego ends, and whether it is there."""

import xml.etree.ElementTree as ET
from pathlib import Path

import libsumo

from emran_sumo.world.files import content

ROOM = 2.0  # steps before the arrival position: SUMO removes no vehicle that is moved from outside
LEAST_ROOM = 1.0  # m
KINDS = {"vehicle", "trip", "flow"}


class Arrivals:
    """Positions where vehicles arrive, as their declarations have them: SUMO does not tell."""

    def __init__(self) -> None:
        self._declared: dict[str, str] | None = None

    def is_there(self, ego: str, step: float) -> bool:
        """Whether the ego is at the end of its route: SUMO itself removes no vehicle that is moved from outside."""
        vehicle = libsumo.vehicle
        route = vehicle.getRoute(ego)
        if vehicle.getRoadID(ego) != route[-1] or vehicle.getRouteIndex(ego) < len(route) - 1:
            return False
        if vehicle.getStops(ego, 1):  # a stop that is still to be made comes first
            return False
        end = self._position(ego, libsumo.lane.getLength(vehicle.getLaneID(ego)))
        return vehicle.getLanePosition(ego) > end - max(ROOM * vehicle.getSpeed(ego) * step, LEAST_ROOM)

    def _position(self, ego: str, length: float) -> float:
        """Where on its last lane it arrives [m]; a negative declaration counts from the lane's end."""
        if self._declared is None:
            self._declared = _declared()
        flow = ego.rpartition(".")[0]
        text = self._declared.get(ego, self._declared.get(flow, "max"))
        if text == "center":
            return 0.5 * length
        try:
            position = float(text)
        except ValueError:  # "max", and "random", which nobody knows
            return length
        return min(max(position + length if position < 0.0 else position, 0.0), length)


def _declared() -> dict[str, str]:
    """Arrival positions in SUMO's route and additional files."""
    found: dict[str, str] = {}
    for option in ("route-files", "additional-files"):
        for name in libsumo.simulation.getOption(option).split(","):
            try:
                data = content(Path(name.strip()))
                root = ET.fromstring(data) if b"arrivalPos" in data else ET.Element("none")
            except (OSError, EOFError, ET.ParseError):
                continue  # SUMO has read it
            for element in root.iter():
                if element.tag in KINDS and element.get("arrivalPos"):
                    found[element.get("id", "")] = element.get("arrivalPos", "")
    return found
