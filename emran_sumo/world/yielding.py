"""Where SUMO has the ego give way at a junction: its refusal holds for as long as the ego can still stop."""

import math
from typing import NamedTuple

import libsumo

from emran_sumo.world import braking

GIVES_WAY = "m=swgo"  # states of links without priority
REFUSED = 0.05  # m/s between SUMO's wish and its stop at the line
HARDEST = 7.0  # m/s2 that a car brakes with on a dry road
BEFORE_LINE = 0.1  # m at which SUMO stops
EQUAL = "="  # state of a link where whoever comes from the right has priority
SETS_OFF = 0.5  # s that a car needs to answer and to roll over the line
AT_LINE, COMES_WITHIN = 0.5, 15.0  # m from the line


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

    Where all wait for one from the right, it lets them go at random for single steps, until somebody has crept over the
    line. A car whose drive answers with a lag does not begin to roll in a step: it sets off where SUMO's driver would
    be over the line.
    """

    def __init__(self) -> None:
        self._ahead: dict[str, Line] = {}
        self._refused: set[str] = set()
        self._crept: dict[str, tuple[float, float]] = {}  # m and m/s of SUMO's driver since it waits
        self._sets_off: dict[str, float] = {}  # s left

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
        if line is None:
            for known in (self._crept, self._sets_off):
                known.pop(ego, None)
            self._refused.discard(ego)
            return wished
        if self._may_set_off(ego, line, wished, step):
            fastest = line.speed + libsumo.vehicle.getAccel(ego) * step
            return max(wished, min(fastest, braking.behind_leader(ego, line.speed, 0.0)))
        if line.speed < braking.SLOW:
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

    def _may_set_off(self, ego: str, line: Line, wished: float, step: float) -> bool:
        """Whether SUMO lets a car that waits among equals go now, or did so before it could roll over the line."""
        left = self._sets_off.pop(ego, 0.0) - step
        crept, speed = self._crept.get(ego, (0.0, 0.0))
        waits = line.gap < AT_LINE and line.speed < braking.MOVING
        speed = speed + wished - line.speed if waits and wished > line.speed else 0.0
        crept += speed * step
        self._crept[ego] = crept, speed
        if speed > 0.0 and crept >= max(line.gap, 0.0) + BEFORE_LINE:
            left = max(left, SETS_OFF)
            self._crept[ego] = 0.0, 0.0
        if left <= 0.0 or not self._is_free(ego, line.gap):
            return False
        self._sets_off[ego] = left
        return True

    def _is_free(self, ego: str, gap: float) -> bool:
        """Whether equals meet at the line, and nobody who goes on, or is about to, crosses the ego's way."""
        links = libsumo.vehicle.getNextLinks(ego)
        if not links or links[0][5] != EQUAL:
            return False
        foes = libsumo.vehicle.getJunctionFoes(ego, max(gap, 0.0) + braking.REACH_INSIDE)
        return not any(
            left > 0.0 and (foe in self._sets_off or (gives_way and away < COMES_WITHIN and _moves(foe)))
            for foe, _, away, _, left, _, _, gives_way, _ in foes
        )


def _moves(foe: str) -> bool:
    return libsumo.vehicle.getSpeed(foe) > braking.MOVING


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
