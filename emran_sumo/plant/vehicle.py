"""A bicycle with spinning wheels: how the car answers a steering angle and a wheel torque (Eq. 4-7, 9-10).

Read `derivative` and `step` first. The parts are beside: records (parameters, state, commands), actuators
(commands to wheel torques), contact (loads, slips, tire and air forces), standstill, forces.
"""

import math

from emran_sumo.kernels import njit
from emran_sumo.plant.actuators import drive_limit, front_share, hold, stopped
from emran_sumo.plant.contact import clip, contact, drag, rolling_resistance, trim_wheel_speed
from emran_sumo.plant.forces import Forces, forces
from emran_sumo.plant.records import GRAVITY, Actuation, VehicleParams, VehicleState
from emran_sumo.plant.standstill import holding_force, slow, stands

__all__ = [
    "GRAVITY",
    "Actuation",
    "Forces",
    "VehicleParams",
    "VehicleState",
    "derivative",
    "forces",
    "rolling_start",
    "step",
]


@njit
def derivative(params, state, actuation, environment):
    """Rate of change of the state.

        m (dv_x/dt - v_y r) = F_xf cos(delta) - F_yf sin(delta) + F_xr - m g sin(grade) - drag - rolling
        m (dv_y/dt + v_x r) = F_xf sin(delta) + F_yf cos(delta) + F_yr + F_ext                  (6)
        I_z dr/dt = l_f (F_xf sin(delta) + F_yf cos(delta)) - l_r F_yr + M_ext                  (5)
        I_w domega_i/dt = T_i - R F_xi                                                          (7)
        tan(alpha_i) from the velocities in the wheel plane, kappa_i = (R omega_i - v_i) / max(...)   (9, 10)

    Args:
        params: VehicleParams.
        state: VehicleState.
        actuation: Actuation, the commands; limits, lags and losses are applied here.
        environment: Environment.

    Returns:
        VehicleState of rates [unit/s].

    Source: Debarshi et al., Eq. 4-7, 9, 10.  Differs: steering angle, grade, drag, rolling resistance and
    external forces are resolved in Eq. 5 and 6; body speeds in Eq. 9; one wheel radius; torque split by axle
    load; quasi-static load transfer; slip control. Vertical road curvature is neglected. An effectiveness
    below 1 acts on the command, so `steer` and `torque` of the state are what the car truly has.
    """
    held, touch = hold(params, state, actuation, environment)
    return _rate(params, state, held, touch)


@njit
def step(params, state, actuation, environment, dt):
    """Advance the car by one step (classical Runge-Kutta).

    Brakes lock a wheel but never turn it backward. A slow car that brakes, rolling resistance and friction
    can hold comes to rest exactly and stays there.

    Args:
        params: VehicleParams.
        state: VehicleState.
        actuation: Actuation, held over the step.
        environment: Environment, held over the step.
        dt: step [s]; stable up to 1 ms.

    Returns:
        VehicleState after dt.
    """
    held, touch = hold(params, state, actuation, environment)
    k1 = _rate(params, state, held, touch)
    k2 = _rate_at(params, _ahead(state, k1, 0.5 * dt), held, environment)
    k3 = _rate_at(params, _ahead(state, k2, 0.5 * dt), held, environment)
    k4 = _rate_at(params, _ahead(state, k3, dt), held, environment)
    after = _ahead(_ahead(_ahead(_ahead(state, k1, dt / 6.0), k2, dt / 3.0), k3, dt / 3.0), k4, dt / 6.0)

    share = front_share(params, after.accel_long, held.weight_normal, held.mass)
    torque = clip(after.torque, -params.brake_torque, drive_limit(params, after, share))
    if slow(params, after) and holding_force(params, torque, environment)[2]:
        return _at_rest(params, state, after, torque, held.weight_long / held.mass, dt)
    return VehicleState(
        after.x,
        after.y,
        after.yaw,
        after.speed_long,
        after.speed_lat,
        after.yaw_rate,
        stopped(after.wheel_speed_front, held.spin_front, torque),
        stopped(after.wheel_speed_rear, held.spin_rear, torque),
        after.steer,
        torque,
        after.accel_long,
    )


