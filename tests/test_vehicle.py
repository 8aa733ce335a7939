import itertools
import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from scipy.integrate import solve_ivp

from emran_sumo.kernels import njit
from emran_sumo.plant.disturbance import Environment
from emran_sumo.plant.tire import TireParams
from emran_sumo.plant.vehicle import (
    Actuation,
    VehicleParams,
    VehicleState,
    derivative,
    forces,
    rolling_start,
    step,
)

CAR = VehicleParams()
ROAD = Environment()
G = 9.81
L = CAR.front_axle + CAR.rear_axle
C_FRONT, C_REAR = 135_000.0, 95_000.0  # axles
AXLES = {"front_axle": 1.05, "rear_axle": 1.63}


@njit
def drive(params, state, actuation, environment, dt, count):
    for _ in range(count):
        state = step(params, state, actuation, environment, dt)
    return state


@njit
def cruise(params, state, steer, speed, environment, count):
    """Hold a speed with a proportional-integral torque while steering."""
    torque = state.torque
    for _ in range(count):
        torque += 2.0 * (speed - state.speed_long)
        command = torque + 1500.0 * (speed - state.speed_long)
        state = step(params, state, Actuation(steer, command), environment, 0.001)
    return state


def start(speed, params=CAR):
    return rolling_start(params, speed, 0.0, 0.0, 0.0)


def seconds(state, torque=0.0, steer=0.0, environment=ROAD, time=1.0, params=CAR):
    return drive(params, state, Actuation(steer, torque), environment, 0.001, round(time * 1000))


def trajectory(state, torque, time, environment=ROAD, steer=0.0, params=CAR):
    states = [state]
    for _ in range(round(time * 1000)):
        states.append(step(params, states[-1], Actuation(steer, torque), environment, 0.001))
    return states


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("speed", [0.0, 3.0, 10.0, 25.0, 40.0])
def test_car_started_rolling_keeps_its_speed(speed):
    state = start(speed)
    after = seconds(state, torque=state.torque, time=5.0)
    assert after.speed_long == pytest.approx(speed, abs=2e-4)
    assert (after.y, after.yaw, after.speed_lat, after.yaw_rate) == (0.0, 0.0, 0.0, 0.0)
    assert after.x == pytest.approx(5.0 * speed, abs=2e-3)


def test_coasting_down_follows_the_closed_form():
    # (m + 2 I_w / R^2) dv/dt = -(c v^2 + f): v = sqrt(f/c) tan(phi - t sqrt(f c) / m_e)
    c = 0.5 * CAR.air_density * CAR.drag_area
    f = CAR.rolling_resistance * CAR.mass * G
    inertia = CAR.mass + 2 * CAR.wheel_inertia / CAR.wheel_radius**2
    state = start(30.0)._replace(torque=0.0, wheel_speed_front=30.0 / 0.32, wheel_speed_rear=30.0 / 0.32)
    root = math.sqrt(f / c)
    time = 40.0
    expected = root * math.tan(math.atan(30.0 / root) - time * math.sqrt(f * c) / inertia)
    assert seconds(state, time=time).speed_long == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(("tires", "gradient"), [(2.0, 0.32), (1.0, 0.63)])
def test_steady_circle_has_the_understeer_of_the_linear_bicycle(tires, gradient):
    params = CAR._replace(tire=TireParams(tires_per_axle=tires), drag_area=0.0, rolling_resistance=0.0)
    speed, steer = 15.0, 0.004
    front, rear = C_FRONT * tires / 2, C_REAR * tires / 2
    understeer = CAR.mass / L * (CAR.rear_axle / front - CAR.front_axle / rear)  # [rad s^2/m]
    assert math.degrees(understeer * G) == pytest.approx(gradient, abs=0.01)
    after = cruise(params, start(speed, params), steer, speed, ROAD, 6000)
    assert after.yaw_rate == pytest.approx(steer * speed / (L + understeer * speed**2), rel=2e-3)
    slip = forces(params, after, ROAD)
    assert slip.accel_lat == pytest.approx(speed * after.yaw_rate, rel=2e-3)
    assert slip.slip_angle_front - slip.slip_angle_rear == pytest.approx(L * after.yaw_rate / speed - steer, rel=5e-3)


