"""Where the ego goes: along its lane and its route, with the lane changes that SUMO wishes or the vehicle declares."""

import math
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from emran_sumo import maneuver
from emran_sumo.ego import Ego
from emran_sumo.errors import UserError
from emran_sumo.loop import AT
from emran_sumo.maneuver import DoubleLaneChange
from emran_sumo.path import Path, Point, first_near, nearest, path_length, wrap
from emran_sumo.world.lanes import blended, steered
from emran_sumo.world.records import Intent, Others, TakeOver

WAITING = "waiting for a gap"
WAITING_TO_RETURN = "waiting to return"
DECIDE = 20.0  # m before the way back, where tanh is still flat, at which it must be free
DURATION = 4.0  # s of a lane change
SHORTEST = 20.0  # m of a lane change
TIGHTEST = 10.0  # m of a lane change where the lane ends
SPARE = 8.0  # m of the lane that are left behind it
OVER = 1.4  # times the lane that is left: 6/7 of the way across are done where it ends
SLOW = 1.0  # m/s
BRAKING = 4.0  # m/s2: who needs more to stop on its lane changes it, sharp as that may be
AT_THE_END = 60.0  # m of lane left
REST = 1.0  # s between lane changes
LASTS, AGAIN = 1.0, 10.0  # s after which a blocked wish is told, and told again
REACH = 120.0  # m of path that must lie ahead, else it is built anew
LAST = 40.0  # m of path ahead with which any new one is taken
STEP, KINK = 0.1, 0.05  # m, rad, between a path and the one that goes on


class Lanes(Protocol):
    """What a planner asks of the world."""

    def lane_path(self, ego: str, side: int) -> Path | None:
        """Path along the route from the ego's lane or the one beside."""
        ...

    def ask_for_room(self, ego: str, side: int) -> None:
        """Let the world make room beside the ego."""
        ...

    def hold(self, ego: str, side: int) -> None:
        """Keep the lane beside the ego free for its return."""
        ...

    def changed_lane(self, ego: str) -> None:
        """Let the world weigh its wishes to change the lane anew."""
        ...


