"""Braking early enough for a car whose brakes answer with a lag: SUMO brakes at the last moment, at once."""

import math

import libsumo

REACH = 100.0  # m ahead in which something to stop for is looked for


def speed_cap(ego: str, lag: float) -> float:
    """Speed [m/s] at the end of the coming step with which the ego still stops where SUMO wants it to.

        min over everything ahead of v_stop(v, gap - lag v)

    for stops, lights that are red or can be obeyed at yellow, links that are closed, and for a leader
    v_follow(v, gap - lag (v - v_lead)); inf without any. v_stop and v_follow are SUMO's own.

    Args:
        ego: id, at its true pose and speed.
        lag: of the brakes [s].
    """
    vehicle = libsumo.vehicle
    speed = vehicle.getSpeed(ego)
    if lag <= 0.0:
        return math.inf
    gaps = [gap for gap in (_to_stop(ego), _to_closed(ego, speed)) if gap < REACH]
    cap = min((vehicle.getStopSpeed(ego, speed, max(gap - lag * speed, 0.0)) for gap in gaps), default=math.inf)
    return max(min(cap, _behind_leader(ego, speed, lag)), 0.0)


def _to_stop(ego: str) -> float:
    """Distance to the next stop [m]."""
    vehicle = libsumo.vehicle
    stops = vehicle.getStops(ego, 1)
    if not stops or vehicle.isStopped(ego):
        return math.inf
    edge, _, index = stops[0].lane.rpartition("_")
    distance = vehicle.getDrivingDistance(ego, edge, stops[0].endPos, int(index))
    return distance if 0.0 <= distance < REACH else math.inf


def _to_closed(ego: str, speed: float) -> float:
    """Distance to the line before a light or a link that lets nobody through [m]."""
    vehicle = libsumo.vehicle
    needed = 0.5 * speed * speed / vehicle.getDecel(ego)
    gap = math.inf
    for _, _, distance, state in vehicle.getNextTLS(ego)[:1]:
        if state in "ryRYu" and 0.0 < distance < REACH and needed <= distance:
            gap = distance
    end = libsumo.lane.getLength(vehicle.getLaneID(ego)) - vehicle.getLanePosition(ego)
    links = vehicle.getNextLinks(ego) if end < gap and needed <= end < REACH else ()
    if links and not links[0][2] and links[0][5] not in "ryRYu":
        gap = end
    return gap


def _behind_leader(ego: str, speed: float, lag: float) -> float:
    vehicle = libsumo.vehicle
    name, gap = vehicle.getLeader(ego, REACH) or ("", 0.0)
    if not name:
        return math.inf
    ahead = vehicle.getSpeed(name)
    room = max(gap - lag * max(speed - ahead, 0.0), 0.0)
    return vehicle.getFollowSpeed(ego, speed, room, ahead, vehicle.getDecel(name), name)