def test_slow_circle_is_that_of_the_wheel_geometry():
    after = cruise(CAR, start(2.0), 0.4, 2.0, ROAD, 8000)
    assert 2.0 / after.yaw_rate == pytest.approx(L / math.tan(0.4), rel=0.01)
    slip_rear = CAR.mass * 2.0 * after.yaw_rate * CAR.front_axle / (L * C_REAR)
    assert after.speed_lat == pytest.approx(CAR.rear_axle * after.yaw_rate - 2.0 * slip_rear, rel=0.01)


def test_standing_loads_follow_the_grade():
    angle = 0.3
    state = start(0.0)._replace(torque=-5000.0, accel_long=G * math.sin(angle))
    f = forces(CAR, state, Environment(grade=angle))
    front = CAR.mass * G * (1.63 * math.cos(angle) - 0.53 * math.sin(angle)) / L
    assert f.load_front == pytest.approx(front)
    assert f.load_front + f.load_rear == pytest.approx(CAR.mass * G * math.cos(angle))
    assert f.accel_long == pytest.approx(G * math.sin(angle))
    assert f.force_long_front + f.force_long_rear == pytest.approx(CAR.mass * G * math.sin(angle))


def test_torque_is_split_by_axle_load_so_that_both_axles_use_the_same_friction():
    for torque, angle in ((2500.0, 0.0), (-3000.0, 0.0), (3000.0, 0.5)):
        environment = Environment(grade=angle)
        state = start(20.0)._replace(torque=torque, accel_long=G * math.sin(angle))
        after = seconds(state, torque=torque, environment=environment, time=0.6)
        f = forces(CAR, after, environment)
        rate = derivative(CAR, after, Actuation(0.0, torque), environment)
        # what turns the wheel faster does not reach the road
        front = f.force_long_front + CAR.wheel_inertia * rate.wheel_speed_front / CAR.wheel_radius
        rear = f.force_long_rear + CAR.wheel_inertia * rate.wheel_speed_rear / CAR.wheel_radius
        assert front + rear == pytest.approx(torque / CAR.wheel_radius)
        assert front / f.load_front == pytest.approx(rear / f.load_rear, rel=0.015)


def test_accelerometer_reads_speed_change_and_gravity():
    environment = Environment(grade=0.1, force_lat=500.0)
    state = seconds(start(20.0), torque=600.0, steer=0.03, environment=environment, time=0.7)
    rate = derivative(CAR, state, Actuation(0.03, 600.0), environment)
    f = forces(CAR, state, environment)
    assert f.accel_long == pytest.approx(
        rate.speed_long - state.speed_lat * state.yaw_rate + G * math.sin(0.1), abs=1e-9
    )
    assert f.accel_lat == pytest.approx(rate.speed_lat + state.speed_long * state.yaw_rate, abs=1e-9)


def test_tire_forces_turned_by_the_steering_angle_move_the_body():
    state = seconds(start(12.0), torque=900.0, steer=0.3, time=0.8)
    f = forces(CAR, state, ROAD)
    front = complex(f.force_long_front, f.force_lat_front) * complex(math.cos(state.steer), math.sin(state.steer))
    rear = complex(f.force_long_rear, f.force_lat_rear)
    resistance = 0.396 * state.speed_long**2 + 0.012 * CAR.mass * G
    total = front + rear - resistance
    assert complex(f.accel_long, f.accel_lat) * CAR.mass == pytest.approx(total)
    rate = derivative(CAR, state, Actuation(0.3, 900.0), ROAD)
    assert rate.yaw_rate * CAR.yaw_inertia == pytest.approx(1.05 * front.imag - 1.63 * rear.imag)
    speed = complex(state.speed_long, state.speed_lat)
    spinning = complex(rate.speed_long, rate.speed_lat) + 1j * state.yaw_rate * speed
    assert spinning * CAR.mass == pytest.approx(total)


