"""A bicycle with spinning wheels: how the car answers a steering angle and a wheel torque (Eq. 4-7, 9-10)."""

import math
from typing import Annotated, NamedTuple

from pydantic import Field

from emran_sumo.kernels import njit
from emran_sumo.plant.tire import TireParams, tire_forces
from emran_sumo.units import Unit

GRAVITY = 9.81  # [m/s^2]

_WHEEL_RATE = 2000.0  # [1/s] fastest wheel spin RK4 may meet: it is stable up to 2785/s at 1 ms
_LATERAL_FLOOR = 0.5  # [m/s] below it the slip angle fades, so that steering a standing car gives no force
_ROLLING_SPEED = 0.3  # [m/s] below it rolling resistance fades
_REST_SPEED = 0.05  # [m/s] below it a car that brakes or friction can hold is at rest
_SHARE_LEAST, _SHARE_MOST = 0.15, 0.9  # front share of the torque


class VehicleParams(NamedTuple):
    """The car: a 1480 kg sedan driven and braked on both axles; axle distances from the center of gravity.

    Source: Table I (mass, yaw inertia, axle distances); the rest are values usual for such a car, with the
    power and torque that a 40 degree climb at 25 m/s needs.
    """

    mass: Annotated[float, Field(gt=0), Unit("kg")] = 1480.0
    yaw_inertia: Annotated[float, Field(gt=0), Unit("kg m^2")] = 2350.0
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


class Forces(NamedTuple):
    """Slips and forces of one instant; tire forces in wheel axes."""

    slip_ratio_front: float
    slip_ratio_rear: float
    slip_angle_front: float  # [rad]
    slip_angle_rear: float  # [rad]
    force_long_front: float  # [N]
    force_long_rear: float  # [N]
    force_lat_front: float  # [N]
    force_lat_rear: float  # [N]
    load_front: float  # [N]
    load_rear: float  # [N]
    friction_use_front: float  # |force| / (friction * load)
    friction_use_rear: float
    accel_long: float  # [m/s^2] specific force: dv_x/dt - v_y r + g sin(grade)
    accel_lat: float  # [m/s^2] specific force: dv_y/dt + v_x r


class _Held(NamedTuple):
    """What stays the same during one step: targets, slip control, brake direction, road."""

    steer_target: float
    torque_target: float
    grip_front: float  # share of the torque that slip control lets through
    grip_rear: float
    spin_front: float  # rotation that brakes oppose, +-1
    spin_rear: float
    locked_front: bool
    locked_rear: bool
    mass: float
    yaw_inertia: float
    weight_normal: float  # [N]
    weight_long: float  # [N], positive pulls back


class _Contact(NamedTuple):
    """Tires and air at one instant."""

    slip_ratio_front: float
    slip_ratio_rear: float
    tan_slip_front: float
    tan_slip_rear: float
    load_front: float
    load_rear: float
    force_long_front: float
    force_long_rear: float
    force_lat_front: float
    force_lat_rear: float
    body_long: float  # [N] sum of all forces but gravity, body axes
    body_lat: float
    moment_yaw: float


@njit
def _clip(value, low, high):
    return min(max(value, low), high)


@njit
def _drag(params, speed_long, wind_long):
    """Air drag [N], positive against forward motion."""
    relative = speed_long + wind_long
    return 0.5 * params.air_density * params.drag_area * relative * abs(relative)


@njit
def _side_wind(params, speed_long, wind_long, wind_lat):
    """Side force [N] of a crosswind: linear in the flow angle, then saturating; v_y is neglected."""
    if wind_lat == 0.0:
        return 0.0
    along = speed_long + wind_long
    flow_angle = math.atan2(wind_lat, abs(along))
    limit = params.side_area_limit
    area = limit * math.tanh(params.side_area_coefficient * flow_angle / limit)
    return 0.5 * params.air_density * (along * along + wind_lat * wind_lat) * area


@njit
def _slip_ratio(params, wheel_speed, speed_wheel, longitudinal_stiffness):
    """kappa = (R omega - v) / max(|R omega|, |v|, floor)  (10); the floor limits the wheel's own rate."""
    rolling = params.wheel_radius * wheel_speed
    floor = params.wheel_radius * params.wheel_radius * longitudinal_stiffness / (params.wheel_inertia * _WHEEL_RATE)
    return (rolling - speed_wheel) / max(abs(rolling), abs(speed_wheel), floor, 0.1)


