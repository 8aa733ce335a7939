"""The traffic around a vehicle, as SUMO's context subscriptions tell it."""

import libsumo
import numpy as np

from emran_sumo.world import phantom
from emran_sumo.world.records import NOBODY, Traffic

DISTANCE = 300.0  # m around the vehicle
Size = tuple[float, float, float]


class Sight:
    """What is read around the vehicles that look."""

    def __init__(self) -> None:
        self._sizes: dict[str, Size] = {}

    def size(self, name: str) -> Size:
        """Length, width and height of a vehicle [m]."""
        found = self._sizes.get(name)
        if found is None:
            vehicle = libsumo.vehicle
            found = (vehicle.getLength(name), vehicle.getWidth(name), vehicle.getHeight(name))
            self._sizes[name] = found
        return found

    def look_from(self, name: str) -> None:
        """Read the traffic around a vehicle from now on."""
        seen = [libsumo.VAR_POSITION, libsumo.VAR_ANGLE, libsumo.VAR_SPEED]
        libsumo.vehicle.subscribeContext(name, libsumo.CMD_GET_VEHICLE_VARIABLE, DISTANCE, seen)

    def close(self, name: str) -> None:
        """Read nothing more around a vehicle: SUMO would look around one that it has no more, and stop."""
        libsumo.vehicle.unsubscribeContext(name, libsumo.CMD_GET_VEHICLE_VARIABLE, DISTANCE)

    def traffic(self, name: str) -> Traffic:
        """Traffic around a vehicle that looks, without itself and the phantoms."""
        seen = libsumo.vehicle.getContextSubscriptionResults(name)
        ids = [other for other in phantom.real(tuple(seen)) if other != name]
        if not ids:
            return NOBODY
        raw = np.array(
            [(*seen[i][libsumo.VAR_POSITION], seen[i][libsumo.VAR_ANGLE], seen[i][libsumo.VAR_SPEED]) for i in ids]
        )
        length, width, height = np.array([self.size(other) for other in ids]).T
        yaw = np.radians(90.0 - raw[:, 2])
        x = raw[:, 0] - 0.5 * length * np.cos(yaw)
        y = raw[:, 1] - 0.5 * length * np.sin(yaw)
        return Traffic(tuple(ids), x, y, yaw, length, width, height, raw[:, 3])