def test_straight_driving_under_a_side_force_has_the_slip_of_the_linear_bicycle():
    force = 300.0
    steer = force / L * (CAR.front_axle / C_REAR - CAR.rear_axle / C_FRONT)  # yaw rate stays zero
    environment = Environment(force_lat=force)
    after = cruise(CAR, start(15.0), steer, 15.0, environment, 5000)
    assert after.yaw_rate == pytest.approx(0.0, abs=2e-4)
    assert math.atan2(after.speed_lat, 15.0) == pytest.approx(force * 1.05 / (L * C_REAR), rel=5e-3)


def test_crosswind_pushes_with_the_force_of_its_flow_angle():
    environment = Environment(wind_lat=25.0)
    f = forces(CAR, start(20.0), environment)
    angle = math.atan2(25.0, 20.0)
    area = 2.6 * math.tanh(5.0 * angle / 2.6)
    side = 0.6 * (20.0**2 + 25.0**2) * area
    assert f.accel_lat == pytest.approx(side / CAR.mass)
    assert 1200.0 < side < 2000.0
    rate = derivative(CAR, start(20.0), Actuation(0.0, 0.0), environment)
    assert rate.yaw_rate == pytest.approx(0.15 * 4.7 * side / CAR.yaw_inertia)


def test_headwind_adds_to_the_speed_through_the_air():
    still = forces(CAR, start(20.0), ROAD).accel_long
    wind = forces(CAR, start(20.0), Environment(wind_long=10.0)).accel_long
    assert (still - wind) * CAR.mass == pytest.approx(0.5 * 1.2 * 0.66 * (30.0**2 - 20.0**2))


# ---------------------------------------------------------------- actuators


def test_steering_has_its_lag_rate_and_limit():
    small = seconds(start(10.0), steer=0.01, time=0.05)
    assert small.steer == pytest.approx(0.01 * (1 - math.exp(-1.0)), rel=1e-6)
    ramp = seconds(start(1.0), steer=1.0, time=0.5)
    assert ramp.steer == pytest.approx(0.8 * 0.5)
    assert seconds(start(1.0), steer=1.0, time=2.0).steer == pytest.approx(0.61, abs=1e-6)


def test_torque_has_its_lag_and_limits():
    state = start(5.0)._replace(torque=0.0)
    assert seconds(state, torque=500.0, time=0.1).torque == pytest.approx(500.0 * (1 - math.exp(-1.0)), rel=1e-6)
    assert seconds(state, torque=1e5, time=2.0).torque == pytest.approx(3600.0)
    assert min(s.torque for s in trajectory(start(40.0), -1e5, 1.0)) == pytest.approx(-5000.0, rel=1e-3)
    fast = seconds(start(38.0), torque=1e5, time=3.0)
    spin = max(fast.wheel_speed_front, fast.wheel_speed_rear)
    assert fast.torque * spin == pytest.approx(280e3, rel=0.02)


def test_weak_actuators_do_their_share():
    weak = Environment(steer_effectiveness=0.5, torque_effectiveness=0.25)
    after = seconds(start(10.0), steer=0.1, torque=400.0, environment=weak, time=2.0)
    assert after.steer == pytest.approx(0.05)
    assert after.torque == pytest.approx(100.0)


def test_slip_control_keeps_the_wheels_turning_on_ice_and_off_it_they_lock():
    ice = Environment(friction=0.2)
    kept = trajectory(start(25.0), -5000.0, 2.0, ice)
    slips = [min(f.slip_ratio_front, f.slip_ratio_rear) for f in (forces(CAR, s, ice) for s in kept)]
    assert -0.28 < min(slips) < -0.1
    free = CAR._replace(slip_limit=0.0)
    locked = seconds(start(25.0), torque=-5000.0, environment=ice, time=2.0, params=free)
    assert locked.wheel_speed_front == 0.0
    assert locked.wheel_speed_rear == 0.0
    assert kept[-1].speed_long < locked.speed_long - 0.3  # sliding friction is lower
    spinning = seconds(start(5.0), torque=3600.0, environment=ice, time=2.0)
    assert 0.32 * spinning.wheel_speed_rear < spinning.speed_long / (1 - 0.28)


