import math

import numpy as np
import pytest

from emran_sumo.control.cruise import INPUTS, CruiseMemory, CruiseParams, Motion, cruise, resistance, rolling_memory
from emran_sumo.control.emran import LEARNED, NEURONS, SAMPLES, blank_memory
from emran_sumo.control.pid import PidMemory, PidParams
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.plant.vehicle import VehicleParams

CAR = VehicleParams()
G = 9.81
AIDED = CruiseParams()
BASE = AIDED._replace(emran=AIDED.emran._replace(authority=0.0))
PID_ONLY = BASE._replace(feedforward=False)
NO_FEEDBACK = BASE._replace(K_1=0.0, pid=PidParams(K_P=0.0, K_I=0.0, K_D=0.0, anti_windup=0.0))


def taken(speed):
    """Drag and rolling resistance of the car [m/s2], written out."""
    return (0.5 * 1.2 * 0.66 * speed**2 + 0.012 * 1480.0 * G) / 1480.0


def motion(speed, achieved, grade=0.0, accel=0.0, pitch_rate=0.0):
    """What the sensors say of a car on a grade."""
    return Motion(speed, accel + G * math.sin(grade), pitch_rate, achieved, 0.0)


def settled(speed, achieved, grade=0.0):
    force = G * math.sin(grade)
    return CruiseMemory(speed, force, force, achieved, achieved, achieved, PidMemory(0.0, 0.0, 0.0))


def network(params=AIDED):
    return blank_memory(params.emran, INPUTS)


# ---------------------------------------------------------------- one call


@pytest.mark.parametrize("speed", [5.0, 15.0, 35.0])
def test_resistance_is_drag_and_rolling(speed):
    assert resistance(CAR, speed) == pytest.approx(taken(speed), rel=1e-9)
    assert resistance(CAR, 0.0) == 0.0


@pytest.mark.parametrize("grade", [0.0, 0.1, -0.2])
@pytest.mark.parametrize("speed", [8.0, 25.0])
@pytest.mark.parametrize("params", [AIDED, BASE])
def test_command_balances_resistance_and_grade_at_constant_speed(params, speed, grade):
    needed = taken(speed) + G * math.sin(grade)
    nets, memory = network(), settled(speed, needed, grade)
    for _ in range(50):
        command, memory = cruise(params, nets, CAR, memory, motion(speed, needed, grade), speed, 0.0, 0.01)
        assert command.accel == pytest.approx(needed, abs=1e-9)
        assert command.network == 0.0


def test_pid_alone_starts_at_the_trim_it_is_given():
    at = motion(25.0, taken(25.0))
    memory = rolling_memory(25.0, at, taken(25.0))
    command, _ = cruise(PID_ONLY, network(), CAR, memory, at, 25.0, 0.0, 0.01)
    assert command.accel == pytest.approx(taken(25.0), abs=1e-12)


@pytest.mark.parametrize("params", [AIDED, BASE, PID_ONLY])
def test_command_stays_between_the_limits(params):
    for error, limit in ((50.0, AIDED.accel_max), (-50.0, -AIDED.decel_max)):
        memory = settled(60.0, 0.0)
        command, _ = cruise(params, network(), CAR, memory, motion(60.0, 0.0), 60.0 + error, 0.0, 0.01)
        assert command.accel == limit


@pytest.mark.parametrize("frequency", [1.0, 8.0, 25.0])
def test_lead_filter_has_the_frequency_response_of_its_transfer_function(frequency):
    period, nets = 0.0005, network()
    times = np.arange(round(12.0 / frequency / period + 2.0 / period)) * period
    asked = np.sin(frequency * times)
    known, memory, out = taken(20.0), settled(20.0, taken(20.0)), []
    for value in asked:
        command, memory = cruise(NO_FEEDBACK, nets, CAR, memory, motion(20.0, known), 20.0, value, period)
        out.append(command.accel - known)
        memory = memory._replace(speed=20.0, grade_accel=0.0)
    late = times > times[-1] - 2 * math.pi / frequency  # the last period, settled
    found = 2 * np.mean(np.array(out)[late] * np.exp(-1j * frequency * times[late])) * 1j
    expected = (1 + 0.1j * frequency) / (1 + 1j * CruiseParams().lead_filter * frequency)
    assert found == pytest.approx(expected, rel=0.02)


