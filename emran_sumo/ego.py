"""One vehicle that we drive: its path, its maneuver, its controller's memory, its trace and its events."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo import maneuver, metrics
from emran_sumo.conditioning import conditioned
from emran_sumo.errors import UserError
from emran_sumo.loop import (
    AT,
    TRACE,
    WIDTH,
    References,
    blank_networks,
    closed_loop,
    new_trace,
    start,
)
from emran_sumo.maneuver import DoubleLaneChange, Others
from emran_sumo.path import Path, lane_change_offset, nearest, path_length, project
from emran_sumo.plant.disturbance import drawn
from emran_sumo.plant.sensors import CHANNELS, noise_source
from emran_sumo.plant.vehicle import rolling_start
from emran_sumo.scenario import Scenario
from emran_sumo.world.records import Intent, Pose, TakeOver, Traffic

# columns that the host loop adds to the trace of the closed loop; held over one SUMO step
SAFETY = ("lead_gap", "time_to_collision", "deceleration_to_avoid", "mirror_error")
COLUMNS = (*TRACE, *SAFETY)
UNITS = {
    "time": "s", "x": "m", "y": "m", "yaw": "rad", "speed_long": "m/s", "speed_lat": "m/s", "yaw_rate": "rad/s",
    "accel_long": "m/s^2", "accel_lat": "m/s^2", "steer": "rad", "steer_command": "rad", "steer_law": "rad",
    "steer_network": "rad", "accel_command": "m/s^2", "accel_law": "m/s^2", "accel_network": "m/s^2", "torque": "N m",
    "wheel_speed_front": "rad/s", "wheel_speed_rear": "rad/s", "slip_angle_front": "rad", "slip_angle_rear": "rad",
    "force_long_front": "N", "force_long_rear": "N", "force_lat_front": "N", "force_lat_rear": "N",
    "load_front": "N", "load_rear": "N", "grade": "rad", "force_external_lat": "N", "speed_reference": "m/s",
    "accel_reference": "m/s^2", "speed_error": "m/s", "path_position": "m", "reference_x": "m", "reference_y": "m",
    "reference_yaw": "rad", "reference_curvature": "1/m", "cross_track_error": "m", "heading_error": "rad",
    "signal_speed": "m/s^2", "signal_steering": "rad", "lead_gap": "m", "time_to_collision": "s",
    "deceleration_to_avoid": "m/s^2", "mirror_error": "m",
}  # fmt: skip
NETWORK_COUNTS = slice(AT.grown_speed, AT.merged_steering + 1)
SIGHT = 300.0  # m around the ego in which traffic is looked at
AHEAD = 75.0  # m of path shown ahead of the ego
WAITING = "waiting for a gap"
NEAR_MISS = 1.0  # s time to collision


class Event(NamedTuple):
    """Something worth a line: time [s], level (DEBUG, INFO, WARN, ERROR) and text."""

    time: float
    level: str
    text: str


class Ego:
    """A vehicle under our control.

    Args:
        name: SUMO's id.
        scenario: Scenario.
        handed: TakeOver, what SUMO says at take-over.
    """

    def __init__(self, name: str, scenario: Scenario, handed: TakeOver) -> None:
        self.name = name
        self.scenario = scenario
        self.change = maneuver.declared(handed.params, name)
        self.lane_width = handed.lane_width
        self.base = handed.path
        self.path = self.base
        self.driven = self._conditioned(self.base, float(handed.pose.speed))
        pose = handed.pose
        self._refuse_missing_lane(handed)
        point = nearest(self.base, pose.x, pose.y, _first_guess(self.base, pose))
        self.route_offset = handed.route_position - point.position
        state = rolling_start(scenario.vehicle, float(pose.speed), pose.x, pose.y, pose.yaw)
        position = nearest(self.driven, pose.x, pose.y, point.position).position
        self.state = start(scenario.vehicle, state, position, scenario.longitudinal.feedforward)
        self.networks = blank_networks(scenario.control)
        self.tick = 0
        self.status = 0
        self.maneuver = "keep lane"
        self.begin: float | None = None  # position where the double lane change began [m]
        self.began: float | None = None  # and its time [s]
        self.events: list[Event] = []
        self.told = 0  # events already recorded
        self.frames: list[np.ndarray] = []
        self.collided: set[str] = set()
        self.lead = metrics.NO_LEAD
        self._near_miss = False
        self._speed_reference = float(pose.speed)
        self._accel = 0.0
        rates = scenario.rates
        self._periods = round(rates.sumo_step / rates.control_step)
        self._shares = np.arange(self._periods + 1) / self._periods
        self._disturbance = drawn(scenario.disturbance, scenario.seed)
        self._noise = noise_source(scenario.seed)

    def _refuse_missing_lane(self, handed: TakeOver) -> None:
        if self.change is None:
            return
        free = handed.lanes_left if self.change.side > 0 else handed.lanes_right
        if free < 1:
            side = "left" if self.change.side > 0 else "right"
            raise UserError(
                f'vehicle "{self.name}": param double_lane_change.direction: found "{side}", but there is no lane on '
                "that side; accepted is the other direction or another departLane."
            )

    @property
    def pose(self) -> Pose:
        """Pose that SUMO is to mirror."""
        car = self.state.vehicle
        return Pose(car.x, car.y, car.yaw, car.speed_long, self._accel)

    @property
    def time(self) -> float:
        """Time since take-over [s]."""
        return self.tick * self.scenario.rates.control_step

    @property
    def wanted_side(self) -> int:
        """Side on which a gap is wanted: +1 left, -1 right, 0 none."""
        return self.change.side if self.change is not None and self.maneuver == WAITING else 0

    @property
    def arrived(self) -> bool:
        """Whether the path ends within the next second."""
        ahead = path_length(self.path) - self.state.position
        return ahead < max(self.state.vehicle.speed_long, 1.0) + self.scenario.vehicle.length

    def follow(self, intent: Intent) -> None:
        """Take over what the world wants for this step: the cruise reference."""
        self._wanted = intent

    def advance(self) -> np.ndarray:
        """Drive one SUMO step; returns its trace rows (n, columns)."""
        rates = self.scenario.rates
        references = self._references(self._wanted)
        rows = new_trace(self._periods)
        before = self.state.vehicle.speed_long
        s = self.scenario
        self.state, self.status, count = closed_loop(
            s.vehicle, s.control, self._disturbance, s.road.friction, s.clock(self.tick), references,
            self.state, self.networks.speed, self.networks.steering, rows,
        )  # fmt: skip
        self._speed_reference = self._wanted.speed
        self._accel = (self.state.vehicle.speed_long - before) / rates.sumo_step
        self.tick += count
        self._note_networks(rows[:count])
        return rows[:count]

    def _references(self, wanted: Intent) -> References:
        """The profile within the step, where the world knows it, or a straight line to the wished speed."""
        speeds, accels = wanted.speeds, wanted.accels
        if speeds is None or accels is None:
            rise = wanted.speed - self._speed_reference
            speeds = self._speed_reference + rise * self._shares
            accels = np.full(self._periods, rise / self.scenario.rates.sumo_step)
        noise = self._noise.standard_normal((self._periods, CHANNELS))
        return References(self.path, self.driven, speeds, accels, noise)

    def observe(self, traffic: Traffic, mirror_error: float, rows: np.ndarray) -> np.ndarray:
        """Look around after a step: lead, collisions, maneuver. Returns the rows with the safety columns."""
        others = self._seen(traffic)
        self.lead = self._find_lead(others)
        self._note_near_miss()
        self._find_collisions(traffic)
        self._steer_maneuver(others)
        extra = [self.lead.gap, self.lead.time_to_collision, self.lead.deceleration_to_avoid, mirror_error]
        full = np.column_stack((rows, np.tile(extra, (len(rows), 1))))
        self.frames.append(full)
        return full

    def reference_ahead(self) -> np.ndarray:
        """(n, 2) points of the path ahead."""
        first = int(self.state.position / self.path.spacing)
        last = min(first + int(AHEAD / self.path.spacing), self.path.x.size)
        return np.column_stack((self.path.x[first:last:8], self.path.y[first:last:8]))

    def trace(self) -> np.ndarray:
        """All rows so far (n, len(COLUMNS))."""
        return np.concatenate(self.frames) if self.frames else np.zeros((0, len(COLUMNS)))

    def _seen(self, traffic: Traffic) -> Others:
        """Traffic in coordinates of the lane the ego started in."""
        car = self.state.vehicle
        here = nearest(self.base, car.x, car.y, self._base_position())
        along = project(self.base, traffic.x, traffic.y, here.position, SIGHT)
        center = self._center_ahead()
        return Others(along[:, 0] - here.position - center, along[:, 1], traffic.speed, traffic.length, traffic.width)

    def _base_position(self) -> float:
        # the maneuver's path is longer than the lane by less than this search tolerates
        return self.state.position

    def _center_ahead(self) -> float:
        """From the center of gravity forward to the center of the body [m]."""
        v = self.scenario.vehicle
        return v.front_axle + v.front_overhang - 0.5 * v.length

    def _find_lead(self, others: Others) -> metrics.Lead:
        """The nearest vehicle ahead whose body overlaps the corridor that the ego will sweep."""
        if others.ahead.size == 0:
            return metrics.NO_LEAD
        v = self.scenario.vehicle
        offset = self._path_offset(others.ahead)
        inside = np.abs(others.offset - offset) < 0.5 * (others.width + v.width)
        gap = others.ahead - 0.5 * (others.length + v.length)
        candidates = np.flatnonzero(inside & (others.ahead > 0.0))
        if candidates.size == 0:
            return metrics.NO_LEAD
        k = candidates[np.argmin(gap[candidates])]
        return metrics.lead(float(gap[k]), self.state.vehicle.speed_long, float(others.speed[k]))

    def _path_offset(self, ahead: np.ndarray) -> np.ndarray:
        """Lateral offset of the path from the lane at distances ahead of the ego."""
        if self.begin is None or self.change is None:
            return np.zeros_like(ahead)
        changes = maneuver.transitions(self.change, self.begin, self.lane_width)
        return lane_change_offset(changes, self.state.position + ahead)[0]

    def _note_near_miss(self) -> None:
        near = self.lead.time_to_collision < NEAR_MISS
        if near and not self._near_miss:
            self._say(
                "WARN",
                f"near miss: {self.lead.time_to_collision:.1f} s to a collision, gap {self.lead.gap:.1f} m",
            )
        self._near_miss = near

    def _find_collisions(self, traffic: Traffic) -> None:
        car, v = self.state.vehicle, self.scenario.vehicle
        center = self._center_ahead()
        x, y = car.x + center * math.cos(car.yaw), car.y + center * math.sin(car.yaw)
        own = metrics.Box(x, y, car.yaw, v.length, v.width)
        near = np.flatnonzero(np.hypot(traffic.x - x, traffic.y - y) < 0.5 * (v.length + traffic.length) + v.width)
        for k in near:
            other = metrics.Box(
                *(float(a[k]) for a in (traffic.x, traffic.y, traffic.yaw, traffic.length, traffic.width))
            )
            name = traffic.ids[k]
            if metrics.boxes_overlap(own, other) and name not in self.collided:
                self.collided.add(name)
                self._say(
                    "ERROR",
                    f"collision with {name} at {car.speed_long:.1f} m/s, the other at {traffic.speed[k]:.1f} m/s",
                )

    def _steer_maneuver(self, others: Others) -> None:
        """Begin the declared double lane change where a gap is free; follow it to its end."""
        change = self.change
        if change is None:
            return
        if self.begin is None:
            self._try_to_begin(change, others)
            return
        done = self.state.position - self.begin
        if done > change.length and self.maneuver != "keep lane":
            rows = np.concatenate([frame[-1:] for frame in self.frames])
            errors = rows[rows[:, AT.path_position] > self.begin, AT.cross_track_error]
            worst = np.abs(errors).max(initial=0.0)
            self._enter("keep lane", f"double lane change done, largest cross-track error {worst:.3f} m")
            self.change = None
        elif done > change.back_start - 5.0:
            self._enter("change right" if change.side > 0 else "change left", "back to the own lane")
        elif done > maneuver.OUT_START - 10.0:
            side = "left" if change.side > 0 else "right"
            self._enter(f"change {side}", f"out to the lane on the {side}")

    def _try_to_begin(self, change: DoubleLaneChange, others: Others) -> None:
        position = self.state.position + self.route_offset
        if position < change.start:
            return
        car, v = self.state.vehicle, self.scenario.vehicle
        if path_length(self.base) - self.state.position < change.length + 50.0:
            if self.maneuver != "keep lane":
                self._enter("keep lane", "no free gap before the end of the road: double lane change given up", "WARN")
            self.change = None
            return
        if not maneuver.gap_is_free(change, others, car.speed_long, v.length, self.lane_width):
            self._enter(WAITING, "double lane change wanted, waiting for a gap")
            return
        self.begin, self.began = self.state.position, self.time
        self.path = maneuver.maneuver_path(self.base, change, self.begin, self.lane_width)
        self.driven = self._conditioned(self.path, car.speed_long)
        position = nearest(self.driven, car.x, car.y, self.begin).position
        self.state = self.state._replace(position=position)
        self._enter("double lane change", f"double lane change begins at {car.speed_long:.1f} m/s")

    def _conditioned(self, path: Path, speed: float) -> Path:
        lateral = self.scenario.lateral
        return conditioned(path, lateral, self.scenario.vehicle, speed) if lateral.conditioning else path

    def _enter(self, name: str, text: str, level: str = "INFO") -> None:
        if name != self.maneuver:
            self.maneuver = name
            self._say(level, text)

    def _say(self, level: str, text: str) -> None:
        self.events.append(Event(self.time, level, text))

    def _note_networks(self, rows: np.ndarray) -> None:
        last = self.frames[-1][-1] if self.frames else np.zeros(WIDTH)
        if not rows.size or np.array_equal(rows[-1, NETWORK_COUNTS], last[NETWORK_COUNTS]):
            return
        for row in rows:
            for net in ("steering", "speed"):
                count = int(row[getattr(AT, f"neurons_{net}")])
                for word, what in (("grown", "added"), ("pruned", "pruned"), ("merged", "merged")):
                    at = getattr(AT, f"{word}_{net}")
                    if row[at] > last[at]:
                        plural = "neuron" if count == 1 else "neurons"
                        text = f"{net} network: neuron {what}, {count} {plural}"
                        self.events.append(Event(float(row[AT.time]), "DEBUG", text))
            last = row


def _first_guess(path, pose: Pose) -> float:
    """Position of the grid point nearest to a pose."""
    return float(np.argmin((path.x - pose.x) ** 2 + (path.y - pose.y) ** 2)) * path.spacing


def learning_state(rows: np.ndarray, before: np.ndarray | None, aided: bool) -> str:
    """Whether the networks learned during these rows: off, learning or settled."""
    if not aided:
        return "off"
    first = before if before is not None else rows[0]
    grew = any(rows[-1, at] > first[at] for at in (AT.learned_speed, AT.learned_steering))
    return "learning" if grew else "settled"