# ---------------------------------------------------------------- stopping, standing, starting


@pytest.mark.parametrize("torque", [-300.0, -1500.0, -5000.0])
def test_car_brakes_from_20_mps_to_rest_and_stays(torque):
    states = trajectory(start(20.0), torque, 40.0 if torque > -1000.0 else 12.0)
    speeds = np.array([s.speed_long for s in states])
    wheels = np.array([[s.wheel_speed_front, s.wheel_speed_rear] for s in states])
    assert speeds.min() >= 0.0
    assert wheels.min() >= 0.0
    assert np.all(np.diff(speeds[200:]) <= 1e-9)
    rest = int(np.argmax(speeds == 0.0))
    assert rest > 0
    assert all(s[:8] == states[rest][:8] for s in states[rest:])
    if torque == -5000.0:  # friction, not torque, decides: peak 0.967 g plus drag at most
        ideal = 20.0**2 / (2 * 0.967 * G)
        assert ideal < states[-1].x < 1.2 * ideal


@pytest.mark.parametrize("grade", [0.1, -0.1])
def test_braked_car_stays_on_a_ten_percent_grade_and_an_unbraked_one_rolls(grade):
    hill = Environment(grade=math.atan(grade))
    stopped = seconds(start(5.0), torque=-2000.0, environment=hill, time=6.0)
    assert stopped.speed_long == 0.0
    later = seconds(stopped, torque=-600.0, environment=hill, time=20.0)
    assert later[:8] == stopped[:8]
    assert forces(CAR, later, hill).accel_long == pytest.approx(G * math.sin(math.atan(grade)))
    released = seconds(stopped, torque=0.0, environment=hill, time=3.0)
    assert released.speed_long * grade < -1.0 * abs(grade)
    weak = seconds(stopped, torque=-200.0, environment=hill, time=3.0)
    assert weak.speed_long * grade < 0.0


def test_braked_car_slides_where_ice_cannot_hold_it():
    ice = Environment(grade=math.atan(0.1), friction=0.05)
    after = seconds(start(0.0)._replace(torque=-5000.0), torque=-5000.0, environment=ice, time=3.0)
    assert after.speed_long < -0.5


def test_standing_car_stays_put_even_when_steered():
    state = start(0.0)
    after = seconds(state, steer=0.5, time=3.0)
    assert after[:8] == state[:8]
    assert after.steer == pytest.approx(0.5)


@pytest.mark.parametrize("steer", [0.0, 0.5, -0.5])
def test_car_drives_off_from_standstill(steer):
    torque = 800.0
    states = trajectory(start(0.0), torque, 3.0, steer=steer)
    speeds = np.array([s.speed_long for s in states])
    assert np.all(np.diff(speeds) > -1e-6)
    assert speeds[-1] > 3.0
    assert max(abs(s.yaw_rate) for s in states) < 2.0
    if steer == 0.0:
        inertia = CAR.mass + 2 * CAR.wheel_inertia / CAR.wheel_radius**2
        force = torque / CAR.wheel_radius - CAR.rolling_resistance * CAR.mass * G
        assert speeds[-1] == pytest.approx(force / inertia * (3.0 - CAR.torque_lag), rel=0.02)


