"""What speed SUMO wants, early enough for a car whose brakes answer with a lag: SUMO brakes at the last moment."""

import math

import libsumo

from emran_sumo.world.crossings import is_past

REACH = 100.0  # m ahead in which something to stop for is looked for
WAIT_BEFORE = 0.4  # m before a place to wait inside a junction
BEYOND, CREEPING = 0.8, 1.5  # m, m/s
MOVING = 0.5  # m/s
REACH_INSIDE = 40.0  # m from a junction in which places to wait inside it are looked at
SLOW = 0.3  # m/s: below it the lag costs less than the room before the line
CONGESTED = 60.0 / 3.6  # m/s: below it SUMO overtakes on the right as well
LEADERS_LEFT = 2  # mode of getNeighbors
CALM = 1.0  # s
SPARE_SPEED = 0.1  # m/s
STOPPED = 1  # bit of the stop state
CHANGE_ROOM = 12.0  # m that a car needs to change the lane from standstill
ZIPPER = "Z"  # state of a link where two lanes merge in turn: who follows whom there is SUMO's speed
STOP_STATES = "ryRYu"  # of a light


def speed_cap(ego: str, lag: float, step: float) -> float:
    """Speed [m/s] at the end of the coming step with which the ego still stops where SUMO wants it to; inf if nowhere.

        v_stop(v, gap - lag v)                    at stops, and at closed links and lights that can be obeyed
        v_follow(v, gap - lag (v - v_lead))       behind a leader
        v + (v_left - v) step / CALM              behind a leader on the left, if that is more than v_follow

    v_stop and v_follow are SUMO's own.

    Args:
        ego: id, at its true pose and speed.
        lag: of the brakes [s].
        step: of SUMO [s].
    """
    vehicle = libsumo.vehicle
    lane = vehicle.getLaneID(ego)
    if lag <= 0.0 or not lane:
        return math.inf
    speed = vehicle.getSpeed(ego)
    needed = 0.5 * speed * speed / vehicle.getDecel(ego)
    gaps = [to_stop(ego)]
    # nearer than the brakes need, SUMO has decided to go on
    gaps += [gap for gap in (to_light(ego), _to_closed(ego, lane, speed)) if gap >= needed]
    inside = _to_wait_inside(ego, lane)
    gaps += [max(inside - WAIT_BEFORE, 0.0)] if inside == 0.0 or inside >= needed else []
    gap = min(gaps)
    stop = stopping(ego, speed, max(gap - lag * speed, 0.0), step) if gap < REACH else math.inf
    return max(min(stop, behind_leader(ego, speed, lag), _beside_slower(ego, speed, lag, step)), 0.0)


def stopping(ego: str, speed: float, gap: float, step: float) -> float:
    """Speed [m/s] at the end of a step with which the ego stops within `gap` [m]: SUMO's own.

    Where a line closes late SUMO comes back to its speed for that gap within a step; a steady braking does as well.
    """
    steady = speed - 0.5 * speed * speed / max(gap, 1e-3) * step
    return max(libsumo.vehicle.getStopSpeed(ego, speed, gap), steady)


def to_stop(ego: str) -> float:
    """Distance to the next stop [m]."""
    vehicle = libsumo.vehicle
    stops = vehicle.getStops(ego, 1)
    if not stops or vehicle.getStopState(ego) & STOPPED:
        return math.inf
    edge, _, index = stops[0].lane.rpartition("_")
    distance = vehicle.getDrivingDistance(ego, edge, stops[0].endPos, int(index))
    return distance if distance >= 0.0 else math.inf


def to_light(ego: str) -> float:
    """Distance to the next light, where it is to be stopped at [m]."""
    for _, _, distance, state in libsumo.vehicle.getNextTLS(ego)[:1]:
        if state in STOP_STATES:
            return distance
    return math.inf


def _to_closed(ego: str, lane: str, speed: float) -> float:
    """Distance to the end of the lane, where somebody has to be let pass; lights are looked at elsewhere [m]."""
    if speed < SLOW or lane.startswith(":"):
        return math.inf
    links = libsumo.vehicle.getNextLinks(ego)
    if not links:
        return math.inf
    # hasPrio, isOpen, hasFoe, internal lane, state
    _, _, is_open, _, _, state, *_ = links[0]
    return math.inf if is_open or state in STOP_STATES or state == ZIPPER else _left(ego, lane)


