"""One vehicle that we drive: its controller's memory, its path, its trace and its events."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo import metrics
from emran_sumo.conditioning import conditioned
from emran_sumo.encounters import Encounters, body
from emran_sumo.frames import Frames
from emran_sumo.handover import BLEND_SHARES, begin, caps
from emran_sumo.loop import AT, TRACE, WIDTH, References, blank_networks, closed_loop, new_trace, start
from emran_sumo.own_controller import OwnController
from emran_sumo.path import Path, first_near, interpolate, nearest, path_length, project
from emran_sumo.plant.disturbance import drawn
from emran_sumo.plant.sensors import CHANNELS, noise_source
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.reference import SpeedReference
from emran_sumo.scenario import Scenario
from emran_sumo.world.persons import ON_WALKING_AREA
from emran_sumo.world.records import NOBODY, Intent, Others, Pose, TakeOver, Traffic

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
NEAR_MISS = 1.0  # s time to collision
SETTLED_AFTER = 1.0  # s without a sample that changes a network
LOST_WITHIN = 15.0  # m around it in which a bend may have lost the car
ALIGNED = 0.7  # cosine between a body and the path above which it goes the ego's way: others cross or come
BESIDE = 0.5  # m that bodies may overlap along the lane while one is still ahead


class Event(NamedTuple):
    """Something worth a line: time [s], level (DEBUG, INFO, WARN, ERROR) and text."""

    time: float
    level: str
    text: str


def fitted(vehicle: VehicleParams, length: float, width: float) -> VehicleParams:
    """The vehicle with the outline of a SUMO vehicle: wheelbase and overhangs scale with the length."""
    scale = length / vehicle.length
    return vehicle._replace(
        length=length,
        width=width,
        front_axle=vehicle.front_axle * scale,
        rear_axle=vehicle.rear_axle * scale,
        front_overhang=vehicle.front_overhang * scale,
    )


class Ego:
    """A vehicle under our control.

    Args:
        name: its id.
        scenario: Scenario.
        vehicle: VehicleParams that fit its outline.
        handed: TakeOver.
        time: of the simulation at take-over [s].
        index: number of this ego in the run; egos draw different noise.
        own: the user's own controller; None for the built-in laws.
    """

    def __init__(
        self, name: str, scenario: Scenario, vehicle: VehicleParams, handed: TakeOver, time: float, index: int = 0,
        own: OwnController | None = None,
    ) -> None:  # fmt: skip
        self.name, self.scenario, self.vehicle, self.own = name, scenario, vehicle, own
        self._drive = closed_loop if own is None else own.closed_loop
        self.lane_width = handed.lane_width
        self.began_at = time
        at = begin(handed, scenario, vehicle)
        pose = at.pose
        self.base = self.path = self.driven = at.path
        self._origin = 0.0
        self.state = start(
            vehicle, scenario.longitudinal, scenario.lateral, at.car, at.position, scenario.rates.control_step
        )
        self.take_path(at.path, at.way, bends=at.way is not at.path)
        self.route_offset = handed.route_position - self.state.position
        self.control = scenario.control
        self.networks = blank_networks(self.control)
        self.tick = 0
        self.status = 0
        self.maneuver = scenario.track.maneuver if scenario.world == "track" else "keep lane"
        self.events: list[Event] = []
        self.told = 0  # events already recorded
        self._learned = -math.inf  # s, when a sample last changed a network
        self.frames = Frames(len(COLUMNS))
        self.collided: dict[str, str] = {}  # with whom, and how
        self._met: set[str] = set()  # touched before
        self.lead = metrics.NO_LEAD
        self.encounters = Encounters()
        self._near_miss = self._conflict = False
        self._accel = 0.0
        self._mirrored = Pose(pose.x, pose.y, pose.yaw, float(pose.speed), 0.0)
        rates = scenario.rates
        most = scenario.longitudinal.decel_max
        self._reference = SpeedReference(float(pose.speed), float(pose.accel), rates.sumo_step, most)
        self._periods = round(rates.sumo_step / rates.control_step)
        self._shares = np.arange(self._periods + 1) / self._periods
        self._disturbance = drawn(scenario.disturbance, scenario.seed)
        self._noise = noise_source(scenario.seed, index)
        if pose.speed < handed.pose.speed:
            self.say("WARN", f"starts at {pose.speed:.1f} m/s in place of {handed.pose.speed:.1f}: a bend is ahead")

    @property
    def pose(self) -> Pose:
        """Pose that SUMO is to mirror; it never moves backward, which SUMO would read as a jump around the route."""
        return self._mirrored

    @property
    def time(self) -> float:
        """Time since take-over [s]."""
        return self.tick * self.scenario.rates.control_step

    @property
    def position(self) -> float:
        """Distance along the route of the vehicle, junctions not counted [m]."""
        return self.state.position + self.offset

    @property
    def offset(self) -> float:
        """Position along the route where the path that it follows begins [m]."""
        return self._origin + self.route_offset

    @property
    def speed(self) -> float:
        """Along the body [m/s]."""
        return self.state.vehicle.speed_long

    @property
    def path_ended(self) -> bool:
        """Whether the path ends within the next second."""
        ahead = path_length(self.path) - self.state.position
        return ahead < max(self.speed, 1.0) + self.vehicle.length

    def can_drive(self, path: Path, length: float) -> bool:
        """Whether speed and steering allow the next `length` [m] of a path from lane to lane, that begins here."""
        car, v = self.state.vehicle, self.vehicle
        here = nearest(path, car.x, car.y, first_near(path, car.x, car.y, car.yaw)).position
        # half a meter further: behind the car the path goes on straight
        first, last = (int((here + ahead) / path.spacing) for ahead in (0.5, length + 0.5))
        own = path._replace(**{name: getattr(path, name)[first:last] for name in path._fields[:5]})
        if own.curvature.size == 0:
            return False
        if np.abs(own.curvature).max() * (v.front_axle + v.rear_axle) > math.tan(v.steer_limit):
            return False
        return self.speed <= caps(own, self.scenario, *BLEND_SHARES)[0]

    def take_path(self, base: Path, path: Path, bends: bool = False) -> None:
        """Follow `path` from here on; `base` is the center line of the lane that it belongs to or leads to.

        bends: the speed comes down before the bends of `path` too, not of `base` alone.
        """
        before = self.state.position
        car = self.state.vehicle
        self.base, self.path = base, path
        lateral = self.scenario.lateral
        speed = float(max(car.speed_long, 1.0))
        self.driven = conditioned(path, lateral, self.vehicle, speed) if lateral.conditioning else path
        guess = first_near(self.driven, car.x, car.y, car.yaw)
        position = nearest(self.driven, car.x, car.y, guess).position
        self._origin += before - position
        self.state = self.state._replace(position=position)
        self._cap = caps(base, self.scenario)
        if bends:
            own = caps(path, self.scenario, *BLEND_SHARES)
            count = min(own.size, self._cap.size)
            self._cap[:count] = np.minimum(self._cap[:count], own[:count])

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
        self.state, self.status, count = self._drive(
            self.vehicle, self.control, self._disturbance, s.road.friction, s.clock(self.tick), references,
            self.state, self.networks.speed, self.networks.steering, rows,
        )  # fmt: skip
        self._accel = (self.state.vehicle.speed_long - before) / rates.sumo_step
        self.tick += count
        car = self.state.vehicle
        if car.speed_long >= 0.0:
            self._mirrored = Pose(car.x, car.y, car.yaw, car.speed_long, self._accel)
        self._note_networks(rows[:count])
        return rows[:count]

    def _references(self, wanted: Intent) -> References:
        """The profile within the step, where the world knows it, or a straight line to the wished speed."""
        speeds, accels = wanted.speeds, wanted.accels
        if speeds is None or accels is None:
            before = self._reference.speed
            rise = self._reference.toward(wanted.speed, self.speed, wanted.top, self._curve_speed())
            speeds = before + rise * self._shares
            accels = np.full(self._periods, self._reference.accel)
        noise = self._noise.standard_normal((self._periods, CHANNELS))
        return References(self.path, self.driven, speeds, accels, noise, self.offset)

    def _curve_speed(self) -> float:
        """Speed that the bends ahead allow at the end of this step [m/s]; SUMO does not know of bends."""
        end = self.state.position + max(self.speed, 0.0) * self.scenario.rates.sumo_step
        return float(interpolate(self._cap, self.base, end))

    def observe(self, traffic: Traffic, mirror_error: float, rows: np.ndarray, persons: Traffic = NOBODY) -> Others:
        """Look around after a step: lead, near misses, collisions, also with persons; completes the step's rows."""
        others = self._seen(traffic)
        self.lead = self._find_lead(others)
        self._note_near_miss()
        self._find_collisions(traffic, persons)
        extra = [self.lead.gap, self.lead.time_to_collision, self.lead.deceleration_to_avoid, mirror_error]
        self.frames.append(np.column_stack((rows, np.tile(extra, (len(rows), 1)))))
        return others

    def learning(self, rows: np.ndarray, before: np.ndarray | None) -> str:
        """Whether the networks learn during these rows: off, learning, settled; `before`: the row before them."""
        if max(self.control.longitudinal.emran.authority, self.control.lateral.emran.authority) <= 0.0:
            return "off"
        counts = [AT.learned_speed, AT.learned_steering]
        if (rows[-1, counts] > (rows[0] if before is None else before)[counts]).any():
            self._learned = self.time
        return "learning" if self.time - self._learned < SETTLED_AFTER else "settled"

    def reference_ahead(self) -> np.ndarray:
        """(n, 2) points of the path ahead."""
        first = int(self.state.position / self.path.spacing)
        last = min(first + int(AHEAD / self.path.spacing), self.path.x.size)
        return np.array((self.path.x[first:last:8], self.path.y[first:last:8])).T

    def trace(self) -> np.ndarray:
        """All rows so far (n, len(COLUMNS))."""
        return self.frames.all()

    def too_tight(self) -> str:
        """Words for a lost car: what of its way no car can drive, as where SUMO turns back within its lane."""
        v, spacing = self.vehicle, self.base.spacing
        first = max(int((self.state.position - LOST_WITHIN) / spacing), 0)
        sharpest = np.abs(self.base.curvature[first : first + int(2 * LOST_WITHIN / spacing)]).max(initial=0.0)
        least = (v.front_axle + v.rear_axle) / math.tan(v.steer_limit)
        if sharpest * least <= 1.0:
            return ""
        return f"; its route turns within {1.0 / sharpest:.1f} m there, and the car needs {least:.1f} m"

    def _seen(self, traffic: Traffic) -> Others:
        """Traffic in coordinates of the lane that the ego follows or changes to."""
        car = self.state.vehicle
        # path and lane differ in length by less than this search tolerates
        here = nearest(self.base, car.x, car.y, self.state.position)
        along = project(self.base, traffic.x, traffic.y, here.position, SIGHT)
        center = self._center_ahead()
        offset = -(car.x - here.x) * math.sin(here.yaw) + (car.y - here.y) * math.cos(here.yaw)
        ahead = along[:, 0] - here.position - center
        turned = traffic.yaw - along[:, 2]
        cosine, s = np.cos(turned), np.abs(np.sin(turned))
        c = np.abs(cosine)
        length, width = traffic.length * c + traffic.width * s, traffic.length * s + traffic.width * c
        return Others(ahead, along[:, 1], traffic.speed * cosine, length, width, offset, cosine)

    def _center_ahead(self) -> float:
        """From the center of gravity forward to the center of the body [m]."""
        v = self.vehicle
        return v.front_axle + v.front_overhang - 0.5 * v.length

    def _find_lead(self, others: Others) -> metrics.Lead:
        """The nearest vehicle ahead whose body overlaps the corridor that the ego will sweep."""
        if others.ahead.size == 0:
            return metrics.NO_LEAD
        v = self.vehicle
        gap = others.ahead - 0.5 * (others.length + v.length)
        # who is beside is no lead; whether the bodies touch is another question
        candidates = np.flatnonzero(
            (gap > -BESIDE) & (np.abs(others.offset) < 3.0 * self.lane_width) & (others.alignment > ALIGNED)
        )
        best = metrics.NO_LEAD
        for k in candidates[np.argsort(gap[candidates])]:
            if abs(others.offset[k] - self._corridor(float(others.ahead[k]))) < 0.5 * (others.width[k] + v.width):
                best = metrics.lead(max(float(gap[k]), 0.0), self.speed, float(others.speed[k]))
                break
        return best

    def _corridor(self, ahead: float) -> float:
        """Lateral offset of the path from its lane at a distance ahead of the ego [m]."""
        if self.path is self.base:
            return 0.0
        position = self.state.position + ahead
        x, y = (interpolate(values, self.path, position) for values in (self.path.x, self.path.y))
        point = nearest(self.base, x, y, position)
        return -(x - point.x) * math.sin(point.yaw) + (y - point.y) * math.cos(point.yaw)

    def _note_near_miss(self) -> None:
        lead = self.lead
        told = f"{lead.time_to_collision:.1f} s to a collision, gap {lead.gap:.1f} m"
        conflict = lead.time_to_collision < metrics.CONFLICT_TTC or lead.deceleration_to_avoid > metrics.CONFLICT_DRAC
        near = lead.time_to_collision < NEAR_MISS
        if near and not self._near_miss:
            self.say("WARN", f"near miss: {told}")
        elif conflict and not self._conflict:
            self.say("WARN", f"conflict: {told}, {lead.deceleration_to_avoid:.1f} m/s² avoid it")
        self._near_miss, self._conflict = near, conflict

    def _note_encounter(self, own: metrics.Box, traffic: Traffic) -> None:
        before, found = self.encounters.least, self.encounters.look(self.time, own, traffic)
        if found < before and found < metrics.CONFLICT_PET:
            self.say("WARN", f"crossed {found:.1f} s after or before another vehicle at the same place")

    def _find_collisions(self, traffic: Traffic, persons: Traffic) -> None:
        car, v = self.state.vehicle, self.vehicle
        center = self._center_ahead()
        x, y = car.x + center * math.cos(car.yaw), car.y + center * math.sin(car.yaw)
        own = metrics.Box(x, y, car.yaw, v.length, v.width)
        self._note_encounter(own, traffic)
        for them in (traffic, persons):
            near = np.flatnonzero(np.hypot(them.x - x, them.y - y) < 0.5 * (v.length + them.length) + v.width)
            for k in near:
                name, other = them.ids[k], body(them, int(k))
                if metrics.boxes_overlap(own, other) and name not in self._met:
                    self._met.add(name)
                    speeds = f"at {car.speed_long:.1f} m/s, the other at {them.speed[k]:.1f} m/s"
                    told = f"{name} {speeds}, {metrics.struck_where(own, other)}"
                    if name.endswith(ON_WALKING_AREA):
                        self.say("WARN", f"touches {told}")
                    else:
                        self.collided[name] = told
                        self.say("ERROR", f"collision with {told}")

    def enter(self, name: str, text: str, level: str = "INFO") -> None:
        """Begin a phase of a maneuver."""
        if name != self.maneuver:
            self.maneuver = name
            self.say(level, text)

    def say(self, level: str, text: str) -> None:
        """Note an event now."""
        self.events.append(Event(self.time, level, text))

    def _note_networks(self, rows: np.ndarray) -> None:
        last = self.frames.last[-1] if len(self.frames.last) else np.zeros(WIDTH)
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