def test_car_climbs_and_descends_40_degrees_at_25_mps():
    for sign in (1.0, -1.0):
        hill = Environment(grade=sign * math.radians(40))
        force = CAR.mass * G * (math.sin(hill.grade) + 0.012 * math.cos(hill.grade)) + 0.396 * 25.0**2
        state = start(25.0)._replace(torque=0.32 * force, accel_long=sign * G * math.sin(math.radians(40)))
        after = cruise(CAR, state, 0.0, 25.0, hill, 10_000)
        assert after.speed_long == pytest.approx(25.0, abs=0.02)
        # one radius for torque and rolling: no leak
        assert after.torque == pytest.approx(0.32 * force, rel=2e-3)
        f = forces(CAR, after, hill)
        needed = abs(force) / (CAR.mass * G * math.cos(hill.grade))
        assert needed == pytest.approx(0.873 if sign > 0 else 0.805, abs=0.001)
        assert f.friction_use_front == pytest.approx(needed, rel=0.03)
        assert f.friction_use_rear == pytest.approx(needed, rel=0.03)


# ---------------------------------------------------------------- numerics


def test_one_step_has_order_four():
    state = seconds(start(20.0), torque=300.0, steer=0.02, time=0.4)._replace(torque=350.0)
    actuation = Actuation(0.025, 400.0)

    def after(count):
        return np.array(drive(CAR, state, actuation, ROAD, 0.016 / count, count))

    exact = after(16 * 32)  # 16 ms: later the wheels have settled and rounding shows
    errors = [np.abs(after(n) - exact)[3:8].max() for n in (16, 32, 64)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx(4.0, abs=0.35)


@pytest.mark.parametrize(
    ("speed", "steer", "torque", "environment"),
    [
        (20.0, 0.03, 300.0, ROAD),
        (25.0, 0.08, -900.0, Environment(friction=0.9, grade=0.1, force_lat=800.0, mass_factor=1.2)),
        (12.0, -0.2, 500.0, Environment(wind_long=-8.0, wind_lat=10.0, stiffness_rear_factor=0.85)),
    ],
)
def test_trajectory_agrees_with_an_independent_integrator(speed, steer, torque, environment):
    def rate(_, y):
        return np.array(derivative(CAR, VehicleState(*y), Actuation(steer, torque), environment))

    time = 1.0
    # the state has jumped into the maneuver, so that brake and drive do not change sides on the way
    state = start(speed)._replace(torque=torque)
    oracle = solve_ivp(rate, (0.0, time), np.array(state), method="LSODA", rtol=1e-9, atol=1e-10).y[:, -1]
    ours = np.array(seconds(state, torque=torque, steer=steer, environment=environment, time=time))
    assert ours == pytest.approx(oracle, rel=2e-6, abs=2e-6)


def test_small_motions_have_the_eigenvalues_of_the_linear_bicycle():
    speed = 20.0
    params = CAR._replace(drag_area=0.0, rolling_resistance=0.0)
    state = start(speed, params)

    def lateral_rate(speed_lat, yaw_rate):
        rate = derivative(
            params,
            state._replace(speed_lat=speed_lat, yaw_rate=yaw_rate),
            Actuation(0.0, 0.0),
            ROAD,
        )
        return np.array([rate.speed_lat, rate.yaw_rate])

    h = 1e-5
    measured = np.column_stack([lateral_rate(h, 0.0) / h, lateral_rate(0.0, h) / h])
    a, b = AXLES["front_axle"], AXLES["rear_axle"]
    m, i = CAR.mass, CAR.yaw_inertia
    linear = np.array(
        [
            [-(C_FRONT + C_REAR) / (m * speed), -speed - (a * C_FRONT - b * C_REAR) / (m * speed)],
            [-(a * C_FRONT - b * C_REAR) / (i * speed), -(a * a * C_FRONT + b * b * C_REAR) / (i * speed)],
        ]
    )
    assert np.sort_complex(np.linalg.eigvals(measured)) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(linear)), rel=1e-4
    )


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.0, 40.0),
    st.floats(-0.6, 0.6),
    st.floats(-5000.0, 3600.0),
    st.floats(-0.3, 0.3),
    st.floats(0.1, 1.2),
    st.floats(-3000.0, 3000.0),
)
def test_left_and_right_are_exact_mirrors(speed, steer, torque, grade, friction, force):
    environment = Environment(grade=grade, friction=friction, force_lat=force, moment_yaw=0.7 * force)
    mirrored = environment._replace(force_lat=-force, moment_yaw=-0.7 * force)
    left = seconds(start(speed), torque, steer, environment)
    right = seconds(start(speed), torque, -steer, mirrored)
    signs = (1, -1, -1, 1, -1, -1, 1, 1, -1, 1, 1)
    assert tuple(right) == tuple(s * value for s, value in zip(signs, left, strict=True))


