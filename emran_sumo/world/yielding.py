"""Where SUMO has the ego give way at a junction: its refusal holds for as long as the ego can still stop."""

import math
from typing import NamedTuple

import libsumo

from emran_sumo.world import braking

GIVES_WAY = "m=swgo"  # states of links without priority
REFUSED = 0.05  # m/s between SUMO's wish and its stop at the line
HARDEST = 7.0  # m/s2 that a car brakes with on a dry road
BEFORE_LINE = 0.1  # m at which SUMO stops


class Line(NamedTuple):
    """What is before an ego: distance to the line [m], its speed, and that which SUMO wants where it stops there [m/s];
    brake: its distance to standstill with SUMO's deceleration [m]."""

    gap: float
    speed: float
    stop: float
    brake: float


class Yielding:
    """Lines at which SUMO has refused to let egos go on.

    SUMO's driver goes on where it cannot stop any more. It brakes at once, and so at the very last moment; a car whose
    brakes answer with a lag would by then be a little nearer or faster than that, and always go.
    """

    def __init__(self) -> None:
        self._ahead: dict[str, Line] = {}
        self._refused: set[str] = set()

    def cap(self, ego: str, lag: float, step: float) -> float:
        """`braking.speed_cap`, at the pose before the step; remembers what is ahead."""
        self._ahead.pop(ego, None)
        gap = to_line(ego)
        if gap < braking.REACH_INSIDE:
            speed = libsumo.vehicle.getSpeed(ego)
            brake = 0.5 * speed * speed / libsumo.vehicle.getDecel(ego)
            self._ahead[ego] = Line(gap - lag * speed, speed, libsumo.vehicle.getStopSpeed(ego, speed, gap), brake)
        else:
            self._refused.discard(ego)
        return braking.speed_cap(ego, lag, step)

    def obey(self, ego: str, wished: float, step: float) -> float:
        """Speed [m/s] in place of the one that SUMO wishes for the step: less where it has refused the ego's way."""
        line = self._ahead.get(ego)
        if line is None or line.speed < braking.SLOW:
            self._refused.discard(ego)
            return wished
        if wished <= line.stop + REFUSED and wished < line.speed:
            self._refused.add(ego)
        elif line.gap + BEFORE_LINE > line.brake:
            self._refused.discard(ego)  # it could stop, and SUMO does not want it to
        if ego not in self._refused or not somebody_comes(ego, line.gap):
            self._refused.discard(ego)
            return wished
        needed = 0.5 * line.speed * line.speed / max(line.gap, 1e-3)
        if needed > HARDEST:
            self._refused.discard(ego)
            return wished
        return min(wished, max(line.speed - needed * step, 0.0))


def to_line(ego: str) -> float:
    """Distance to the end of the ego's lane, where it has to give way there [m]; else infinite.

    Where there is a place to wait inside the junction, it has to give way only there.
    """
    lane = libsumo.vehicle.getLaneID(ego)
    if not lane or lane.startswith(":"):
        return math.inf
    links = libsumo.vehicle.getNextLinks(ego)
    if not links or links[0][1] or links[0][5] not in GIVES_WAY:  # has priority; state
        return math.inf
    further = libsumo.lane.getLinks(links[0][4]) if links[0][4] else ()
    if further and further[0][4]:
        return math.inf
    return libsumo.lane.getLength(lane) - libsumo.vehicle.getLanePosition(ego) - BEFORE_LINE


def somebody_comes(ego: str, gap: float) -> bool:
    """Whether somebody with priority is still to cross the ego's way behind the line, which is `gap` [m] ahead."""
    foes = libsumo.vehicle.getJunctionFoes(ego, max(gap, 0.0) + braking.REACH_INSIDE)
    # id, distances of ego and foe to where they cross, and to the end of it, lanes of both, whether each gives way
    return any(left > 0.0 and gives_way for _, _, _, _, left, _, _, gives_way, _ in foes)