@njit
def _contact(params, state, weight_normal, mass, environment):
    tire = params.tire
    base = params.front_axle + params.rear_axle
    drag = _drag(params, state.speed_long, environment.wind_long)
    transfer = params.cog_height * (mass * state.accel_long + drag) / base
    load_front = _clip(weight_normal * params.rear_axle / base - transfer, 0.0, weight_normal)
    load_rear = weight_normal - load_front

    # velocities in the planes of the wheels: their ratio is tan(alpha) of Eq. 9
    sin_steer = math.sin(state.steer)
    cos_steer = math.cos(state.steer)
    lat_front = state.speed_lat + params.front_axle * state.yaw_rate
    lat_rear = state.speed_lat - params.rear_axle * state.yaw_rate
    along_front = state.speed_long * cos_steer + lat_front * sin_steer
    across_front = lat_front * cos_steer - state.speed_long * sin_steer
    tan_front = across_front / max(abs(along_front), _LATERAL_FLOOR)
    tan_rear = lat_rear / max(abs(state.speed_long), _LATERAL_FLOOR)

    stiffness_long_front = tire.slip_stiffness * load_front
    stiffness_long_rear = tire.slip_stiffness * load_rear
    kappa_front = _slip_ratio(params, state.wheel_speed_front, along_front, stiffness_long_front)
    kappa_rear = _slip_ratio(params, state.wheel_speed_rear, state.speed_long, stiffness_long_rear)
    fx_front, fy_front = tire_forces(
        stiffness_long_front,
        tire.tires_per_axle * tire.cornering_stiffness_front * environment.stiffness_front_factor,
        tire.sliding_gain,
        tire.sliding_decay,
        kappa_front,
        tan_front,
        load_front,
        environment.friction,
    )
    fx_rear, fy_rear = tire_forces(
        stiffness_long_rear,
        tire.tires_per_axle * tire.cornering_stiffness_rear * environment.stiffness_rear_factor,
        tire.sliding_gain,
        tire.sliding_decay,
        kappa_rear,
        tan_rear,
        load_rear,
        environment.friction,
    )
    rolling = params.rolling_resistance * weight_normal * math.tanh(state.speed_long / _ROLLING_SPEED)
    side = _side_wind(params, state.speed_long, environment.wind_long, environment.wind_lat)
    lat_body_front = fx_front * sin_steer + fy_front * cos_steer
    return _Contact(
        kappa_front,
        kappa_rear,
        tan_front,
        tan_rear,
        load_front,
        load_rear,
        fx_front,
        fx_rear,
        fy_front,
        fy_rear,
        fx_front * cos_steer - fy_front * sin_steer + fx_rear - drag - rolling,
        lat_body_front + fy_rear + environment.force_lat + side,
        params.front_axle * lat_body_front
        - params.rear_axle * fy_rear
        + environment.moment_yaw
        + params.wind_yaw_arm * params.length * side,
    )


@njit
def _front_share(params, accel_long, weight_normal, mass):
    """Front share of the torque, that of the load: q = (l_r - h f_x / f_z) / L from the specific forces."""
    base = params.front_axle + params.rear_axle
    share = (params.rear_axle - params.cog_height * accel_long * mass / weight_normal) / base
    return _clip(share, _SHARE_LEAST, _SHARE_MOST)


@njit
def _slip_control(params, slip_ratio, torque_sign):
    """Share of the torque let through: fades to 0 at the slip limit where slip and torque have one sign."""
    if params.slip_limit <= 0.0 or slip_ratio * torque_sign <= 0.0:
        return 1.0
    return _clip((params.slip_limit - abs(slip_ratio)) / params.slip_window, 0.0, 1.0)


@njit
def _spin(wheel_speed, force_long):
    """Rotation that a brake opposes: the wheel's own, or the one the road would give a standing wheel."""
    if wheel_speed != 0.0:
        return math.copysign(1.0, wheel_speed)
    return -math.copysign(1.0, force_long)


@njit
def _hold(params, state, actuation, environment):
    """Sample what is decided once per step, at 1 kHz; also the contact it was decided on."""
    mass = params.mass * environment.mass_factor
    weight = mass * GRAVITY
    weight_normal = weight * math.cos(environment.grade)
    contact = _contact(params, state, weight_normal, mass, environment)
    share = _front_share(params, state.accel_long, weight_normal, mass)

    spin_front = _spin(state.wheel_speed_front, contact.force_long_front)
    spin_rear = _spin(state.wheel_speed_rear, contact.force_long_rear)
    brakes = state.torque < 0.0
    grip_front = _slip_control(params, contact.slip_ratio_front, -spin_front if brakes else 1.0)
    grip_rear = _slip_control(params, contact.slip_ratio_rear, -spin_rear if brakes else 1.0)
    brake_front = -state.torque * share * grip_front
    brake_rear = -state.torque * (1.0 - share) * grip_rear
    radius = params.wheel_radius
    held = _Held(
        _clip(environment.steer_effectiveness * actuation.steer, -params.steer_limit, params.steer_limit),
        _clip(
            environment.torque_effectiveness * actuation.torque,
            -params.brake_torque,
            _drive_limit(params, state, share),
        ),
        grip_front,
        grip_rear,
        spin_front,
        spin_rear,
        brakes and state.wheel_speed_front == 0.0 and radius * abs(contact.force_long_front) <= brake_front,
        brakes and state.wheel_speed_rear == 0.0 and radius * abs(contact.force_long_rear) <= brake_rear,
        mass,
        params.yaw_inertia * environment.inertia_factor,
        weight_normal,
        weight * math.sin(environment.grade),
    )
    return held, contact


