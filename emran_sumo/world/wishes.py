"""SUMO's wishes to change the lane: read where its lane change model leaves them, and weighed anew when one is done."""

import contextlib
from typing import NamedTuple

import libsumo

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


def meant(wished_on: str | None, lane: str) -> str:
    """The lane from which a wish counts that was read on one lane, while SUMO has the ego on another by now: where a
    path shifts from lane to lane behind a junction the nearest one changes."""
    if wished_on is None or wished_on.rpartition("_")[0] != lane.rpartition("_")[0]:
        return lane
    return wished_on


def weigh_anew(ego: str) -> None:
    """After a change of ours SUMO weighs its wishes from zero, as after its own: keeping right would go on and on."""
    for wish in ("keepRightProbability", "speedGainProbabilityLeft", "speedGainProbabilityRight"):
        with contextlib.suppress(*SUMO_ERRORS):  # other lane change models have other names
            libsumo.vehicle.setParameter(ego, f"laneChangeModel.{wish}", "0")
