"""What disturbs the car over time: friction, grade, wind, side force, changed parameters, weak actuators.

Everything is deterministic and neutral by default.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.units import Unit


class Environment(NamedTuple):
    """What acts on the plant at one instant; the factors multiply the nominal VehicleParams."""

    friction: float = 1.0  # peak friction coefficient mu_p
    grade: float = 0.0  # [rad], positive uphill
    pitch_rate: float = 0.0  # [rad/s], d grade / dt: what a gyro reads from the road; the plant does not use it
    wind_long: float = 0.0  # [m/s], positive headwind
    force_lat: float = 0.0  # [N], external force at the center of gravity, positive to the left
    moment_yaw: float = 0.0  # [N m], external yaw moment, positive to the left
    mass_factor: float = 1.0
    inertia_factor: float = 1.0  # of the yaw inertia
    stiffness_front_factor: float = 1.0
    stiffness_rear_factor: float = 1.0
    steer_effectiveness: float = 1.0  # achieved over commanded road-wheel angle
    torque_effectiveness: float = 1.0  # achieved over commanded wheel torque
    wind_lat: float = 0.0  # [m/s], crosswind in body axes, positive toward the left


class DisturbanceParams(NamedTuple):
    """Disturbances over time [s] and path position [m].

    The grade pulses, the sinusoids and the gust are those of the published cases (Tables IV, V, VII and IX).
    """

    friction_amplitude: Annotated[float, Field(ge=0, lt=1), Unit("")] = 0.0  # relative to the road's friction
    friction_frequency: Annotated[float, Field(ge=0), Unit("rad/s")] = 1.0
    patch_start: Annotated[float, Field(ge=0), Unit("m")] = 0.0
    patch_end: Annotated[float, Field(ge=0), Unit("m")] = 0.0
    patch_friction: Annotated[float, Field(gt=0, le=2), Unit("")] = 1.0  # factor between patch start and end

    grade: Annotated[float, Field(ge=-0.8, le=0.8), Unit("rad")] = 0.0  # constant, added to the road's own
    grade_pulse: Annotated[float, Field(ge=-0.8, le=0.8), Unit("rad")] = 0.0
    grade_start: Annotated[float, Field(ge=0), Unit("s")] = 10.0
    grade_return: Annotated[float, Field(ge=-0.8, le=0.8), Unit("rad")] = 0.0  # second pulse
    grade_return_start: Annotated[float, Field(ge=0), Unit("s")] = 30.0
    grade_duration: Annotated[float, Field(gt=0), Unit("s")] = 10.0  # of each pulse, start of rise to start of fall
    grade_transition: Annotated[float, Field(ge=0), Unit("s")] = 1.0  # rise and fall time

    wind: Annotated[float, Field(ge=-60, le=60), Unit("m/s")] = 0.0  # constant headwind
    wind_amplitude: Annotated[float, Field(ge=0, le=60), Unit("m/s")] = 0.0
    wind_frequency: Annotated[float, Field(ge=0), Unit("rad/s")] = 1.0

    lateral_force: Annotated[float, Field(ge=-2e4, le=2e4), Unit("N")] = 0.0
    lateral_force_start: Annotated[float, Field(ge=0), Unit("s")] = 0.0
    gust_force: Annotated[float, Field(ge=-2e4, le=2e4), Unit("N")] = 0.0
    gust_arm: Annotated[float, Field(ge=-3, le=3), Unit("m")] = 0.705  # yaw moment per gust force, 0.15 of 4.7 m
    gust_speed: Annotated[float, Field(ge=-60, le=60), Unit("m/s")] = 0.0  # crosswind, instead of a force
    gust_start: Annotated[float, Field(ge=0), Unit("s")] = 2.0
    gust_rise: Annotated[float, Field(ge=0), Unit("s")] = 0.1
    gust_duration: Annotated[float, Field(gt=0), Unit("s")] = 1e6  # start of rise to start of fall

    mass_factor: Annotated[float, Field(ge=0.3, le=3), Unit("")] = 1.0
    mass_amplitude: Annotated[float, Field(ge=0, lt=0.7), Unit("")] = 0.0
    mass_frequency: Annotated[float, Field(ge=0), Unit("rad/s")] = 1.0
    inertia_factor: Annotated[float, Field(ge=0.3, le=3), Unit("")] = 1.0
    inertia_amplitude: Annotated[float, Field(ge=0, lt=0.7), Unit("")] = 0.0
    inertia_frequency: Annotated[float, Field(ge=0), Unit("rad/s")] = 1.0
    stiffness_front: Annotated[float, Field(ge=0.2, le=3), Unit("")] = 1.0
    stiffness_rear: Annotated[float, Field(ge=0.2, le=3), Unit("")] = 1.0
    stiffness_amplitude: Annotated[float, Field(ge=0, lt=0.8), Unit("")] = 0.0
    stiffness_frequency: Annotated[float, Field(ge=0), Unit("rad/s")] = 1.0
    mass_draw: Annotated[float, Field(ge=0, le=0.5), Unit("")] = 0.0  # half width of a random factor around 1
    inertia_draw: Annotated[float, Field(ge=0, le=0.5), Unit("")] = 0.0
    stiffness_draw: Annotated[float, Field(ge=0, le=0.5), Unit("")] = 0.0

    steer_effectiveness: Annotated[float, Field(ge=0, le=1.5), Unit("")] = 1.0
    steer_effectiveness_start: Annotated[float, Field(ge=0), Unit("s")] = 0.0
    torque_effectiveness: Annotated[float, Field(ge=0, le=1.5), Unit("")] = 1.0
    torque_effectiveness_start: Annotated[float, Field(ge=0), Unit("s")] = 0.0


@njit
def _pulse(time, start, duration, transition):
    """Smooth pulse of height 1 and its rate [1/s]; both edges are cubic and last `transition` [s]."""
    height = 0.0
    rate = 0.0
    for sign, edge in ((1.0, start), (-1.0, start + duration)):
        if time >= edge + transition:
            height += sign
        elif time > edge:
            u = (time - edge) / transition
            height += sign * u * u * (3.0 - 2.0 * u)
            rate += sign * 6.0 * u * (1.0 - u) / transition
    return height, rate


@njit
def environment(params, base_friction, base_grade, base_grade_slope, time, position, speed):
    """What acts on the plant at one instant.

    Args:
        params: DisturbanceParams.
        base_friction: friction of the road here.
        base_grade: grade of the road here [rad], positive uphill.
        base_grade_slope: its derivative along the path [rad/m].
        time: since the start of the run [s].
        position: along the path [m].
        speed: along the path [m/s], for the pitch rate.

    Returns:
        Environment.

    Differs: the inertia that varies is the yaw inertia; the published pitch inertia has no effect on this
    plant, which has no pitch motion.
    """
    p = params
    friction = base_friction * (1.0 + p.friction_amplitude * math.sin(p.friction_frequency * time))
    if p.patch_start <= position < p.patch_end:
        friction *= p.patch_friction
    first, first_rate = _pulse(time, p.grade_start, p.grade_duration, p.grade_transition)
    second, second_rate = _pulse(time, p.grade_return_start, p.grade_duration, p.grade_transition)
    gust = _pulse(time, p.gust_start, p.gust_duration, p.gust_rise)[0]
    force_gust = p.gust_force * gust
    stiffness = 1.0 + p.stiffness_amplitude * math.sin(p.stiffness_frequency * time)
    force_constant = p.lateral_force if time >= p.lateral_force_start else 0.0
    return Environment(
        friction=friction,
        grade=base_grade + p.grade + p.grade_pulse * first + p.grade_return * second,
        pitch_rate=base_grade_slope * speed + p.grade_pulse * first_rate + p.grade_return * second_rate,
        wind_long=p.wind + p.wind_amplitude * math.sin(p.wind_frequency * time),
        force_lat=force_constant + force_gust,
        moment_yaw=p.gust_arm * force_gust,
        mass_factor=p.mass_factor * (1.0 + p.mass_amplitude * math.sin(p.mass_frequency * time)),
        inertia_factor=p.inertia_factor * (1.0 + p.inertia_amplitude * math.sin(p.inertia_frequency * time)),
        stiffness_front_factor=p.stiffness_front * stiffness,
        stiffness_rear_factor=p.stiffness_rear * stiffness,
        steer_effectiveness=p.steer_effectiveness if time >= p.steer_effectiveness_start else 1.0,
        torque_effectiveness=p.torque_effectiveness if time >= p.torque_effectiveness_start else 1.0,
        wind_lat=p.gust_speed * gust,
    )


def drawn(params: DisturbanceParams, seed: int) -> DisturbanceParams:
    """The parameters with the random factors of `*_draw` multiplied in, the same for the same seed."""
    mass, inertia, front, rear = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, 4)
    return params._replace(
        mass_factor=params.mass_factor * (1.0 + params.mass_draw * mass),
        inertia_factor=params.inertia_factor * (1.0 + params.inertia_draw * inertia),
        stiffness_front=params.stiffness_front * (1.0 + params.stiffness_draw * front),
        stiffness_rear=params.stiffness_rear * (1.0 + params.stiffness_draw * rear),
    )