@settings(max_examples=100, deadline=None)
@given(
    st.floats(0.0, 40.0),
    st.floats(-1.0, 1.0),
    st.floats(-6000.0, 6000.0),
    st.floats(-0.7, 0.7),
    st.floats(0.1, 1.3),
    st.floats(0.7, 1.6),
)
def test_any_command_leaves_a_finite_state_with_bounded_forces(speed, steer, torque, grade, friction, mass):
    environment = Environment(grade=grade, friction=friction, mass_factor=mass)
    state = start(speed)
    for _ in range(20):
        state = seconds(state, torque, steer, environment, time=0.1)
        f = forces(CAR, state, environment)
        assert np.all(np.isfinite(state))
        assert max(f.friction_use_front, f.friction_use_rear) <= 1.05 * (1 + 1e-9)
        assert f.load_front >= 0.0
        assert f.load_rear >= 0.0
        assert abs(f.accel_lat) < 1.1 * G * friction + 0.1
    assert abs(state.steer) <= 0.61
    assert -5000.0 <= state.torque <= 3600.0


@pytest.mark.parametrize("speed", [0.3, 2.0, 6.0])
@pytest.mark.parametrize("mass", [1.0, 1.6])
def test_slow_and_loaded_wheels_do_not_ring(speed, mass):
    # wheel speed must settle monotonically: no step of the integrator may overshoot
    environment = Environment(mass_factor=mass)
    state = start(speed)._replace(accel_long=-0.8 * G)  # as if braking hard: much load on the front wheels
    kicked = state._replace(wheel_speed_front=state.wheel_speed_front * 1.01 + 0.01)
    states = trajectory(kicked, state.torque, 0.02, environment)
    slips = [forces(CAR, s, environment).slip_ratio_front for s in states]
    assert all(later <= earlier + 1e-9 for earlier, later in itertools.pairwise(slips[:9]))


def test_parameters_are_a_checked_table():
    params = TypeAdapter(VehicleParams).validate_python({"mass": 1500, "tire": {"slip_stiffness": 20}})
    assert params.mass == 1500.0
    assert params.tire == TireParams(slip_stiffness=20.0)
    assert type(params.mass) is float


SCRIPT = """
from emran_sumo.plant.disturbance import DisturbanceParams, environment
from emran_sumo.plant.tire import slip_angle_for_force
from emran_sumo.plant.vehicle import Actuation, VehicleParams, forces, rolling_start, step
p, s = VehicleParams(), rolling_start(VehicleParams(), 22.0, 1.0, 2.0, 0.5)
d = DisturbanceParams(friction_amplitude=0.5, grade_pulse=0.3, grade_start=0.1, wind_amplitude=9.0,
                      gust_speed=20.0, gust_start=0.2, mass_amplitude=0.1, lateral_force=300.0)
for i in range(600):
    t = i * 0.001
    e = environment(d, 0.9, 0.01, 0.002, t, s.x, s.speed_long)
    s = step(p, s, Actuation(0.15 if i < 300 else -0.2, 900.0 if i < 200 else -4500.0), e, 0.001)
print([v.hex() for v in (*s, *forces(p, s, e), slip_angle_for_force(4e3, 8e3, 1.35e5, 1.05, 0.4, 1.0, 0.14))])
"""


def test_compiled_and_interpreted_plant_give_the_same_bits():
    outputs = [
        subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env={**os.environ, "NUMBA_DISABLE_JIT": off},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for off in ("0", "1")
    ]
    assert outputs[0].count("0x") == 26
    assert outputs[0] == outputs[1]
