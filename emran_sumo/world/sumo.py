"""The only door to libsumo: start, take over, propose, commit; SUMO's compass and bumper points stay in here."""

import contextlib
import math
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import libsumo
import numpy as np

from emran_sumo.errors import UserError
from emran_sumo.world.lanes import joined, smooth_path
from emran_sumo.world.records import NOBODY, Intent, Lane, Pose, Road, TakeOver, Traffic
from emran_sumo.world.routes import DOUBLE_LANE_CHANGE

SIGHT = 300.0  # m around the ego in which traffic is read
SIDE_STEP = 0.3  # m: more than a car moves sideways in one step
PHANTOM = "emran_sumo.phantom."  # holds the second lane while the ego's body overlaps it
KEEP_ROUTE_EXACT = 3  # moveToXY: keep the route and take the pose as it is
LANE_CHANGE_OURS = 0  # setLaneChangeMode: SUMO neither changes the lane nor adapts the speed for a change
LANE_CHANGE_DEFAULT = 1621
WAIT_FOR_DEPARTURE = 300.0  # s beyond the warm-up
SUMO_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


class SumoWorld:
    """One SUMO simulation in this process, with one or more vehicles driven from outside.

    Use as a context manager: whatever ends the block, the last step is completed and SUMO is closed (a pose that
    is still pending at close would remove the vehicle of the same id from the next simulation of the process).

    Args:
        network, route_files: of the simulation; the files are read in order.
        step: [s]; seed: of SUMO.
        front: distance from the center of gravity to the front bumper [m].
        driver_step: how often other drivers decide [s]; 0 for every step.
        speed_limit: of every lane outside ramps and junctions [m/s]; 0 keeps the network's.
        gui: open SUMO's own window.

    Raises:
        UserError: with SUMO's own reason when it cannot start.
    """

    def __init__(
        self,
        network: Path,
        route_files: list[Path],
        step: float,
        seed: int,
        front: float,
        speed_limit: float = 0.0,
        driver_step: float = 0.0,
        gui: bool = False,
    ) -> None:
        self.step = step
        self._front = front
        self._pending = False
        self._sizes: dict[str, tuple[float, float, float]] = {}
        self._phantoms: set[str] = set()
        self._widths: dict[str, float] = {}
        self._lines: dict[str, np.ndarray] = {}
        self._closed = False
        self._last_message = ""
        self._start(network, route_files, seed, driver_step, gui)
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

    def _start(self, network: Path, route_files: list[Path], seed: int, driver_step: float, gui: bool) -> None:
        for kind, file in [("network", network), *(("route", file) for file in route_files)]:
            if not file.is_file():
                raise UserError(f"{file}: no such {kind} file.")
        if gui and os.name == "posix" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise UserError("--sumo-gui: there is no display; accepted is a session with one (DISPLAY is not set).")
        options = {
            "net-file": str(network),
            "route-files": ",".join(map(str, route_files)),
            "step-length": f"{self.step:g}",
            "step-method.ballistic": "true",
            "seed": str(seed),
            "default.action-step-length": f"{driver_step:g}",
            "collision.action": "warn",
            "collision.mingap-factor": "0",
            "collision.check-junctions": "true",
            "time-to-teleport": "-1",
            "no-step-log": "true",
            "no-warnings": "true",
            "duration-log.disable": "true",
            "xml-validation": "never",
        }
        command = ["sumo-gui" if gui else "sumo"]
        for key, value in options.items():
            command += [f"--{key}", value]
        if gui:
            command += ["--start", "--quit-on-end", "--delay", f"{self.step * 1000:g}"]
        with _messages() as read:
            try:
                libsumo.start(command)
            except SUMO_ERRORS as error:
                reason = read() or str(error)
                raise UserError(f"SUMO cannot start with {network}: {_one_line(reason)}") from None

    def _limit_speed(self, limit: float) -> None:
        if limit <= 0.0:
            return
        main = max(libsumo.lane.getMaxSpeed(lane) for lane in libsumo.lane.getIDList())
        for lane in libsumo.lane.getIDList():
            if libsumo.lane.getMaxSpeed(lane) > 0.9 * main:
                libsumo.lane.setMaxSpeed(lane, limit)

    def warm_up(self, duration: float) -> Iterator[float]:
        """Step SUMO alone for `duration` [s]; yields the simulated time."""
        for _ in range(round(duration / self.step)):
            self._advance()
            yield self.time

    def wait_for(self, ego: str, files: list[Path]) -> None:
        """Step until `ego` is on the road.

        Raises:
            UserError: it does not depart in WAIT_FOR_DEPARTURE seconds, or has left already.
        """
        end = self.time + WAIT_FOR_DEPARTURE
        while ego not in libsumo.vehicle.getIDList():
            if libsumo.simulation.getMinExpectedNumber() == 0 or self.time > end:
                names = ", ".join(str(file) for file in files)
                said = f" SUMO said: {_one_line(self._last_message)}" if self._last_message else ""
                raise UserError(
                    f'ego: vehicle "{ego}" of {names} was not on the road when the warm-up ended or within '
                    f"{WAIT_FOR_DEPARTURE:g} s after it; it must have departed by then and not have arrived.{said}"
                )
            self._advance()

    def take_over(self, ego: str, width: float) -> TakeOver:
        """Drive `ego`, `width` [m] wide, from outside; it stays an ordinary vehicle for everybody else."""
        vehicle = libsumo.vehicle
        self._widths[ego] = width
        vehicle.setLaneChangeMode(ego, LANE_CHANGE_OURS)
        vehicle.setActionStepLength(ego, self.step)
        vehicle.subscribeContext(
            ego,
            libsumo.CMD_GET_VEHICLE_VARIABLE,
            SIGHT,
            [libsumo.VAR_POSITION, libsumo.VAR_ANGLE, libsumo.VAR_SPEED],
        )
        lane = vehicle.getLaneID(ego)
        edge, index = libsumo.lane.getEdgeID(lane), vehicle.getLaneIndex(ego)
        position, angle = vehicle.getPosition(ego), vehicle.getAngle(ego)
        yaw = math.radians(90.0 - angle)
        x, y = position[0] - self._front * math.cos(yaw), position[1] - self._front * math.sin(yaw)
        pose = Pose(x, y, yaw, vehicle.getSpeed(ego), vehicle.getAcceleration(ego))
        params = {key: vehicle.getParameter(ego, key) for key in DOUBLE_LANE_CHANGE}
        return TakeOver(
            pose,
            smooth_path(self._center_line(ego, lane)),
            libsumo.lane.getWidth(lane),
            libsumo.edge.getLaneNumber(edge) - 1 - index,
            index,
            {key: value for key, value in params.items() if value},
            self._route_position(ego) - self._front,
        )

    def _route_position(self, ego: str) -> float:
        """Distance [m] of the front bumper from the start of the route's first edge, junctions not counted."""
        passed = libsumo.vehicle.getRoute(ego)[: libsumo.vehicle.getRouteIndex(ego)]
        before = sum(libsumo.lane.getLength(f"{edge}_0") for edge in passed)
        return before + libsumo.vehicle.getLanePosition(ego)

    def _center_line(self, ego: str, lane: str) -> np.ndarray:
        """Center line of the lanes that lead from `lane` along the route, and back over the lane before it."""
        route = list(libsumo.vehicle.getRoute(ego))
        at = libsumo.vehicle.getRouteIndex(ego)
        chain = [*self._lanes_before(lane, route[:at]), lane]
        for edge in route[at + 1 :]:
            links = [link for link in libsumo.lane.getLinks(chain[-1]) if libsumo.lane.getEdgeID(link[0]) == edge]
            if not links:
                break
            target, via = links[0][0], links[0][4]
            while via and libsumo.lane.getEdgeID(via).startswith(":"):
                chain.append(via)
                inner = libsumo.lane.getLinks(via)
                via = inner[0][4] if inner else ""
            chain.append(target)
        return joined([_shape(name) for name in chain])

    def _lanes_before(self, lane: str, edges: list[str]) -> list[str]:
        """The lane of the edge before that leads into `lane`: the rear of the car may still be there."""
        if not edges:
            return []
        count = libsumo.edge.getLaneNumber(edges[-1])
        for candidate in (f"{edges[-1]}_{i}" for i in range(count)):
            for link in libsumo.lane.getLinks(candidate):
                if link[0] == lane:
                    return [candidate, link[4]] if link[4] else [candidate]
        return []

    def propose(self, poses: dict[str, Pose]) -> dict[str, Intent]:
        """What SUMO wants of each ego for the step that begins now.

        Each ego is first moved to where it would be at constant speed; SUMO then decides (`executeMove`), so that its
        wish answers the present state without a step of delay.
        """
        with _told():
            for ego, pose in poses.items():
                ahead = pose.speed * self.step
                x, y = pose.x + ahead * math.cos(pose.yaw), pose.y + ahead * math.sin(pose.yaw)
                self._place(ego, pose._replace(x=x, y=y))
            self._pending = True
            libsumo.simulation.executeMove()
            return {ego: Intent(self._wish(ego)) for ego in poses}

    def _wish(self, ego: str) -> float:
        """Speed [m/s] that SUMO wants; 0 where it wants a stop within the step.

        To SUMO that is a negative speed, in whose place it reports the present one: the ego would creep on.
        """
        wish, present = libsumo.vehicle.getSpeedWithoutTraCI(ego), libsumo.vehicle.getSpeed(ego)
        stops = wish == present <= libsumo.vehicle.getEmergencyDecel(ego) * self.step
        return 0.0 if stops else max(wish, 0.0)

    def commit(self, poses: dict[str, Pose]) -> None:
        """Write the true poses of the egos at the end of the step back and finish the step."""
        with _told():
            for ego, pose in poses.items():
                self._place(ego, pose)
            libsumo.simulation.step()
            self._pending = False
            for ego, pose in poses.items():
                libsumo.vehicle.setPreviousSpeed(ego, pose.speed, pose.accel)
                if PHANTOM + ego in self._phantoms:
                    libsumo.vehicle.setPreviousSpeed(PHANTOM + ego, pose.speed, pose.accel)

    def ask_for_room(self, ego: str, side: int) -> None:
        """Let SUMO look for a gap in the lane beside (side +1 left, -1 right, 0 no more): it adapts the ego's speed
        and neighbors make room, but the lane is changed by us alone."""
        if side == 0:
            libsumo.vehicle.setLaneChangeMode(ego, LANE_CHANGE_OURS)
            libsumo.vehicle.changeLane(ego, libsumo.vehicle.getLaneIndex(ego), 0.0)
        else:
            libsumo.vehicle.setLaneChangeMode(ego, LANE_CHANGE_DEFAULT)
            libsumo.vehicle.changeLane(ego, libsumo.vehicle.getLaneIndex(ego) + side, 1e6)

    def _move(self, vehicle: str, x: float, y: float, yaw: float) -> None:
        bumper_x, bumper_y = x + self._front * math.cos(yaw), y + self._front * math.sin(yaw)
        angle = (90.0 - math.degrees(yaw)) % 360.0
        libsumo.vehicle.moveToXY(vehicle, "", -1, bumper_x, bumper_y, angle, KEEP_ROUTE_EXACT)

    def _place(self, ego: str, pose: Pose) -> None:
        """Put the ego at a pose, and its phantom beside it where the body overlaps a second lane.

        The phantom gives traffic in both lanes the ego as its leader.
        """
        lane = self._overlapped(ego, pose)
        self._move(ego, pose.x, pose.y, pose.yaw)
        phantom = PHANTOM + ego
        if lane is None:
            if phantom in self._phantoms:
                libsumo.vehicle.remove(phantom)
                self._phantoms.remove(phantom)
            return
        if phantom not in self._phantoms:
            self._add_phantom(ego, phantom)
        bumper = (pose.x + self._front * math.cos(pose.yaw), pose.y + self._front * math.sin(pose.yaw))
        x, y, yaw = _beside(self._line(lane), bumper)
        libsumo.vehicle.moveToXY(phantom, "", -1, x, y, (90.0 - math.degrees(yaw)) % 360.0, KEEP_ROUTE_EXACT)

    def _add_phantom(self, ego: str, phantom: str) -> None:
        vehicle = libsumo.vehicle
        # the ego's own copy of its type ("type@ego") dies with the first vehicle that has it: take the original
        vehicle.add(phantom, "", vehicle.getTypeID(ego).partition("@")[0])
        vehicle.setRoute(phantom, vehicle.getRoute(ego)[vehicle.getRouteIndex(ego) :])
        vehicle.setLaneChangeMode(phantom, LANE_CHANGE_OURS)
        vehicle.setActionStepLength(phantom, self.step)
        self._phantoms.add(phantom)

    def _overlapped(self, ego: str, pose: Pose) -> str | None:
        """The lane beside its own that the body reaches into at `pose`, or None.

        SUMO puts a vehicle on the lane that holds the center of its front bumper.
        """
        lane = libsumo.vehicle.getLaneID(ego)
        edge = libsumo.lane.getEdgeID(lane) if lane else ":"
        if edge.startswith(":"):
            return None
        half = 0.5 * libsumo.lane.getWidth(lane)
        if abs(libsumo.vehicle.getLateralLanePosition(ego)) + 0.5 * self._widths[ego] + SIDE_STEP < half:
            return None  # well inside at the last step: spare the search for the nearest point
        front = (pose.x + self._front * math.cos(pose.yaw), pose.y + self._front * math.sin(pose.yaw))
        x, y, yaw = _beside(self._line(lane), front)
        offset = -(front[0] - x) * math.sin(yaw) + (front[1] - y) * math.cos(yaw)
        if abs(offset) > half:
            return lane  # the bumper crosses into the next lane: the body is still here
        if abs(offset) + 0.5 * self._widths[ego] <= half:
            return None
        index = int(lane.rsplit("_", 1)[1]) + (1 if offset > 0 else -1)
        return f"{edge}_{index}" if 0 <= index < libsumo.edge.getLaneNumber(edge) else None

    def _line(self, lane: str) -> np.ndarray:
        """Center line (n, 2) of a lane, asked of SUMO once."""
        if lane not in self._lines:
            self._lines[lane] = _shape(lane)[:, :2]
        return self._lines[lane]

    def mirror_error(self, ego: str, pose: Pose) -> float:
        """Distance [m] between SUMO's pose of the ego and `pose`; the yaw counts with the length of the car."""
        if not self.lane_of(ego):
            return math.inf
        x, y = libsumo.vehicle.getPosition(ego)
        turn = math.radians(90.0 - libsumo.vehicle.getAngle(ego)) - pose.yaw
        turn = math.remainder(turn, 2.0 * math.pi)
        dx = x - pose.x - self._front * math.cos(pose.yaw)
        dy = y - pose.y - self._front * math.sin(pose.yaw)
        return math.hypot(dx, dy) + abs(turn) * self._front

    def neighbors(self, ego: str) -> Traffic:
        """Traffic within SIGHT of the ego, without the ego and its phantom."""
        seen = libsumo.vehicle.getContextSubscriptionResults(ego)
        ids = [name for name in seen if name != ego and not name.startswith(PHANTOM)]
        if not ids:
            return NOBODY
        raw = np.array(
            [(*seen[i][libsumo.VAR_POSITION], seen[i][libsumo.VAR_ANGLE], seen[i][libsumo.VAR_SPEED]) for i in ids]
        )
        length, width, height = np.array([self._size(name) for name in ids]).T
        yaw = np.radians(90.0 - raw[:, 2])
        x = raw[:, 0] - 0.5 * length * np.cos(yaw)
        y = raw[:, 1] - 0.5 * length * np.sin(yaw)
        return Traffic(tuple(ids), x, y, yaw, length, width, height, raw[:, 3])

    def _size(self, name: str) -> tuple[float, float, float]:
        size = self._sizes.get(name)
        if size is None:
            vehicle = libsumo.vehicle
            size = self._sizes[name] = (vehicle.getLength(name), vehicle.getWidth(name), vehicle.getHeight(name))
        return size

    def lane_of(self, ego: str) -> str:
        """Lane that SUMO has the ego on; "" when it is off the road or gone."""
        try:
            return libsumo.vehicle.getLaneID(ego)
        except SUMO_ERRORS:
            return ""

    def collisions(self) -> list[tuple[str, str]]:
        """Colliding pairs that SUMO reports for the last step, without phantoms."""
        found = libsumo.simulation.getCollisions()
        pairs = [(c.collider, c.victim) for c in found]
        return [pair for pair in pairs if not any(name.startswith(PHANTOM) for name in pair)]

    def vehicle_count(self) -> int:
        """Vehicles on the road, without phantoms."""
        return libsumo.vehicle.getIDCount() - len(self._phantoms)

    def road(self) -> Road:
        """Lanes outside junctions and the junctions' outlines."""
        lanes = []
        for edge in libsumo.edge.getIDList():
            if edge.startswith(":"):
                continue
            count = libsumo.edge.getLaneNumber(edge)
            for index in range(count):
                name = f"{edge}_{index}"
                lanes.append(Lane(name, edge, index, count, libsumo.lane.getWidth(name), _shape(name)))
        shapes = [np.array(libsumo.junction.getShape(name)) for name in libsumo.junction.getIDList()]
        return Road(tuple(lanes), tuple(shape[:, :2] for shape in shapes if shape.ndim == 2 and len(shape) > 2))

    def _advance(self) -> None:
        with _messages() as read, _told():
            libsumo.simulation.step()
            self._last_message = read() or self._last_message

    def close(self) -> None:
        """Complete a pending step and close SUMO; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(*SUMO_ERRORS):
            if self._pending:
                libsumo.simulation.step()
        with contextlib.suppress(*SUMO_ERRORS):
            libsumo.close()


def version() -> str:
    """Version of SUMO."""
    return libsumo.getVersion()[1].removeprefix("SUMO ")


def _shape(lane: str) -> np.ndarray:
    """Center line (n, 3) of a lane."""
    shape = np.array(libsumo.lane.getShape(lane), dtype=float)
    return shape if shape.shape[1] == 3 else np.column_stack((shape, np.zeros(len(shape))))


def _beside(line: np.ndarray, point: tuple[float, float]) -> tuple[float, float, float]:
    """Nearest point of a polyline (n, 2) and its direction [rad]."""
    start, along = line[:-1], np.diff(line, axis=0)
    share = np.clip(((point - start) * along).sum(1) / (along**2).sum(1), 0.0, 1.0)
    foot = start + share[:, None] * along
    k = int(np.argmin(((foot - point) ** 2).sum(1)))
    return float(foot[k, 0]), float(foot[k, 1]), math.atan2(along[k, 1], along[k, 0])


def _one_line(text: str) -> str:
    lines = [line.strip().removeprefix("Error:").strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("Quitting")]
    text = " ".join(lines)
    return text if text.endswith(".") else text + "."


@contextlib.contextmanager
def _messages():
    """Catch what SUMO writes to file descriptor 2, the only place where it tells why it cannot start."""
    with tempfile.TemporaryFile() as sink:
        saved = os.dup(2)
        os.dup2(sink.fileno(), 2)

        def read() -> str:
            sink.seek(0)
            return sink.read().decode(errors="replace")

        try:
            yield read
        finally:
            os.dup2(saved, 2)
            os.close(saved)


@contextlib.contextmanager
def _told():
    """Turn SUMO's exceptions, which cannot even be pickled, into a plain sentence."""
    try:
        yield
    except SUMO_ERRORS as error:
        raise UserError(f"SUMO stopped: {_one_line(str(error))}") from None