@njit
def _drive_limit(params, state, share):
    """Largest total drive torque [N m] that torque and power limits allow."""
    spin = share * state.wheel_speed_front + (1.0 - share) * state.wheel_speed_rear
    return min(params.drive_torque, params.power / max(abs(spin), 1.0))


@njit
def _rate(params, state, held, contact):
    share = _front_share(params, state.accel_long, held.weight_normal, held.mass)
    torque_front = held.grip_front * share * state.torque
    torque_rear = held.grip_rear * (1.0 - share) * state.torque
    if state.torque < 0.0:
        torque_front *= held.spin_front
        torque_rear *= held.spin_rear
    spin_front = (torque_front - params.wheel_radius * contact.force_long_front) / params.wheel_inertia
    spin_rear = (torque_rear - params.wheel_radius * contact.force_long_rear) / params.wheel_inertia

    sin_yaw = math.sin(state.yaw)
    cos_yaw = math.cos(state.yaw)
    steer_rate = (held.steer_target - state.steer) / params.steer_lag
    return VehicleState(
        state.speed_long * cos_yaw - state.speed_lat * sin_yaw,
        state.speed_long * sin_yaw + state.speed_lat * cos_yaw,
        state.yaw_rate,
        (contact.body_long - held.weight_long) / held.mass + state.speed_lat * state.yaw_rate,
        contact.body_lat / held.mass - state.speed_long * state.yaw_rate,
        contact.moment_yaw / held.yaw_inertia,
        0.0 if held.locked_front else spin_front,
        0.0 if held.locked_rear else spin_rear,
        _clip(steer_rate, -params.steer_rate, params.steer_rate),
        (held.torque_target - state.torque) / params.torque_lag,
        (contact.body_long / held.mass - state.accel_long) / params.load_transfer_lag,
    )


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
    held, contact = _hold(params, state, actuation, environment)
    return _rate(params, state, held, contact)


@njit
def _rate_at(params, state, held, environment):
    contact = _contact(params, state, held.weight_normal, held.mass, environment)
    return _rate(params, state, held, contact)


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


@njit
def _holding_force(params, torque, environment):
    """Forces [N] on a car at rest, pulling back and to the left, and whether it can be held against them.

    Brakes and rolling resistance hold against what a drive torque leaves over, in either direction.
    """
    weight = params.mass * environment.mass_factor * GRAVITY
    normal = weight * math.cos(environment.grade)
    needed = weight * math.sin(environment.grade) + _drag(params, 0.0, environment.wind_long)
    lateral = environment.force_lat + _side_wind(params, 0.0, environment.wind_long, environment.wind_lat)
    holding = max(-torque, 0.0) / params.wheel_radius + params.rolling_resistance * normal
    grip = environment.friction * normal
    held = abs(needed - max(torque, 0.0) / params.wheel_radius) <= holding
    return needed, lateral, held and needed * needed + lateral * lateral <= grip * grip


@njit
def _stands(state):
    """Whether nothing moves at all."""
    return (
        state.speed_long == 0.0
        and state.speed_lat == 0.0
        and state.yaw_rate == 0.0
        and state.wheel_speed_front == 0.0
        and state.wheel_speed_rear == 0.0
    )


@njit
def _slow(params, state):
    """Whether the car and its wheels move slower than the rest speed."""
    return (
        abs(state.speed_long) < _REST_SPEED
        and abs(state.speed_lat) < _REST_SPEED
        and abs(state.yaw_rate) < _REST_SPEED
        and params.wheel_radius * abs(state.wheel_speed_front) < _REST_SPEED
        and params.wheel_radius * abs(state.wheel_speed_rear) < _REST_SPEED
    )


