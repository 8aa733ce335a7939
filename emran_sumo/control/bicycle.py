"""The car that linear laws believe in: a bicycle with linear tires at constant speed."""

from typing import NamedTuple

from emran_sumo.kernels import njit
from emran_sumo.plant.tire import axle_stiffness


class Bicycle(NamedTuple):
    """Coefficients of the linear bicycle, side speed v_y [m/s], yaw rate r [rad/s], road-wheel angle delta [rad].

    dv_y/dt = lat_lat v_y + lat_yaw r + lat_steer delta
    dr/dt   = yaw_lat v_y + yaw_yaw r + yaw_steer delta
    """

    lat_lat: float
    lat_yaw: float
    lat_steer: float
    yaw_lat: float
    yaw_yaw: float
    yaw_steer: float


@njit
def bicycle(vehicle, speed):
    """Bicycle of a vehicle at `speed` [m/s], above 0.

    Source: any textbook, e.g. Rajamani, Vehicle Dynamics and Control, section 2.3.
    """
    front, rear = axle_stiffness(vehicle.tire, False), axle_stiffness(vehicle.tire, True)
    a, b, m, inertia = vehicle.front_axle, vehicle.rear_axle, vehicle.mass, vehicle.yaw_inertia
    balance = b * rear - a * front
    return Bicycle(
        -(front + rear) / (m * speed),
        balance / (m * speed) - speed,
        front / m,
        balance / (inertia * speed),
        -(a * a * front + b * b * rear) / (inertia * speed),
        a * front / inertia,
    )


@njit
def steady_turn(vehicle, speed):
    """Side slip angle and road-wheel angle of a bend, both per curvature [rad m].

    beta / kappa = l_r - l_f m v^2 / (L C_r),   delta / kappa = L + m v^2 (l_r / C_f - l_f / C_r) / L
    """
    front, rear = axle_stiffness(vehicle.tire, False), axle_stiffness(vehicle.tire, True)
    a, b = vehicle.front_axle, vehicle.rear_axle
    wheelbase = a + b
    push = vehicle.mass * speed * speed / wheelbase
    return b - a * push / rear, wheelbase + push * (b / front - a / rear)
