"""Density, flow and speed of the whole traffic: one point of a network's fundamental diagram."""

import libsumo

from emran_sumo.world import phantom

PERIOD = 1.0  # s between two looks


class Flow:
    """Means over all lanes outside junctions, from looks at a running simulation.

        k = sum of n / (looks L),   q = sum of n v / (looks L)

    with n vehicles at speed v on lanes of total length L. Source: Edie, "Discussion of traffic stream measurements
    and definitions", 1963, for the area L x time.
    """

    def __init__(self) -> None:
        edge, lane = libsumo.edge, libsumo.lane
        self._edges = [name for name in edge.getIDList() if not name.startswith(":")]
        lanes = (f"{name}_{i}" for name in self._edges for i in range(edge.getLaneNumber(name)))
        self._length = sum(map(lane.getLength, lanes))
        self._looks, self._vehicles, self._speeds = 0, 0.0, 0.0

    def look(self) -> None:
        """Count the vehicles, without phantoms, and add up their speeds."""
        for name in self._edges:
            n = libsumo.edge.getLastStepVehicleNumber(name)
            self._vehicles += n
            self._speeds += n * libsumo.edge.getLastStepMeanSpeed(name)
        for name in libsumo.vehicle.getIDList():
            if name.startswith(phantom.PREFIX):
                self._vehicles -= 1
                self._speeds -= libsumo.vehicle.getSpeed(name)
        self._looks += 1

    def means(self) -> dict[str, float]:
        """Density [1/km per lane], flow [1/h per lane] and mean speed [m/s]; empty before the first look."""
        if not self._looks or self._length <= 0.0:
            return {}
        area = self._looks * self._length
        speed = self._speeds / self._vehicles if self._vehicles > 0 else 0.0
        return {
            "density_measured": 1000.0 * self._vehicles / area,
            "flow": 3600.0 * self._speeds / area,
            "speed_mean": speed,
        }
