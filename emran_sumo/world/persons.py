"""The persons who walk around an ego: bodies that it can touch, and no traffic that it follows."""

import libsumo
import numpy as np

from emran_sumo.world.records import NOBODY, Traffic

SHOWN = 100.0  # m around the ego in which persons are drawn
ON_WALKING_AREA = " on a walking area"  # at the corners of junctions, over which SUMO's cars turn whoever walks there


class Persons:
    """Who walks in the running simulation.

    Who waits stands at a place beside the lane that SUMO makes up for it, and who rides is inside a vehicle: neither is
    on the road.
    """

    def __init__(self) -> None:
        self._time = -1.0
        self._ids: tuple[str, ...] = ()
        self._places = np.zeros((0, 2))
        self._sizes: dict[str, tuple[float, float, float]] = {}
        self._stages: dict[str, tuple[int, bool]] = {}  # stages left, whether the present one is a walk

    def around(self, x: float, y: float, distance: float) -> Traffic:
        """Persons within a distance [m] east or west and north or south of a place, each named "person <id>".

        At corners of junctions ON_WALKING_AREA is added.
        """
        if not libsumo.person.getIDCount():
            return NOBODY
        self._look()
        near = np.flatnonzero(np.abs(self._places - (x, y)).max(axis=1) < distance)
        found = [(k, name) for k in near if self._walks(name := self._ids[k])]
        if not found:
            return NOBODY
        person = libsumo.person
        places = self._places[[k for k, _ in found]]
        yaw, speed = np.array([(person.getAngle(name), person.getSpeed(name)) for _, name in found]).T
        length, width, height = np.array([self._size(name) for _, name in found]).T
        yaw = np.radians(90.0 - yaw)
        # as of a vehicle, the place is that of the front
        x_center, y_center = places[:, 0] - 0.5 * length * np.cos(yaw), places[:, 1] - 0.5 * length * np.sin(yaw)
        names = tuple(f"person {name}{ON_WALKING_AREA if _is_at_corner(name) else ''}" for _, name in found)
        return Traffic(names, x_center, y_center, yaw, length, width, height, speed)

    def _look(self) -> None:
        """Where everybody is, once per step for all egos."""
        time = libsumo.simulation.getTime()
        if time != self._time:
            self._time, self._ids = time, libsumo.person.getIDList()
            self._places = np.array([libsumo.person.getPosition(name) for name in self._ids]).reshape(-1, 2)

    def _walks(self, name: str) -> bool:
        left = libsumo.person.getRemainingStages(name)  # far cheaper than the stage itself
        stage = self._stages.get(name)
        if stage is None or stage[0] != left:
            stage = self._stages[name] = left, libsumo.person.getStage(name).type == libsumo.STAGE_WALKING
        return stage[1]

    def _size(self, name: str) -> tuple[float, float, float]:
        found = self._sizes.get(name)
        if found is None:
            kind = libsumo.person.getTypeID(name)
            of = libsumo.vehicletype
            found = self._sizes[name] = of.getLength(kind), of.getWidth(kind), of.getHeight(kind)
        return found


def _is_at_corner(name: str) -> bool:
    junction, _, part = libsumo.person.getRoadID(name).rpartition("_")
    return junction.startswith(":") and part.startswith("w")


def joined(vehicles: Traffic, persons: Traffic) -> Traffic:
    """Vehicles and persons as one, for the picture."""
    if not persons.ids:
        return vehicles
    columns = (np.concatenate(pair) for pair in zip(vehicles[1:], persons[1:], strict=True))
    return Traffic(vehicles.ids + persons.ids, *columns)