def test_lead_filter_turns_the_lag_of_the_drive_into_its_own_shorter_one():
    # both as backward differences, the lag cancels exactly
    rng, period, nets = np.random.default_rng(4), 0.01, network()
    known, memory = taken(20.0), settled(20.0, taken(20.0))
    drive = wanted = known
    for value in rng.normal(size=400):
        command, memory = cruise(NO_FEEDBACK, nets, CAR, memory, motion(20.0, known), 20.0, value, period)
        drive = (0.1 * drive + period * command.accel) / (0.1 + period)
        wanted = (CruiseParams().lead_filter * wanted + period * (known + value)) / (
            CruiseParams().lead_filter + period
        )
        memory = memory._replace(speed=20.0, grade_accel=0.0)
        assert drive == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("grade", [0.1, -0.3])
def test_grade_observer_converges_as_its_poles_say(grade):
    # s^2 + 4 s + 4: a double pole at -2 1/s
    period, nets, memory = 0.001, network(), settled(20.0, 0.0)
    memory = memory._replace(specific_force=G * math.sin(grade))
    for k in range(1, 8001):
        _, memory = cruise(BASE, nets, CAR, memory, motion(20.0, 0.0, grade), 20.0, 0.0, period)
        if k in (200, 500, 1500):
            t = k * period
            expected = G * math.sin(grade) * (1 - (1 + 2 * t) * math.exp(-2 * t))
            assert memory.grade_accel == pytest.approx(expected, rel=0.01)
    assert memory.grade_accel == pytest.approx(G * math.sin(grade), rel=1e-4)
    assert memory.speed == pytest.approx(20.0, abs=1e-4)


def test_gyro_lets_the_observer_follow_a_changing_grade():
    period, nets, memory = 0.01, network(), settled(20.0, 0.0)
    for k in range(1, 101):
        grade = 0.4 * k * period
        at = motion(20.0, 0.0, grade, pitch_rate=0.4)
        _, memory = cruise(BASE, nets, CAR, memory, at, 20.0, 0.0, period)
        assert memory.grade_accel == pytest.approx(G * math.sin(grade), abs=0.03)


def test_network_learns_the_missing_acceleration_with_its_sign():
    # the car needs 0.3 m/s2 more than the model says
    for missing in (0.3, -0.3):
        nets, memory = network(), settled(20.0, taken(20.0) + missing)
        for _ in range(300):
            at = motion(20.0, taken(20.0) + missing)
            command, memory = cruise(AIDED, nets, CAR, memory, at, 20.0, 0.0, 0.01)
        assert command.network == pytest.approx(missing, abs=0.02)
        assert abs(command.signal) < 0.02


@pytest.mark.parametrize("params", [BASE, PID_ONLY])
def test_network_without_authority_is_left_alone(params):
    nets = network()
    command, _ = cruise(params, nets, CAR, settled(20.0, 5.0), motion(20.0, 5.0), 25.0, 1.0, 0.01)
    assert (command.network, command.learned, nets.counts[SAMPLES]) == (0.0, False, 0)


# ---------------------------------------------------------------- closed loop


@pytest.mark.parametrize("controller", ["coupled-emran", "coupled-base", "pid-stanley"])
def test_constant_speed_on_the_flat_is_held(bench, controller):
    found = bench.drive(bench.straight(500.0), 20.0, 10.0, controller)
    assert np.abs(found.column("speed_error")).max() < 5e-3
    assert found.column("accel_command")[-1] == pytest.approx(taken(20.0), abs=0.01)