class DoubleLaneChanger:
    """Drives the declared double lane change of one ego, once, where a gap is free."""

    def __init__(self, change: DoubleLaneChange, handed: TakeOver, name: str) -> None:
        self.began: float | None = None  # s after take-over
        self._change: DoubleLaneChange | None = change
        self._begin = 0.0  # position along the path [m]
        self._back = change.back_start  # distance from there to the way back [m]; infinite while that must wait
        self._returning = False
        free = handed.lanes_left if change.side > 0 else handed.lanes_right
        if free < 1:
            side = "left" if change.side > 0 else "right"
            raise UserError(
                f'vehicle "{name}": param double_lane_change.direction: found "{side}", but there is no lane on '
                "that side; accepted is the other direction or another departLane."
            )

    def plan(self, ego: Ego, intent: Intent, others: Others, lanes: Lanes) -> None:
        """Decide after a step; SUMO's own wishes are not followed."""
        del intent
        if self._change is None:
            return
        if self.began is None:
            self._try_to_begin(ego, self._change, others, lanes)
        else:
            self._go_on(ego, self._change, others, lanes)

    def reroute(self, ego: Ego, lanes: Lanes) -> None:
        """The maneuver's road stays as it was planned."""
        del ego, lanes

    def _try_to_begin(self, ego: Ego, change: DoubleLaneChange, others: Others, lanes: Lanes) -> None:
        if ego.position < change.start:
            return
        if path_length(ego.base) - ego.state.position < change.length + 50.0:
            if ego.maneuver == WAITING:
                lanes.ask_for_room(ego.name, 0)
            ego.enter("keep lane", "no free gap before the end of the road: double lane change given up", "WARN")
            self._change = None
            return
        if not maneuver.gap_is_free(change, others, ego.speed, ego.vehicle.length, ego.lane_width):
            if ego.maneuver != WAITING:
                lanes.ask_for_room(ego.name, change.side)
            ego.enter(WAITING, "double lane change wanted, waiting for a gap")
            return
        if ego.maneuver == WAITING:
            lanes.ask_for_room(ego.name, 0)
        self._begin, self.began = ego.state.position, ego.time
        self._take(ego, change)
        ego.enter("double lane change", f"double lane change begins at {ego.speed:.1f} m/s")

    def _go_on(self, ego: Ego, change: DoubleLaneChange, others: Others, lanes: Lanes) -> None:
        done = ego.state.position - self._begin
        is_beside = change.side * others.own_offset > 0.5 * ego.lane_width
        lanes.hold(ego.name, -change.side if is_beside else 0)
        if done > self._back + change.length_back + maneuver.TAIL:
            trace = ego.trace()
            errors = trace[trace[:, AT.time] > (self.began or 0.0), AT.cross_track_error]
            worst = np.abs(errors).max(initial=0.0)
            ego.enter("keep lane", f"double lane change done, largest cross-track error {worst:.3f} m")
            self._change = None
        elif self._returning:
            return
        elif done > min(self._back, change.back_start) - DECIDE:
            self._return(ego, change, others, done)
        elif done > maneuver.OUT_START - 10.0:
            side = "left" if change.side > 0 else "right"
            ego.enter(f"change {side}", f"out to the lane on the {side}")

    def _return(self, ego: Ego, change: DoubleLaneChange, others: Others, done: float) -> None:
        """Begin the way back, or stay beside until the own lane has room."""
        free = _is_free(ego, others)
        if free:
            self._returning = True
            if self._back > change.back_start:
                self._back = done + DECIDE
                self._take(ego, change)
            ego.enter("change right" if change.side > 0 else "change left", "back to the own lane")
        elif self._back == change.back_start:
            self._back = math.inf
            self._take(ego, change)
            ego.enter(WAITING_TO_RETURN, "the own lane is taken: the way back waits", "WARN")

    def _take(self, ego: Ego, change: DoubleLaneChange) -> None:
        path = maneuver.maneuver_path(ego.base, change, self._begin, ego.lane_width, self._back)
        ego.take_path(ego.base, path)


class Changing(NamedTuple):
    """A lane change under way: side, the lane's path before it, and the position [m] where it ends."""

    side: int
    before: Path
    end: float