def _to_wait_inside(ego: str, lane: str) -> float:
    """Distance to the place inside the junction where somebody has to be let pass [m].

    SUMO counts whoever is a hand's breadth beyond it as gone on.
    """
    left = _left(ego, lane)
    if left > REACH_INSIDE:
        return math.inf
    links = libsumo.vehicle.getNextLinks(ego)
    if links and links[0][5] == ZIPPER:
        return math.inf
    if lane.startswith(":"):
        if _is_just_beyond(ego, lane) and _is_crossed(ego, lane):
            return 0.0
        return left if _has_to_wait(ego, lane) else math.inf
    inside = links[0][4] if links else ""
    return left + libsumo.lane.getLength(inside) if inside and _has_to_wait(ego, inside) else math.inf


def _has_to_wait(ego: str, inside: str) -> bool:
    """Whether a lane inside a junction ends at a place to wait, and somebody has to be let pass there.

    A link is closed to whoever comes; those who are crossing have come, and are looked for on the lanes they cross.
    """
    links = libsumo.lane.getLinks(inside)
    if not links or not links[0][4]:
        return False
    _, _, is_open, _, further, *_ = links[0]
    return not is_open or _is_crossed(ego, further)


def _is_crossed(ego: str, lane: str) -> bool:
    """Whether somebody is on the way across a lane inside a junction, and not past it with the whole body yet."""
    vehicle = libsumo.vehicle
    return any(
        vehicle.getSpeed(name) > MOVING and not is_past(name, foe, lane, vehicle.getWidth(ego))
        for foe in libsumo.lane.getInternalFoes(lane)
        for name in libsumo.lane.getLastStepVehicleIDs(foe)
    )


def _is_just_beyond(ego: str, lane: str) -> bool:
    """Whether an ego has rolled a little beyond where it had to wait, and can still do so."""
    return libsumo.vehicle.getLanePosition(ego) < BEYOND and libsumo.vehicle.getSpeed(ego) < CREEPING


def _left(ego: str, lane: str) -> float:
    return libsumo.lane.getLength(lane) - libsumo.vehicle.getLanePosition(ego)


def behind_leader(ego: str, speed: float, lag: float) -> float:
    """Speed [m/s] with which the ego still stops behind its leader, however late its brakes answer."""
    vehicle = libsumo.vehicle
    name, gap = vehicle.getLeader(ego, REACH) or ("", 0.0)
    if not name:
        return math.inf
    ahead = vehicle.getSpeed(name)
    room = max(gap - lag * max(speed - ahead, 0.0), 0.0)
    return max(vehicle.getFollowSpeed(ego, speed, room, ahead, vehicle.getDecel(name), name), 0.0)


def _beside_slower(ego: str, speed: float, lag: float, step: float) -> float:
    """Speed [m/s] that comes gently to that of a slower leader on the left.

    Above 60 km/h SUMO does not overtake on the right: it brakes while the ego is the faster one and speeds up while it
    is the slower one, between which a car whose drive answers with a lag swings.
    """
    vehicle = libsumo.vehicle
    if speed < CONGESTED:
        return math.inf
    found = vehicle.getNeighbors(ego, LEADERS_LEFT)
    if not found:
        return math.inf
    name, gap = found[0]
    ahead = vehicle.getSpeed(name)
    room = max(gap - lag * max(speed - ahead, 0.0), 0.0)
    safe = vehicle.getFollowSpeed(ego, speed, room, ahead, vehicle.getDecel(name), name)
    return max(safe, speed + (ahead - SPARE_SPEED - speed) * step / CALM)


def room(ego: str) -> float:
    """How far the ego can drive along its route without changing the lane [m]; 0 inside a junction."""
    vehicle = libsumo.vehicle
    lane = vehicle.getLaneID(ego)
    for found in vehicle.getBestLanes(ego):
        if found[0] == lane:
            return max(found[1] - vehicle.getLanePosition(ego), 0.0)
    return 0.0


def speed_for_room(ego: str, step: float) -> float:
    """Speed [m/s] that stops the ego where a change of lane still has room: SUMO changes lanes on the spot."""
    left = room(ego) - CHANGE_ROOM
    if left < 0.0:
        return math.inf
    speed = libsumo.vehicle.getSpeed(ego)
    least = max(speed - libsumo.vehicle.getDecel(ego) * step, 0.0)
    return max(libsumo.vehicle.getStopSpeed(ego, speed, left), least)


def wish(ego: str, step: float) -> float:
    """Speed [m/s] that SUMO wants; 0 where it wants a stop within the step.

    To SUMO that is a negative speed, in whose place it reports the present one: the ego would creep on.
    """
    wanted, present = libsumo.vehicle.getSpeedWithoutTraCI(ego), libsumo.vehicle.getSpeed(ego)
    stops = wanted == present <= libsumo.vehicle.getEmergencyDecel(ego) * step
    return 0.0 if stops else max(wanted, 0.0)
