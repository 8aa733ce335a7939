"""What the controller sees: the true state plus noise."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.plant.vehicle import VehicleState
from emran_sumo.units import Unit

CHANNELS = 7  # standard normal numbers per control period


class SensorParams(NamedTuple):
    """Standard deviations of white measurement noise at the control rate, and the bias of the pitch gyro."""

    cross_track: Annotated[float, Field(ge=0, le=1), Unit("m")] = 0.0
    heading: Annotated[float, Field(ge=0, le=0.5), Unit("rad")] = 0.0
    yaw_rate: Annotated[float, Field(ge=0, le=0.5), Unit("rad/s")] = 0.0
    speed_lat: Annotated[float, Field(ge=0, le=2), Unit("m/s")] = 0.0
    speed: Annotated[float, Field(ge=0, le=2), Unit("m/s")] = 0.0
    accel: Annotated[float, Field(ge=0, le=5), Unit("m/s^2")] = 0.0
    pitch_rate: Annotated[float, Field(ge=0, le=0.5), Unit("rad/s")] = 0.0
    pitch_rate_bias: Annotated[float, Field(ge=-0.1, le=0.1), Unit("rad/s")] = 0.0


def noise_source(seed: int, index: int = 0) -> np.random.Generator:
    """Source of the standard normal numbers of ego `index`; drawn in the order of time, so chunks do not matter."""
    return np.random.default_rng([seed, 2, index])


@njit
def measured_state(sensors, noise, car, reference_yaw):
    """VehicleState as the steering law sees it: pose moved across the path, noisy side speed and yaw rate.

    Args:
        sensors: SensorParams.
        noise: (CHANNELS,) standard normal numbers of this period.
        car: true VehicleState.
        reference_yaw: direction of the path [rad].
    """
    aside = sensors.cross_track * noise[0]
    return VehicleState(
        car.x + aside * math.sin(reference_yaw),
        car.y - aside * math.cos(reference_yaw),
        car.yaw - sensors.heading * noise[1],
        car.speed_long + sensors.speed * noise[4],
        car.speed_lat + sensors.speed_lat * noise[3],
        car.yaw_rate + sensors.yaw_rate * noise[2],
        car.wheel_speed_front,
        car.wheel_speed_rear,
        car.steer,
        car.torque,
        car.accel_long,
    )
