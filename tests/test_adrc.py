import math

import numpy as np
import pytest

from emran_sumo.control.adrc import AdrcMemory, AdrcParams, adrc, blank_adrc, fal, fhan, flat_adrc, percussion_arm
from emran_sumo.control.bicycle import bicycle, steady_turn
from emran_sumo.plant.vehicle import VehicleParams, rolling_start

CAR = VehicleParams()
# no nonlinearity, and a transition as fast as the errors ask
LINEAR = AdrcParams(
    control_bandwidth=4.0,
    observer_bandwidth=20.0,
    error_power=1.0,
    rate_power=1.0,
    estimate_zone=10.0,
    transition=100.0,
)


def test_differentiator_goes_to_rest_in_the_least_time():
    # bang-bang: from rest, a distance D under the bound r takes 2 sqrt(D / r), half of it each way
    r, distance, h = 2.0, 5.0, 1e-3
    x, v, times, peak = distance, 0.0, 0.0, 0.0
    while abs(x) > 1e-3 * distance or abs(v) > 1e-2:
        a = fhan(x, v, r, h)
        assert abs(a) <= r * (1 + 1e-12)
        x, v, times = x + h * v, v + h * a, times + h
        peak = max(peak, abs(v))
        assert x > -1e-3
    assert times == pytest.approx(2 * math.sqrt(distance / r), rel=0.02)
    assert peak == pytest.approx(math.sqrt(distance * r), rel=0.01)


def test_differentiator_is_at_rest_in_the_end():
    assert fhan(0.0, 0.0, 3.0, 0.05) == 0.0
    assert fhan(1.0, 0.0, 3.0, 0.05) == -3.0
    assert fhan(-1.0, 0.0, 3.0, 0.05) == 3.0


def test_power_law_joins_its_linear_zone():
    for power in (0.25, 0.5, 1.0, 1.5):
        assert fal(0.1, power, 0.1) == pytest.approx(0.1**power)
        assert fal(0.05, power, 0.1) == pytest.approx(0.5 * 0.1**power)
        assert fal(-0.4, power, 0.1) == -fal(0.4, power, 0.1) == -(0.4**power)


def textbook(params, f, b0, begin, time, h=1e-3, known_share=1.0, asked=None):
    """y'' = f(t) + b0 u, simulated exactly over each period for constant u."""
    y, rate, memory, u = begin, 0.0, blank_adrc(), 0.0
    out = []
    for k in range(round(time / h)):
        push, memory = adrc(params, memory, y, known_share * b0 * u, h)
        u = push / b0 if asked is None else asked
        a = f(k * h) + b0 * u
        y, rate = y + h * rate + 0.5 * h * h * a, rate + h * a
        out.append((y, rate, memory.disturbance, push))
    return np.array(out)


def test_observer_finds_a_constant_disturbance_as_its_triple_pole_says():
    # z_3 / f = 1 - exp(-w t) (1 + w t + (w t)^2 / 2): observer of a double integrator, all poles at -w
    w, h, f = LINEAR.observer_bandwidth, 1e-4, 1.7
    found = textbook(LINEAR, lambda _: f, 1.0, 0.0, 0.5, h, known_share=0.0, asked=0.0)[:, 2]
    t = h * np.arange(1, found.size + 1)
    expected = f * (1.0 - np.exp(-w * t) * (1.0 + w * t + 0.5 * (w * t) ** 2))
    np.testing.assert_allclose(found, expected, atol=0.005 * f)


def test_double_integrator_with_a_disturbance_ends_at_rest_where_it_should():
    for f in (0.0, 3.0, -3.0):
        found = textbook(AdrcParams(), lambda _, f=f: f, 7.0, 0.5, 8.0)
        assert found[-1, :3] == pytest.approx([0.0, 0.0, f], abs=2e-3)