@njit
def _stopped(wheel_speed, spin, torque):
    """Wheel speed after a step: a brake stops a wheel, it does not turn it backward."""
    return 0.0 if torque < 0.0 and wheel_speed * spin < 0.0 else wheel_speed


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
    held, contact = _hold(params, state, actuation, environment)
    k1 = _rate(params, state, held, contact)
    k2 = _rate_at(params, _ahead(state, k1, 0.5 * dt), held, environment)
    k3 = _rate_at(params, _ahead(state, k2, 0.5 * dt), held, environment)
    k4 = _rate_at(params, _ahead(state, k3, dt), held, environment)
    after = _ahead(_ahead(_ahead(_ahead(state, k1, dt / 6.0), k2, dt / 3.0), k3, dt / 3.0), k4, dt / 6.0)

    share = _front_share(params, after.accel_long, held.weight_normal, held.mass)
    torque = _clip(after.torque, -params.brake_torque, _drive_limit(params, after, share))
    if _slow(params, after) and _holding_force(params, torque, environment)[2]:
        stood = _stands(state)
        specific_force = held.weight_long / held.mass
        return VehicleState(
            state.x if stood else after.x,
            state.y if stood else after.y,
            state.yaw if stood else after.yaw,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            after.steer,
            torque,
            state.accel_long + (specific_force - state.accel_long) * dt / params.load_transfer_lag,
        )
    return VehicleState(
        after.x,
        after.y,
        after.yaw,
        after.speed_long,
        after.speed_lat,
        after.yaw_rate,
        _stopped(after.wheel_speed_front, held.spin_front, torque),
        _stopped(after.wheel_speed_rear, held.spin_rear, torque),
        after.steer,
        torque,
        after.accel_long,
    )


@njit
def _friction_use(force_long, force_lat, load, friction):
    grip = load * friction
    return math.sqrt(force_long * force_long + force_lat * force_lat) / grip if grip > 0.0 else 0.0


@njit
def forces(params, state, environment):
    """Slips, tire forces, loads and accelerometer readings of one instant.

    A car at rest shows the forces that hold it, shared by axle load.

    Args:
        params: VehicleParams.
        state: VehicleState.
        environment: Environment.

    Returns:
        Forces.
    """
    mass = params.mass * environment.mass_factor
    weight = mass * GRAVITY
    c = _contact(params, state, weight * math.cos(environment.grade), mass, environment)
    fx_front, fx_rear, fy_front, fy_rear = (
        c.force_long_front,
        c.force_long_rear,
        c.force_lat_front,
        c.force_lat_rear,
    )
    accel_long = c.body_long / mass
    accel_lat = c.body_lat / mass
    if _stands(state):
        needed, lateral, held = _holding_force(params, state.torque, environment)
        if held:
            share = c.load_front / (c.load_front + c.load_rear)
            fx_front, fx_rear = share * needed, (1.0 - share) * needed
            fy_front, fy_rear = -share * lateral, -(1.0 - share) * lateral
            accel_long = weight * math.sin(environment.grade) / mass
            accel_lat = 0.0
    return Forces(
        c.slip_ratio_front,
        c.slip_ratio_rear,
        math.atan(c.tan_slip_front),
        math.atan(c.tan_slip_rear),
        fx_front,
        fx_rear,
        fy_front,
        fy_rear,
        c.load_front,
        c.load_rear,
        _friction_use(fx_front, fy_front, c.load_front, environment.friction),
        _friction_use(fx_rear, fy_rear, c.load_rear, environment.friction),
        accel_long,
        accel_lat,
    )


@njit
def _trim_wheel_speed(params, speed, slip_ratio, load):
    """Wheel speed [rad/s] that has a slip ratio >= 0 at a speed."""
    stiffness = params.tire.slip_stiffness * load
    radius = params.wheel_radius
    floor = radius * radius * stiffness / (params.wheel_inertia * _WHEEL_RATE)
    rolling = speed / (1.0 - slip_ratio)
    return (rolling if rolling >= floor else speed + slip_ratio * floor) / radius


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
    rolling = params.rolling_resistance * weight * math.tanh(speed / _ROLLING_SPEED)
    drag = _drag(params, speed, 0.0)
    force = drag + rolling
    base = params.front_axle + params.rear_axle
    load_front = weight * params.rear_axle / base - params.cog_height * drag / base
    slip_ratio = force / (params.tire.slip_stiffness * weight)
    return VehicleState(
        x,
        y,
        yaw,
        speed,
        0.0,
        0.0,
        _trim_wheel_speed(params, speed, slip_ratio, load_front),
        _trim_wheel_speed(params, speed, slip_ratio, weight - load_front),
        0.0,
        params.wheel_radius * force,
        0.0,
    )
