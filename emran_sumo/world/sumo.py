"""One SUMO simulation with vehicles driven from outside: take over, propose, commit.

SUMO's compass degrees and front-bumper points stay in here.
"""

import contextlib
import math
from collections.abc import Iterator

import libsumo

from emran_sumo.path import Path
from emran_sumo.world import braking, phantom, session, stops, wishes
from emran_sumo.world.arrival import Arrivals
from emran_sumo.world.passages import Passages
from emran_sumo.world.phantom import Phantoms
from emran_sumo.world.records import Intent, Pose, Road, TakeOver, Traffic
from emran_sumo.world.roadmap import RoadMap
from emran_sumo.world.routes import DOUBLE_LANE_CHANGE
from emran_sumo.world.session import SUMO_ERRORS, told
from emran_sumo.world.sight import Sight
from emran_sumo.world.turning import Turning
from emran_sumo.world.yielding import Yielding

SIDE_STEP = 0.3  # m: more than a car moves sideways in one step
LANE_CHANGE_OURS = 0  # setLaneChangeMode: SUMO neither changes the lane nor adapts the speed for a change
LANE_CHANGE_DEFAULT = 1621
REMOVE_ARRIVED = 2


class SumoWorld:
    """One SUMO simulation in this process, with one or more vehicles driven from outside.

    Use as a context manager: whatever ends the block, the last step is completed and SUMO is closed (a pose that
    is still pending at close would remove the vehicle of the same id from the next simulation of the process).

    Args:
        options: of SUMO, see `session.scenario_options`.
        step: [s]; seed: of SUMO.
        speed_limit: of every lane outside ramps and junctions [m/s]; 0 keeps the network's.
        gui: open SUMO's own window.

    Raises:
        UserError: with SUMO's own reason when it cannot start.
    """

    def __init__(
        self, options: dict[str, str], step: float, seed: int, speed_limit: float = 0.0, gui: bool = False
    ) -> None:
        self.step = step
        self._pending = False
        self._closed = False
        self._sight = Sight()
        self._phantoms = Phantoms()
        self._passages = Passages()
        self._arrivals = Arrivals()
        self._yielding = Yielding()
        self._held: dict[str, int] = {}
        self._searched: dict[str, str] = {}  # off-road egos and where they want to go
        self._fronts: dict[str, float] = {}
        self._widths: dict[str, float] = {}
        self._lags: dict[str, float] = {}
        self._routes: dict[str, str] = {}
        self._wished_on: dict[str, str] = {}  # lane that a wish to change it was read on
        self.last_message = ""
        self._departed: dict[str, None] = {}
        self._collisions: dict[tuple[str, str], None] = {}
        self.end = math.inf  # of the scenario [s]
        unknown = session.start(options, step, seed, gui)
        self.notes: tuple[str, ...] = (f"left out, as SUMO does not know it: {', '.join(unknown)}",) if unknown else ()
        self.map = RoadMap()
        self._turning = Turning(self.map)
        try:
            self._limit_speed(speed_limit)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "SumoWorld":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return libsumo.simulation.getTime()

    def _limit_speed(self, limit: float) -> None:
        if limit <= 0.0:
            return
        main = max(libsumo.lane.getMaxSpeed(lane) for lane in libsumo.lane.getIDList())
        for lane in libsumo.lane.getIDList():
            if libsumo.lane.getMaxSpeed(lane) > 0.9 * main:
                libsumo.lane.setMaxSpeed(lane, limit)

    def warm_up(self, duration: float) -> Iterator[float]:
        """Step SUMO alone for `duration` [s]; yields the seconds done."""
        for k in range(round(duration / self.step)):
            self.advance()
            yield (k + 1) * self.step

    def advance(self) -> None:
        """One step in which nobody is driven from outside."""
        with session.messages() as read:
            try:
                with told():
                    libsumo.simulation.step()
            finally:
                self.last_message = read() or self.last_message
        self._note(fresh=True)

    def _note(self, fresh: bool) -> None:
        """Keep what SUMO reports: it holds each half of a split step for itself."""
        if fresh:
            self._departed, self._collisions = {}, {}
        self._departed |= dict.fromkeys(phantom.real(libsumo.simulation.getDepartedIDList()))
        self._collisions |= {(c.collider, c.victim): None for c in libsumo.simulation.getCollisions()}

    def present(self) -> tuple[str, ...]:
        """Vehicles on the road."""
        return phantom.real(libsumo.vehicle.getIDList())

    def departed(self) -> tuple[str, ...]:
        """Vehicles that have come in the last step."""
        return tuple(self._departed)

    def expected(self) -> int:
        """Vehicles on the road or still to come."""
        return libsumo.simulation.getMinExpectedNumber()

    def kind(self, name: str) -> tuple[str, str]:
        """Type and class of a vehicle."""
        return libsumo.vehicle.getTypeID(name).removesuffix(f"@{name}"), libsumo.vehicle.getVehicleClass(name)

    def size(self, name: str) -> tuple[float, float, float]:
        """Length, width and height of a vehicle [m]."""
        return self._sight.size(name)

    def route_length(self, name: str) -> float:
        """Length [m] of what is left of a vehicle's route, junctions not counted."""
        edges = libsumo.vehicle.getRoute(name)[max(libsumo.vehicle.getRouteIndex(name), 0) :]
        return sum(libsumo.lane.getLength(f"{edge}_0") for edge in edges)

    def take_over(
        self, ego: str, front: float, width: float, lane_changes: bool = True, brake_lag: float = 0.0
    ) -> TakeOver:
        """Drive `ego` from outside from now on; it stays an ordinary vehicle for everybody else.

        Args:
            ego: id; front: from its center of gravity to the front bumper [m]; width: of its body [m].
            lane_changes: SUMO plans them; a vehicle that declares a maneuver of its own never gets any.
            brake_lag: [s] with which its brakes answer.
        """
        vehicle = libsumo.vehicle
        self._fronts[ego], self._widths[ego], self._lags[ego] = front, width, brake_lag
        params = {key: vehicle.getParameter(ego, key) for key in DOUBLE_LANE_CHANGE}
        params = {key: value for key, value in params.items() if value}
        vehicle.setLaneChangeMode(ego, LANE_CHANGE_DEFAULT if lane_changes and not params else LANE_CHANGE_OURS)
        vehicle.setActionStepLength(ego, self.step)
        vehicle.setImperfection(ego, 0.0)  # a human's dawdling is no reference: it is drawn anew each step
        stops.keep_on_lane(ego)
        session.show(ego)
        self._sight.look_from(ego)
        lane = vehicle.getLaneID(ego)
        edge, index = libsumo.lane.getEdgeID(lane), vehicle.getLaneIndex(ego)
        position, yaw = vehicle.getPosition(ego), math.radians(90.0 - vehicle.getAngle(ego))
        x, y = position[0] - front * math.cos(yaw), position[1] - front * math.sin(yaw)
        passed = vehicle.getRoute(ego)[: vehicle.getRouteIndex(ego)]
        before = sum(libsumo.lane.getLength(f"{name}_0") for name in passed)
        path = self.lane_path(ego, 0)
        assert path is not None
        return TakeOver(
            Pose(x, y, yaw, vehicle.getSpeed(ego), vehicle.getAcceleration(ego)),
            path,
            libsumo.lane.getWidth(lane),
            libsumo.edge.getLaneNumber(edge) - 1 - index,
            index,
            params,
            before + vehicle.getLanePosition(ego) - front,
            before + self.route_length(ego),
        )

    def lane_path(self, ego: str, side: int) -> Path | None:
        """Smooth path along the route from the ego's lane, or from the one beside (side +1 left, -1 right)."""
        lane = libsumo.vehicle.getLaneID(ego)
        if side != 0:
            lane = wishes.meant(self.map, self._wished_on.get(ego) or lane, lane, side)
            if not lane:
                return None
        return self.map.path(lane, tuple(libsumo.vehicle.getRoute(ego)), max(libsumo.vehicle.getRouteIndex(ego), 0))

    def propose(self, poses: dict[str, Pose]) -> dict[str, Intent]:
        """What SUMO wants of each ego for the step that begins now.

        Each ego is first moved to where it would be at constant speed; SUMO then decides (`executeMove`), so that its
        wish answers the present state without a step of delay.
        """
        with told():
            known = {ego: pose for ego, pose in poses.items() if self.knows(ego)}
            obey = [ego for ego in known if not self._turning.is_under_way(ego)]
            caps = {ego: self._yielding.cap(ego, self._lags[ego], self.step) for ego in obey}
            for ego, pose in known.items():
                ahead = max(pose.speed, 0.0) * self.step
                x, y = pose.x + ahead * math.cos(pose.yaw), pose.y + ahead * math.sin(pose.yaw)
                self._place(ego, pose._replace(x=x, y=y))
            self._pending = True
            libsumo.simulation.executeMove()
            self._note(fresh=True)
            wanted = {ego: self._intent(ego, pose.speed) for ego, pose in poses.items()}
            return {ego: it._replace(speed=min(it.speed, caps.get(ego, math.inf))) for ego, it in wanted.items()}

    def _intent(self, ego: str, present: float) -> Intent:
        lane = self.lane_of(ego)
        if not lane:
            return Intent(libsumo.vehicle.getSpeed(ego) if self.knows(ego) else 0.0)
        speed, change = self._yielding.obey(ego, braking.wish(ego, self.step), self.step), wishes.lane_change(ego)
        self._wished_on[ego] = lane
        if self.map.has_loops:
            speed = self._turning.speed(ego, lane, present, speed, self.neighbors)
            if self._turning.is_under_way(ego):
                return Intent(speed, top=libsumo.vehicle.getAllowedSpeed(ego))
        if change.needs_room and ego not in self._phantoms:
            speed = min(speed, braking.speed_for_room(ego, self.step))
        return Intent(speed, change.side, top=libsumo.vehicle.getAllowedSpeed(ego), blocked=change.blocked)

    def room(self, ego: str) -> float:
        """How far the ego can drive along its route without changing the lane [m]; 0 inside a junction."""
        return braking.room(ego)

    def rerouted(self, ego: str) -> bool:
        """Whether the ego's route has changed since the last call."""
        route = libsumo.vehicle.getRouteID(ego)
        before, self._routes[ego] = self._routes.get(ego, route), route
        return before != route

    def on_last_edge(self, ego: str) -> bool:
        """Whether the ego is on the last edge of its route."""
        return libsumo.vehicle.getRouteIndex(ego) == len(libsumo.vehicle.getRoute(ego)) - 1

    def search(self, ego: str) -> None:
        """Let SUMO find an ego that is off its route on any lane, and lead it from there to its destination."""
        self._searched.setdefault(ego, libsumo.vehicle.getRoute(ego)[-1])

    def commit(self, poses: dict[str, Pose]) -> None:
        """Write the true poses of the egos at the end of the step back and finish the step."""
        with told():
            for ego, pose in poses.items():
                if self.knows(ego):
                    self._place(ego, pose)
                else:
                    self._sight.close(ego)  # SUMO cannot finish the step with one that it has removed
            libsumo.simulation.step()
            self._note(fresh=False)
            self._pending = False
            for ego, pose in poses.items():
                if not (lane := self.lane_of(ego)):
                    continue
                self._lead_on(ego)
                stops.keep_on_lane(ego)  # those that SUMO has given it on its way
                if self._passages.note(ego, lane):
                    self.rerouted(ego)  # the way is the same
                speed = max(pose.speed, 0.0)
                libsumo.vehicle.setPreviousSpeed(ego, speed, pose.accel)
                self._phantoms.set_speed(ego, speed, pose.accel)

    def _lead_on(self, ego: str) -> None:
        """A searched ego is on a lane again: from there to where it wanted."""
        destination = self._searched.pop(ego, "")
        if destination and libsumo.vehicle.getRoute(ego)[-1] != destination:
            with contextlib.suppress(*SUMO_ERRORS):  # there may be no way: then the new route's end is the end
                libsumo.vehicle.changeTarget(ego, destination)

    def ask_for_room(self, ego: str, side: int) -> None:
        """Let SUMO look for a gap in the lane beside (side +1 left, -1 right, 0 no more): it adapts the ego's speed
        and neighbors make room, but the lane is changed by us alone."""
        if side == 0:
            libsumo.vehicle.setLaneChangeMode(ego, LANE_CHANGE_OURS)
            libsumo.vehicle.changeLane(ego, libsumo.vehicle.getLaneIndex(ego), 0.0)
        else:
            libsumo.vehicle.setLaneChangeMode(ego, LANE_CHANGE_DEFAULT)
            libsumo.vehicle.changeLane(ego, libsumo.vehicle.getLaneIndex(ego) + side, 1e6)

    def changed_lane(self, ego: str) -> None:
        """A lane change is done."""
        wishes.weigh_anew(ego)

    def hold(self, ego: str, side: int) -> None:
        """Hold the lane beside the ego's (side +1 left, -1 right, 0 none), as if the body were there too."""
        self._held[ego] = side

    def _bumper(self, ego: str, pose: Pose) -> tuple[float, float]:
        front = self._fronts[ego]
        return pose.x + front * math.cos(pose.yaw), pose.y + front * math.sin(pose.yaw)

    def _place(self, ego: str, pose: Pose) -> None:
        """Put the ego at a pose, and its phantom beside it where the body overlaps a second lane.

        The phantom gives traffic in both lanes the ego as its leader.
        """
        bumper = self._bumper(ego, pose)
        beside = self._turning.look(ego, *bumper) if self.map.has_loops else None
        if beside is not None:
            session.move(ego, beside.x, beside.y, beside.yaw)
            self._phantoms.drop(ego)
            return
        lane = self._overlapped(ego, pose)
        session.move(ego, *bumper, pose.yaw, keep_route=ego not in self._searched)
        if lane is None:
            self._phantoms.drop(ego)
        else:
            self._phantoms.place(ego, self.map.beside(lane, *bumper), self.step)

    def _overlapped(self, ego: str, pose: Pose) -> str | None:
        """The lane beside its own that the body reaches into at `pose`, or that it holds; or None.

        SUMO puts a vehicle on the lane that holds the center of its front bumper.
        """
        lane = self.lane_of(ego)
        if not lane or lane.startswith(":"):
            return None
        held = self.map.neighbor(lane, self._held[ego]) if self._held.get(ego) else None
        half = 0.5 * libsumo.lane.getWidth(lane)
        if abs(libsumo.vehicle.getLateralLanePosition(ego)) + 0.5 * self._widths[ego] + SIDE_STEP < half:
            return held  # well inside at the last step: spare the search for the nearest point
        offset = self.map.beside(lane, *self._bumper(ego, pose)).offset
        if abs(offset) > half:
            # the bumper crosses into the next lane: the body is still here
            return lane if self.map.neighbor(lane, 1 if offset > 0 else -1) else None
        if abs(offset) + 0.5 * self._widths[ego] <= half:
            return held
        return self.map.neighbor(lane, 1 if offset > 0 else -1)

    def mirror_error(self, ego: str, pose: Pose) -> float:
        """Distance [m] between SUMO's pose of the ego and `pose`; the yaw counts with the length of the car.

        Infinite off the road; not a number on a loop that SUMO's road has no room for.
        """
        if not self.lane_of(ego):
            return math.inf
        if self._turning.is_on(ego):
            return math.nan
        x, y = libsumo.vehicle.getPosition(ego)
        turn = math.radians(90.0 - libsumo.vehicle.getAngle(ego)) - pose.yaw
        turn = math.remainder(turn, 2.0 * math.pi)
        bumper = self._bumper(ego, pose)
        return math.hypot(x - bumper[0], y - bumper[1]) + abs(turn) * self._fronts[ego]

    def neighbors(self, ego: str) -> Traffic:
        """Traffic around the ego, without the ego and the phantoms."""
        return self._sight.traffic(ego)

    def lane_of(self, ego: str) -> str:
        """Lane that SUMO has the ego on; "" when it is off the road or gone."""
        try:
            return libsumo.vehicle.getLaneID(ego)
        except SUMO_ERRORS:
            return ""

    def knows(self, ego: str) -> bool:
        """Whether SUMO still has the vehicle; off the road it has it too."""
        try:
            return libsumo.vehicle.getRouteIndex(ego) >= 0  # far cheaper than the list of all
        except SUMO_ERRORS:
            return False

    def arrived(self, ego: str) -> bool:
        """Whether the ego is at the end of its route."""
        return self._arrivals.is_there(ego, self.step)

    def release(self, ego: str) -> None:
        """Take a driven vehicle and its phantom from the road: it has arrived, crashed or is lost."""
        self._phantoms.drop(ego)
        self._turning.drop(ego)
        with contextlib.suppress(*SUMO_ERRORS):
            self._sight.close(ego)
            libsumo.vehicle.remove(ego, REMOVE_ARRIVED)

    def collisions(self) -> list[tuple[str, str]]:
        """Colliding pairs that SUMO reports for the last step, without phantoms."""
        return [pair for pair in self._collisions if not any(name.startswith(phantom.PREFIX) for name in pair)]

    def vehicle_count(self) -> int:
        """Vehicles on the road, without phantoms."""
        return libsumo.vehicle.getIDCount() - len(self._phantoms) - self._turning.phantoms

    def road(self) -> Road:
        """Lanes outside junctions and the junctions' outlines."""
        return self.map.road()

    def close(self) -> None:
        """Complete a pending step and close SUMO; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        for end in (*([libsumo.simulation.step] if self._pending else []), session.close):
            with contextlib.suppress(*SUMO_ERRORS):
                end()
