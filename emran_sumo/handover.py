"""How an ego begins: on its lane's path or led to it, no faster than bends allow, its wheels turned as they do."""

import math
from typing import NamedTuple

import numpy as np

from emran_sumo.path import Path, first_near, interpolate
from emran_sumo.plant.records import GRAVITY, VehicleState
from emran_sumo.plant.vehicle import VehicleParams, rolling_start
from emran_sumo.scenario import Scenario
from emran_sumo.world.lanes import speed_cap, way_in, with_begin
from emran_sumo.world.records import Pose, TakeOver

TOO_FAST = 1.2  # times what the bends ahead allow
IN_BEND = 0.02  # 1/m
FRICTION_SHARE = 0.5  # of the friction that bends may take
BLEND_SHARES = (1.5, 0.6)  # of curve_accel and of the friction that the short ways from lane to lane may take


class Begin(NamedTuple):
    """An ego at its take-over.

    path: center of its lane; way: the path itself, or what leads to it from beside; position: near which it is on the
    path [m]; pose: as handed over, or slower; car: state of the plant.
    """

    path: Path
    way: Path
    position: float
    pose: Pose
    car: VehicleState


def begin(handed: TakeOver, scenario: Scenario, vehicle: VehicleParams) -> Begin:
    """How the ego begins: SUMO takes bends at any speed, our car at what they allow."""
    pose = handed.pose
    path = with_begin(handed.path, pose.x, pose.y)
    position = first_near(path, pose.x, pose.y, pose.yaw)
    pose = _slowed(pose, caps(path, scenario), path, position)
    way, there = way_in(path, pose, position), position
    if way is not path:
        there = first_near(way, pose.x, pose.y, pose.yaw)
        pose = _slowed(pose, caps(way, scenario, *BLEND_SHARES), way, there)
    car = rolling_start(vehicle, float(pose.speed), pose.x, pose.y, pose.yaw)
    bend = float(interpolate(way.curvature, way, there))
    if abs(bend) > IN_BEND:  # who comes in a bend steers already
        wheelbase, yaw_rate = vehicle.front_axle + vehicle.rear_axle, float(pose.speed) * bend
        steer = math.atan(wheelbase * bend)
        car = car._replace(steer=steer, yaw_rate=yaw_rate, speed_lat=yaw_rate * vehicle.rear_axle)
    return Begin(path, way, position, pose, car)


def caps(path: Path, scenario: Scenario, share: float = 1.0, friction_share: float = FRICTION_SHARE) -> np.ndarray:
    """Speeds (n,) [m/s] that the bends of a path allow, with a share of the road's curve_accel and of its friction."""
    road = scenario.road
    return speed_cap(path, min(share * road.curve_accel, friction_share * road.friction * GRAVITY), road.curve_decel)


def _slowed(pose: Pose, allowed: np.ndarray, path: Path, position: float) -> Pose:
    """The pose at the speed allowed at `position` [m] of the path, where it is much faster."""
    cap = float(interpolate(allowed, path, position))
    return pose._replace(speed=cap) if pose.speed > TOO_FAST * cap else pose
