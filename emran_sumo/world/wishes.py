"""SUMO's wishes to change the lane: read where its lane change model leaves them, and weighed anew when one is done."""

import contextlib
from typing import NamedTuple

import libsumo

from emran_sumo.world.roadmap import RoadMap
from emran_sumo.world.session import SUMO_ERRORS

LEFT, RIGHT = 2, 4  # bits of a lane change wish
STRATEGIC = 8
REASONS = STRATEGIC | 16 | 32 | 64  # and cooperative, speed gain, keep right
# by leaders or followers on either side, by overlapping vehicles, by too little room or speed
BLOCKED = 1 << 9 | 1 << 10 | 1 << 11 | 1 << 12 | 1 << 13 | 1 << 14 | 1 << 28
UNKNOWN = 1 << 30


class Wish(NamedTuple):
    """side: +1 left, -1 right, 0 none that is free; needs_room: one that the route needs is blocked; blocked: side of a
    wish that is blocked."""

    side: int
    needs_room: bool
    blocked: int = 0


def lane_change(ego: str) -> Wish:
    """What SUMO wishes for this step."""
    needs_room, blocked = False, 0
    for side, bit in ((1, LEFT), (-1, RIGHT)):
        state = libsumo.vehicle.getLaneChangeState(ego, side)[0]
        if state == UNKNOWN or not (state & bit and state & REASONS):
            continue
        if not state & BLOCKED:
            return Wish(side, needs_room)
        needs_room |= bool(state & STRATEGIC)
        blocked = side
    return Wish(0, needs_room, blocked)


def meant(road: RoadMap, wished_on: str, lane: str, side: int) -> str:
    """The lane at a side of the one that a wish was read on; "" where there is none, or SUMO has the ego there by now.

    Where a path shifts from lane to lane behind a junction the nearest lane changes between reading and planning.
    """
    if lane.startswith(":"):
        return ""
    same_edge = wished_on.rpartition("_")[0] == lane.rpartition("_")[0]
    beside = road.neighbor(wished_on if same_edge else lane, side)
    return beside if beside is not None and beside != lane else ""


def weigh_anew(ego: str) -> None:
    """After a change of ours SUMO weighs its wishes from zero, as after its own: keeping right would go on and on."""
    for wish in ("keepRightProbability", "speedGainProbabilityLeft", "speedGainProbabilityRight"):
        with contextlib.suppress(*SUMO_ERRORS):  # other lane change models have other names
            libsumo.vehicle.setParameter(ego, f"laneChangeModel.{wish}", "0")


def decides_every(vehicle: str) -> float:
    """Time between two decisions of SUMO's driver of a vehicle [s]."""
    return libsumo.vehicle.getActionStepLength(vehicle)
