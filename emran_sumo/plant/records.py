"""What the car is: its parameters, its state, and the two commands it takes."""

from typing import Annotated, NamedTuple

from pydantic import Field

from emran_sumo.plant.tire import TireParams
from emran_sumo.units import Unit

GRAVITY = 9.81  # [m/s^2]


class VehicleParams(NamedTuple):
    """The car: a 1480 kg sedan driven and braked on both axles; axle distances from the center of gravity.

    Source: Table I (mass, yaw inertia, axle distances); the rest are values usual for such a car, with the
    power and torque that a 40 degree climb at 25 m/s needs.
    """

    mass: Annotated[float, Field(gt=0, le=1e5), Unit("kg")] = 1480.0
    yaw_inertia: Annotated[float, Field(gt=0, le=1e7), Unit("kg m^2")] = 2350.0
    front_axle: Annotated[float, Field(gt=0), Unit("m")] = 1.05
    rear_axle: Annotated[float, Field(gt=0), Unit("m")] = 1.63
    cog_height: Annotated[float, Field(ge=0), Unit("m")] = 0.53
    length: Annotated[float, Field(gt=0), Unit("m")] = 4.7
    width: Annotated[float, Field(gt=0), Unit("m")] = 1.85
    front_overhang: Annotated[float, Field(ge=0), Unit("m")] = 0.85
    wheel_inertia: Annotated[float, Field(gt=0), Unit("kg m^2")] = 2.0  # per axle
    wheel_radius: Annotated[float, Field(gt=0), Unit("m")] = 0.32
    drag_area: Annotated[float, Field(ge=0), Unit("m^2")] = 0.66
    air_density: Annotated[float, Field(ge=0), Unit("kg/m^3")] = 1.2
    side_area_coefficient: Annotated[float, Field(ge=0), Unit("m^2/rad")] = 5.0  # side force area per flow angle
    side_area_limit: Annotated[float, Field(gt=0), Unit("m^2")] = 2.6  # at large flow angles
    wind_yaw_arm: Annotated[float, Field(ge=-0.5, le=0.5), Unit("")] = 0.15  # yaw moment / (side force * length)
    rolling_resistance: Annotated[float, Field(ge=0), Unit("")] = 0.012
    steer_limit: Annotated[float, Field(gt=0, lt=1.5), Unit("rad")] = 0.61
    steer_rate: Annotated[float, Field(gt=0), Unit("rad/s")] = 0.8
    steer_lag: Annotated[float, Field(ge=0.005), Unit("s")] = 0.05
    torque_lag: Annotated[float, Field(ge=0.005), Unit("s")] = 0.1
    drive_torque: Annotated[float, Field(gt=0), Unit("N m")] = 3600.0
    brake_torque: Annotated[float, Field(gt=0), Unit("N m")] = 5000.0
    power: Annotated[float, Field(gt=0), Unit("W")] = 280e3
    load_transfer_lag: Annotated[float, Field(ge=0.005), Unit("s")] = 0.03
    slip_limit: Annotated[float, Field(ge=0, le=1), Unit("")] = 0.26  # slip control; 0 switches it off
    slip_window: Annotated[float, Field(gt=0, le=1), Unit("")] = 0.12  # torque fades over it below the limit
    tire: TireParams = TireParams()


class VehicleState(NamedTuple):
    """State of the car; position and speeds are those of the center of gravity."""

    x: float  # [m] east
    y: float  # [m] north
    yaw: float  # [rad] counter-clockwise from east, not wrapped
    speed_long: float  # [m/s] forward, body axes
    speed_lat: float  # [m/s] to the left, body axes
    yaw_rate: float  # [rad/s]
    wheel_speed_front: float  # [rad/s]
    wheel_speed_rear: float  # [rad/s]
    steer: float  # [rad] achieved road-wheel angle, positive to the left
    torque: float  # [N m] achieved total wheel torque after lag and limits; positive drives, negative brakes
    accel_long: float  # [m/s^2] specific force, filtered: moves load between the axles


class Actuation(NamedTuple):
    """What a controller commands."""

    steer: float  # [rad] road-wheel angle
    torque: float  # [N m] total wheel torque; negative brakes