class LaneFollower:
    """Follows the route on the lane that SUMO wishes: starts, latches, completes or abandons lane changes."""

    began = None

    def __init__(self, lane_changes: bool, room: Callable[[str], float]) -> None:
        self._wanted = lane_changes
        self._room = room
        self._changing: Changing | None = None
        self._last = -REST
        self._blocked, self._told = (0, 0.0), -AGAIN  # side that is wished and blocked since a time; when that was told
        self.count = 0

    def plan(self, ego: Ego, intent: Intent, others: Others, lanes: Lanes) -> None:
        """Decide after a step."""
        self._note_wish(ego, intent.blocked if self._wanted and self._changing is None else 0)
        if self._changing is not None:
            self._go_on(ego, self._changing, others, lanes)
        elif self._wanted and intent.side != 0 and ego.time - self._last >= REST:
            self._start(ego, intent.side, lanes)
        elif path_length(ego.path) - ego.state.position < REACH:
            self._look_further(ego, lanes)

    def _note_wish(self, ego: Ego, blocked: int) -> None:
        """Tell of a wish that lasts and somebody blocks; SUMO's wishes come and go with every step."""
        side, since = self._blocked
        if blocked != side:
            self._blocked = blocked, ego.time
        elif side and ego.time - since > LASTS and ego.time - self._told > AGAIN:
            self._told = ego.time
            ego.say("INFO", f"lane change {'left' if side > 0 else 'right'} wished, but somebody is in the way")

    def _start(self, ego: Ego, side: int, lanes: Lanes) -> None:
        room = self._room(ego.name)
        target = lanes.lane_path(ego.name, side)
        if target is None or (ego.speed < SLOW and room > AT_THE_END):
            return  # in a queue only a change that the route needs cannot wait
        before, length = ego.base, max(ego.speed * DURATION, SHORTEST)
        cannot_wait = ego.speed < SLOW or ego.speed * ego.speed > 2.0 * BRAKING * room
        # where that is sharper than can be driven, most of it at least is done before the lane ends
        shortest, longer = (min(length, most) for most in (max(room - SPARE, TIGHTEST), OVER * room))
        tried = (shortest, longer) if longer > shortest else (shortest,)
        for length in tried:
            if self._blend(ego, target, length, must=cannot_wait):
                break
        else:
            return  # where the route needs it, SUMO lets the ego come slower and wishes it again
        self._changing = Changing(side, before, ego.state.position + length)
        self.count += 1
        word = "left" if side > 0 else "right"
        ego.enter(f"change {word}", f"lane change {word} begins at {ego.speed:.1f} m/s")

    def _blend(self, ego: Ego, target: Path, length: float, must: bool = False) -> bool:
        """Take the way from the present path to `target`; False where the target does not pass here.

        Unless it `must` be taken it is not, either, where it has a step or a kink here, as where `target` begins only
        ahead, or bends more than can be driven.
        """
        here = nearest(ego.path, ego.state.vehicle.x, ego.state.vehicle.y, ego.state.position)
        there = nearest(target, here.x, here.y, first_near(target, here.x, here.y, here.yaw))
        if np.hypot(there.x - here.x, there.y - here.y) > 8.0:
            return False
        path = blended(target, ego.path, here.position, there.position, length)
        if must:
            path = steered(path, here.x, here.y, here.yaw)
        if not must and not (_goes_on(path, here) and ego.can_drive(path, length)):
            return False
        ego.take_path(target, path, bends=True)
        return True

    def _go_on(self, ego: Ego, changing: Changing, others: Others, lanes: Lanes) -> None:
        word = "left" if changing.side > 0 else "right"
        if ego.state.position >= changing.end:
            self._changing, self._last = None, ego.time
            lanes.changed_lane(ego.name)
            ego.enter("keep lane", f"lane change {word} done")
        elif abs(others.own_offset) > 0.5 * ego.lane_width and not _is_free(ego, others):
            length = max(ego.speed * 0.5 * DURATION, SHORTEST)
            if self._blend(ego, changing.before, length):
                self._changing = Changing(-changing.side, ego.base, ego.state.position + length)
                ego.say("WARN", f"lane change {word} abandoned: the gap closes")

    def reroute(self, ego: Ego, lanes: Lanes) -> None:
        """The route has changed: follow the new one from here."""
        target = lanes.lane_path(ego.name, 0)
        if target is not None and target is not ego.base and self._blend(ego, target, SHORTEST, must=True):
            self._changing = None
            ego.maneuver = "keep lane"
            ego.say("INFO", "the route has changed")

    def _look_further(self, ego: Ego, lanes: Lanes) -> None:
        """The path ends soon: build it anew from where SUMO has the ego, if that leads further."""
        target = lanes.lane_path(ego.name, 0)
        if target is None or target is ego.base:
            return
        self._blend(ego, target, SHORTEST, must=path_length(ego.path) - ego.state.position < LAST)


def _goes_on(path: Path, here: Point) -> bool:
    """Whether a path leads through a point of the one before it, in its direction."""
    point = nearest(path, here.x, here.y, first_near(path, here.x, here.y, here.yaw))
    step = math.hypot(point.x - here.x, point.y - here.y)
    return step < STEP and abs(float(wrap(point.yaw - here.yaw))) < KINK


def _is_free(ego: Ego, others: Others) -> bool:
    """Whether the lane that the ego is in or aims at has room for it."""
    return maneuver.lane_is_free(others, ego.speed, ego.vehicle.length, ego.lane_width)


def planner_for(
    ego: Ego, handed: TakeOver, room: Callable[[str], float] = lambda _: math.inf
) -> DoubleLaneChanger | LaneFollower:
    """The declared double lane change of a vehicle, or SUMO's own wishes.

    room: how far an ego can drive without changing the lane [m].
    """
    change = maneuver.declared(handed.params, ego.name)
    if change is not None:
        return DoubleLaneChanger(change, handed, ego.name)
    return LaneFollower(ego.scenario.egos.lane_changes, room)