def test_linear_law_moves_the_double_integrator_with_its_bandwidth():
    # known plant, disturbance 0: y from 0 with speed V moves as V t exp(-w_c t)
    w, h, speed = LINEAR.control_bandwidth, 1e-4, 0.3
    memory, y, rate, u = AdrcMemory(0.0, 0.0, 0.0, speed, 0.0, True), 0.0, speed, 0.0
    found = []
    for _ in range(15_000):
        u, memory = adrc(LINEAR, memory, y, u, h)
        y, rate = y + h * rate, rate + h * u
        found.append(y)
    t = h * np.arange(1, 15_001)
    np.testing.assert_allclose(found, speed * t * np.exp(-w * t), atol=2e-3 * speed)


@pytest.mark.parametrize("frequency", [0.5, 2.0, 8.0])
def test_sine_disturbance_leaves_what_the_transfer_function_says(frequency):
    # e = z_1 - y = -s f / (s + w_o)^3;  (s + w_c)^2 y = (f - z_3) - w_c^2 e - 2 w_c (s + 3 w_o) e
    s, wo, wc = 1j * frequency, LINEAR.observer_bandwidth, LINEAR.control_bandwidth
    e = -s / (s + wo) ** 3
    rest = 1.0 - wo**3 / (s + wo) ** 3
    expected = abs((rest - wc**2 * e - 2 * wc * (s + 3 * wo) * e) / (s + wc) ** 2)
    cycle = round(2 * math.pi / frequency / 1e-3)
    found = textbook(LINEAR, lambda t: math.sin(frequency * t), 1.0, 0.0, 6.0 + 2e-3 * cycle)[-cycle:, 0]
    assert np.ptp(found) / 2 == pytest.approx(expected, rel=0.02)


def test_a_rear_force_does_not_move_the_front_center_of_percussion():
    # y'' = F / m - d l_r F / I_z for a force F at the rear axle
    arm = percussion_arm(CAR)
    assert 1.0 / CAR.mass - arm * CAR.rear_axle / CAR.yaw_inertia == pytest.approx(0.0, abs=1e-12)
    assert arm == pytest.approx(0.974, abs=1e-3)


@pytest.mark.parametrize("speed", [5.0, 15.0, 25.0])
@pytest.mark.parametrize("kappa", [0.01, -0.01])
def test_angle_of_a_steady_bend_is_that_of_the_linear_bicycle(speed, kappa):
    side_slip, angle = steady_turn(CAR, speed)
    memory = AdrcMemory(0.0, 0.0, 0.0, 0.0, 0.0, True)
    state = rolling_start(CAR, speed, 0.0, 0.0, 0.0)._replace(
        speed_lat=speed * math.tan(side_slip * kappa), yaw_rate=speed * kappa, steer=angle * kappa
    )
    arm = percussion_arm(CAR)  # a point so far ahead is off a path that the center of gravity follows
    beside = arm * side_slip * kappa + 0.5 * arm**2 * kappa
    found, after = flat_adrc(AdrcParams(), memory, CAR, state, beside, 0.0, kappa, kappa, 0.01)
    assert found == pytest.approx(angle * kappa, rel=2e-3)
    assert after.disturbance == pytest.approx(0.0, abs=1e-12)


def test_linear_bicycle_turns_steadily_as_it_is_said_to():
    for speed in (3.0, 12.0, 30.0):
        car, (side_slip, angle) = bicycle(CAR, speed), steady_turn(CAR, speed)
        lat, yaw = speed * side_slip, speed  # per curvature
        assert car.lat_lat * lat + car.lat_yaw * yaw + car.lat_steer * angle == pytest.approx(0.0, abs=1e-9 * speed**2)
        assert car.yaw_lat * lat + car.yaw_yaw * yaw + car.yaw_steer * angle == pytest.approx(0.0, abs=1e-9 * speed**2)


def test_standing_car_is_steered_by_eq_22_and_the_observer_waits():
    state = rolling_start(CAR, 0.0, 0.0, 0.0, 0.0)._replace(steer=0.4)
    angle, memory = flat_adrc(AdrcParams(), blank_adrc(), CAR, state, 0.1, 0.05, 0.0, 0.0, 0.01)
    assert angle == pytest.approx(0.05 + math.atan(AdrcParams().control_bandwidth * 0.1 / 1.1))
    assert memory == blank_adrc()
