"""Why a vehicle stands."""

import libsumo

from emran_sumo.world.braking import STOPPED, to_light, to_stop
from emran_sumo.world.session import SUMO_ERRORS

QUEUE, LINE, HALT = 6.0, 10.0, 3.0  # m to the vehicle ahead, to the light, to the stop
STOP, BEHIND, LIGHT, YIELDS = "at its stop", "in a queue", "at a red light", "gives way"
REASONS = (STOP, BEHIND, LIGHT, YIELDS)


def reason(ego: str) -> str:
    """One of REASONS for a vehicle that stands; "" if SUMO does not have it."""
    vehicle = libsumo.vehicle
    try:
        if vehicle.getStopState(ego) & STOPPED or to_stop(ego) < HALT:
            return STOP
        name, gap = vehicle.getLeader(ego, QUEUE) or ("", 0.0)
        if name and gap < QUEUE and vehicle.getRoadID(name) == vehicle.getRoadID(ego):  # not one that crosses
            return BEHIND
        return LIGHT if to_light(ego) < LINE else YIELDS
    except SUMO_ERRORS:
        return ""