@pytest.mark.parametrize("controller", ["coupled-emran", "coupled-base", "pid-stanley"])
def test_heavier_car_on_a_hill_comes_back_to_its_speed(bench, controller):
    hill = DisturbanceParams(grade_pulse=0.1, grade_start=2.0, grade_duration=100.0, mass_factor=1.15)
    found = bench.drive(bench.straight(1000.0), 15.0, 30.0, controller, disturbance=hill)
    error = np.abs(found.column("speed_error"))
    assert error[-1] < 0.02
    # this PID against a disturbance of 1 m/s2 loses 0.3 to 0.6 m/s before its integral has it (dv/dt = u - d)
    assert error.max() < (0.6 if controller == "pid-stanley" else 0.1)


def test_grade_is_felt_less_by_each_better_law(bench):
    hill = DisturbanceParams(grade_pulse=0.17, grade_start=2.0, grade_duration=10.0, mass_factor=1.1)
    worst = [
        np.abs(bench.drive(bench.straight(700.0), 20.0, 20.0, name, disturbance=hill).column("speed_error")).max()
        for name in ("pid-stanley", "coupled-base", "coupled-emran")
    ]
    assert worst[1] < 0.3 * worst[0]
    assert worst[2] < worst[1]


def stop_and_go(wait):
    times = np.arange(0.0, wait + 14.005, 0.01)
    return np.interp(times, [0.0, 1.0, 5.0, 5.0 + wait, 10.0 + wait], [10.0, 10.0, 0.0, 0.0, 10.0])


@pytest.mark.parametrize("grade", [0.0, 0.1, -0.1])
@pytest.mark.parametrize("controller", ["coupled-emran", "coupled-base", "pid-stanley"])
def test_car_stops_stays_and_starts_again(bench, controller, grade):
    found = bench.drive(bench.straight(300.0, grade=grade), 10.0, 21.99, controller, speeds=stop_and_go(8.0))
    time, speed = found.column("time"), found.column("speed_long")
    waiting = (time > 8.0) & (time < 12.9)
    assert np.ptp(found.column("x")[waiting]) < 1e-9
    # on a hill a PID rolls back while its drive lags: 0.1 s times 0.98 m/s2
    assert speed.min() > (-0.1 if controller == "pid-stanley" else -0.02)
    # slowest mode of the PID: exp(-0.55 t) of about 1 m/s, 4 s after the end of the ramp
    assert abs(found.column("speed_error")[-1]) < (0.2 if controller == "pid-stanley" else 0.02)


@pytest.mark.parametrize("grade", [0.0, 0.1])
def test_brakes_that_hold_the_car_teach_the_network_nothing(bench, grade):
    found = bench.drive(bench.straight(300.0, grade=grade), 10.0, 14.0, speeds=stop_and_go(30.0)[:1401])
    standing = found.column("time") > 8.0
    assert np.ptp(found.column("learned_speed")[standing]) == 0
    assert found.column("accel_network")[-1] == pytest.approx(0.0, abs=0.5)
    needed = 1.5 + G * math.sin(grade)
    assert found.column("accel_command")[-1] == pytest.approx(-needed, abs=0.2)


def test_waiting_longer_does_not_change_the_start(bench):
    road = bench.straight(300.0)
    short = bench.drive(road, 10.0, 16.99, speeds=stop_and_go(3.0))
    long = bench.drive(road, 10.0, 33.99, speeds=stop_and_go(20.0))
    a, b = short.column("speed_error")[-850:], long.column("speed_error")[-850:]
    np.testing.assert_allclose(a, b, atol=0.01)


def test_standing_network_keeps_what_it_knows(bench):
    found = bench.drive(bench.straight(300.0), 10.0, 14.0, speeds=stop_and_go(30.0)[:1401])
    nets = found.networks.speed
    assert nets.counts[LEARNED] <= nets.counts[SAMPLES]
    assert nets.counts[NEURONS] <= AIDED.emran.neurons_max
    assert abs(nets.bias[0]) < 0.5