@njit
def _at_rest(params, state, after, torque, specific_force, dt):
    """State of a car that is held; one that stood before stays where it was."""
    at = state if stands(state) else after
    return VehicleState(
        at.x,
        at.y,
        at.yaw,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        after.steer,
        torque,
        state.accel_long + (specific_force - state.accel_long) * dt / params.load_transfer_lag,
    )


@njit
def rolling_start(params, speed, x, y, yaw):
    """State of a car that rolls straight on at constant speed on a flat road in still air.

    Args:
        params: VehicleParams.
        speed: [m/s], >= 0.
        x: east [m].
        y: north [m].
        yaw: [rad], counter-clockwise from east.

    Returns:
        VehicleState with the torque that balances drag and rolling resistance.
    """
    weight = params.mass * GRAVITY
    rolling = rolling_resistance(params, speed, weight)
    drag_force = drag(params, speed, 0.0)
    force = drag_force + rolling
    base = params.front_axle + params.rear_axle
    load_front = weight * params.rear_axle / base - params.cog_height * drag_force / base
    slip_ratio = force / (params.tire.slip_stiffness * weight)
    return VehicleState(
        x,
        y,
        yaw,
        speed,
        0.0,
        0.0,
        trim_wheel_speed(params, speed, slip_ratio, load_front),
        trim_wheel_speed(params, speed, slip_ratio, weight - load_front),
        0.0,
        params.wheel_radius * force,
        0.0,
    )


@njit
def _rate(params, state, held, touch):
    """VehicleState of rates under what is held and the contact forces."""
    share = front_share(params, state.accel_long, held.weight_normal, held.mass)
    torque_front = held.grip_front * share * state.torque
    torque_rear = held.grip_rear * (1.0 - share) * state.torque
    if state.torque < 0.0:
        torque_front *= held.spin_front
        torque_rear *= held.spin_rear
    spin_front = (torque_front - params.wheel_radius * touch.force_long_front) / params.wheel_inertia
    spin_rear = (torque_rear - params.wheel_radius * touch.force_long_rear) / params.wheel_inertia

    sin_yaw = math.sin(state.yaw)
    cos_yaw = math.cos(state.yaw)
    steer_rate = (held.steer_target - state.steer) / params.steer_lag
    return VehicleState(
        state.speed_long * cos_yaw - state.speed_lat * sin_yaw,
        state.speed_long * sin_yaw + state.speed_lat * cos_yaw,
        state.yaw_rate,
        (touch.body_long - held.weight_long) / held.mass + state.speed_lat * state.yaw_rate,
        touch.body_lat / held.mass - state.speed_long * state.yaw_rate,
        touch.moment_yaw / held.yaw_inertia,
        0.0 if held.locked_front else spin_front,
        0.0 if held.locked_rear else spin_rear,
        clip(steer_rate, -params.steer_rate, params.steer_rate),
        (held.torque_target - state.torque) / params.torque_lag,
        (touch.body_long / held.mass - state.accel_long) / params.load_transfer_lag,
    )


@njit
def _rate_at(params, state, held, environment):
    return _rate(params, state, held, contact(params, state, held.weight_normal, held.mass, environment))


@njit
def _ahead(state, rate, dt):
    return VehicleState(
        state.x + dt * rate.x,
        state.y + dt * rate.y,
        state.yaw + dt * rate.yaw,
        state.speed_long + dt * rate.speed_long,
        state.speed_lat + dt * rate.speed_lat,
        state.yaw_rate + dt * rate.yaw_rate,
        state.wheel_speed_front + dt * rate.wheel_speed_front,
        state.wheel_speed_rear + dt * rate.wheel_speed_rear,
        state.steer + dt * rate.steer,
        state.torque + dt * rate.torque,
        state.accel_long + dt * rate.accel_long,
    )
