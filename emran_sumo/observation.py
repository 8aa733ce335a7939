"""What a controller of your own sees and says, and the built-in one written the same way."""

from typing import NamedTuple, Protocol

from emran_sumo.control.cruise import CruiseCommand, CruiseMemory, Motion, cruise
from emran_sumo.control.steering import SteeringCommand, SteeringMemory, track
from emran_sumo.loop import ControlParams, Networks
from emran_sumo.path import Path, Point, interpolate, point_at
from emran_sumo.plant.vehicle import VehicleParams, VehicleState


class BuiltInParts(NamedTuple):
    """What the built-in laws need besides what they see: their parameters, networks, and memories at the take-over."""

    control: ControlParams
    networks: Networks
    cruise: CruiseMemory
    steering: SteeringMemory


class Observation(NamedTuple):
    """What a controller sees at the start of a control period.

    time [s] since the take-over; period [s] until the next call; car: VehicleState, measured at the center of gravity;
    cross_track_error [m], positive when the path lies to the left; heading_error [rad], path minus car; motion: Motion,
    the longitudinal sensors; speed_reference [m/s] and accel_reference [m/s2] wanted now; path: Path to follow; point:
    Point of it nearest to the car; vehicle: VehicleParams; built_in: BuiltInParts.
    """

    time: float
    period: float
    car: VehicleState
    cross_track_error: float
    heading_error: float
    motion: Motion
    speed_reference: float
    accel_reference: float
    path: Path
    point: Point
    vehicle: VehicleParams
    built_in: BuiltInParts

    @property
    def x(self) -> float:
        """East [m]."""
        return self.car.x

    @property
    def y(self) -> float:
        """North [m]."""
        return self.car.y

    @property
    def yaw(self) -> float:
        """Counter-clockwise from east [rad]."""
        return self.car.yaw

    @property
    def speed(self) -> float:
        """Along the body [m/s]."""
        return self.car.speed_long

    @property
    def speed_lat(self) -> float:
        """Across the body, left positive [m/s]."""
        return self.car.speed_lat

    @property
    def yaw_rate(self) -> float:
        """[rad/s]"""
        return self.car.yaw_rate

    @property
    def steer(self) -> float:
        """Road-wheel angle that the car has [rad]."""
        return self.car.steer

    @property
    def position(self) -> float:
        """Along the path [m]; jumps when the car is given another path, as for a lane change."""
        return self.point.position

    @property
    def curvature(self) -> float:
        """Of the path here [1/m], positive to the left."""
        return self.point.curvature

    @property
    def grade(self) -> float:
        """Of the road here, as the map has it [rad], positive uphill."""
        return float(interpolate(self.path.grade, self.path, self.point.position))

    def preview(self, distance: float) -> Point:
        """Point of the path `distance` [m] ahead of the nearest one; held at the end of the path."""
        return point_at(self.path, self.point.position + distance)


class Command(NamedTuple):
    """What a controller asks for until its next call.

    steer: road-wheel angle [rad], left positive; accel [m/s2] that the torque of the wheels alone would give: drag,
    rolling and grade come off it. A law that knows the parts of a command gives them for the trace; no network of the
    door is then added to that half.
    """

    steer: float
    accel: float
    steer_parts: SteeringCommand | None = None
    accel_parts: CruiseCommand | None = None


class Controller(Protocol):
    """A controller of one ego."""

    def reset(self) -> None:
        """The ego is taken over: forget everything."""

    def step(self, observation: Observation, /) -> Command | tuple[float, float]:
        """Command for the period that begins now."""
        ...


class BuiltIn:
    """The built-in coupled scheme as a controller of its own; take `steering` or `cruise` to write the other half."""

    def reset(self) -> None:
        """Begin anew with the memories of the next take-over."""
        self._cruise: CruiseMemory | None = None
        self._steering: SteeringMemory | None = None

    def step(self, observation: Observation) -> Command:
        """Both halves."""
        push, turn = self.cruise(observation), self.steering(observation)
        return Command(turn.angle, push.accel, turn, push)

    def cruise(self, o: Observation) -> CruiseCommand:
        """The longitudinal half, once per period."""
        push, self._cruise = cruise(
            o.built_in.control.longitudinal, o.built_in.networks.speed, o.vehicle, self._cruise or o.built_in.cruise,
            o.motion, o.speed_reference, o.accel_reference, o.period,
        )  # fmt: skip
        return push

    def steering(self, o: Observation) -> SteeringCommand:
        """The lateral half, once per period."""
        turn, self._steering = track(
            o.built_in.control.lateral, o.built_in.networks.steering, o.vehicle, self._steering or o.built_in.steering,
            o.car, o.path, o.point, o.cross_track_error, o.heading_error, o.period,
        )  # fmt: skip
        return turn
