"""Where an ego stops on its way."""

import libsumo

PARKS = 1  # bit of a stop's flags


def keep_on_lane(ego: str) -> None:
    """Let the stops beside the road be made on the lane: SUMO takes who parks from the lane, and moves it aside.

    Where, for how long and for whom it waits stays.
    """
    vehicle = libsumo.vehicle
    for index, stop in enumerate(vehicle.getStops(ego, 0)):
        if stop.stopFlags & PARKS:
            vehicle.setStopParameter(ego, index, "parking", "false")
