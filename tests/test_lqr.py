import math

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from emran_sumo.control.lqr import (
    SLOWEST,
    SPACING,
    LqPreviewParams,
    LqrParams,
    error_model,
    lqr,
    lqr_gains,
    riccati,
    zero_order_hold,
)
from emran_sumo.path import nearest
from emran_sumo.plant.vehicle import VehicleParams, rolling_start

CAR, T = VehicleParams(), 0.01
M, IZ, LF, LR, CF, CR, LAG = 1480.0, 2350.0, 1.05, 1.63, 135_000.0, 95_000.0, 0.05
WEIGHTS = LqrParams(cross_track=2.0, cross_track_rate=0.3, heading=0.7, yaw_rate=0.1)
SPEEDS = (1.0, 4.5, 10.0, 20.0, 45.0)


def rajamani(v):
    """Error model of the textbook: e_1, de_1/dt, e_2, de_2/dt and the angle of the wheels, by hand."""
    a = np.zeros((5, 5))
    a[0, 1] = a[2, 3] = 1.0
    a[1] = [0, -(CF + CR) / (M * v), (CF + CR) / M, (LR * CR - LF * CF) / (M * v), CF / M]
    a[3] = [
        0, -(LF * CF - LR * CR) / (IZ * v), (LF * CF - LR * CR) / IZ, -(LF**2 * CF + LR**2 * CR) / (IZ * v), LF * CF / IZ,
    ]  # fmt: skip
    a[4, 4] = -1.0 / LAG
    return a, np.array([[0, 0, 0, 0, 1.0 / LAG]]).T


def discrete(a, b):
    m = np.zeros((6, 6))
    m[:5, :5], m[:5, 5:] = a * T, b * T
    m = expm(m)
    return m[:5, :5], m[:5, 5:]


def dare_gain(a, b, q):
    p = solve_discrete_are(a, b, q, np.eye(1))
    return np.linalg.solve(1.0 + b.T @ p @ b, b.T @ p @ a)


def to_textbook(v):
    """e_1, de_1/dt, e_2, de_2/dt, delta of the states e_1, v_y, e_2, r, delta on a straight path."""
    change = np.eye(5)
    change[1, 2] = v
    return change


@pytest.mark.parametrize("speed", SPEEDS)
def test_gains_are_those_of_scipy_for_the_error_model_of_the_textbook(speed):
    a, b = discrete(*rajamani(speed))
    q = np.diag([2.0, 0.3, 0.7, 0.1, 0.0])
    expected = dare_gain(a, b, q) @ to_textbook(speed)
    found = lqr_gains(WEIGHTS, CAR, T).feedback[round((speed - SLOWEST) / SPACING)]
    np.testing.assert_allclose(found, expected[0], rtol=1e-7, atol=1e-9)


def test_riccati_and_zero_order_hold_agree_with_scipy_on_random_models():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(20, 4, 4)), rng.normal(size=(20, 4, 1))
    root = rng.normal(size=(20, 4, 4))
    q = root @ root.transpose(0, 2, 1)
    held = zero_order_hold(3.0 * a, b, 0.4)
    for k in range(20):
        m = np.zeros((5, 5))
        m[:4, :4], m[:4, 4:] = 1.2 * a[k], 0.4 * b[k]
        np.testing.assert_allclose(held[0][k], expm(m)[:4, :4], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(held[1][k], expm(m)[:4, 4:], rtol=1e-9, atol=1e-9)
    for k, p in enumerate(riccati(a, b, q)):
        np.testing.assert_allclose(p, solve_discrete_are(a[k], b[k], q[k], np.eye(1)), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("speed", SPEEDS)
def test_closed_loop_is_stable_with_the_gains_between_two_rows_of_the_table(speed):
    table = lqr_gains(WEIGHTS, CAR, T).feedback
    v = min(speed + 0.5 * SPACING, 45.9)
    row = (v - SLOWEST) / SPACING
    gain = table[int(row)] + (row - int(row)) * (table[int(row) + 1] - table[int(row)])
    a, b = discrete(*error_model(CAR, v))
    assert np.abs(np.linalg.eigvals(a - b @ gain[None])).max() < 1.0
    q = np.linalg.inv(to_textbook(v)).T  # weights are on the textbook's states
    q = np.linalg.inv(q) @ np.diag([2.0, 0.3, 0.7, 0.1, 0.0]) @ to_textbook(v)
    np.testing.assert_allclose(gain, dare_gain(a, b, q)[0], rtol=0.03, atol=2e-3)


def call(gains, state, kappa, offset=0.0, heading=0.0, path=None, position=0.0):
    if path is None:
        from tests.conftest import circle

        path = circle(1 / kappa, 200.0) if kappa else circle(1e9, 200.0)
    return lqr(gains, CAR, state, path, position, -offset, -heading, kappa, T)


@pytest.mark.parametrize("params", [LqrParams(), LqPreviewParams()], ids=["lqr", "preview"])
@pytest.mark.parametrize("speed", [0.5, 8.0, 25.0])
@pytest.mark.parametrize("kappa", [0.008, -0.008])
def test_steady_bend_is_driven_with_its_own_angle(bench, params, speed, kappa):
    slope = M * speed**2 / (LF + LR)
    beta, angle = (LR - LF * slope / CR) * kappa, (LF + LR + slope * (LR / CF - LF / CR)) * kappa
    state = rolling_start(CAR, speed, 0.0, 0.0, 0.0)._replace(
        speed_lat=speed * beta, yaw_rate=speed * kappa, steer=angle
    )
    path = bench.circle(1 / kappa, 200.0)
    found = lqr(lqr_gains(params, CAR, T), CAR, state, path, 20.0, 0.0, beta, kappa, T)
    assert found == pytest.approx(angle, rel=1e-9)


@pytest.mark.parametrize("speed", [5.0, 10.0, 20.0])
def test_preview_is_the_optimum_of_a_problem_solved_at_once(bench, speed):
    # all inputs of 3 s by least squares, for a path that bends 0.3 s ahead; the first input is what the law must say
    params = LqPreviewParams(cross_track=2.0, cross_track_rate=0.3, heading=0.7, yaw_rate=0.1, horizon=1.5)
    n, bend_at, kappa = 400, 0.3, 0.01
    a, b = rajamani(speed)
    a = np.linalg.inv(to_textbook(speed)) @ a @ to_textbook(speed)  # states e_1, v_y, e_2, r, delta
    b = np.linalg.inv(to_textbook(speed)) @ b
    a, b = discrete(a, b)
    slope = M * speed**2 / (LF + LR)
    beta, angle = LR - LF * slope / CR, LF + LR + slope * (LR / CF - LF / CR)
    steady = np.array([0.0, speed * beta, -beta, speed, angle])
    curvature = np.where(np.arange(n + 1) * T >= bend_at - 1e-9, kappa, 0.0)
    # e_2 turns with the path; the rest of a steady bend holds itself
    entry = steady - a @ steady - b[:, 0] * angle
    weights = np.linalg.cholesky(np.diag([2.0, 0.3, 0.7, 0.1])).T @ to_textbook(speed)[:4]
    moves, free = np.zeros((n + 1, 5, n)), np.zeros((n + 1, 5))
    for k in range(n):
        moves[k + 1] = a @ moves[k]
        moves[k + 1][:, k] += b[:, 0]
        free[k + 1] = a @ free[k] + entry * curvature[k]
    off = free - np.outer(curvature, steady)
    rows = np.concatenate([(weights @ moves[k]) for k in range(n + 1)] + [np.eye(n)])
    target = np.concatenate([weights @ off[k] for k in range(n + 1)] + [-angle * curvature[:n]])
    expected = np.linalg.lstsq(rows, -target, rcond=None)[0][0]
    line = bench.straight(400.0, spacing=speed * T)
    path = line._replace(curvature=np.where(line.x >= speed * bend_at - 1e-9, kappa, 0.0))
    state = rolling_start(CAR, speed, 0.0, 0.0, 0.0)
    found = lqr(lqr_gains(params, CAR, T), CAR, state, path, 0.0, 0.0, 0.0, 0.0, T)
    assert abs(expected) > 1e-5
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-7)


def test_gains_hold_below_the_slowest_speed_of_the_table(bench):
    gains, path = lqr_gains(LqrParams(), CAR, T), bench.straight(50.0)
    slow, slower = (
        lqr(gains, CAR, rolling_start(CAR, v, 0.0, 0.0, 0.0), path, 10.0, 0.1, 0.0, 0.0, T) for v in (1.0, 0.0)
    )
    assert slow == slower == pytest.approx(gains.feedback[0, 0] * 0.1)
    fast = lqr(gains, CAR, rolling_start(CAR, 60.0, 0.0, 0.0, 0.0), path, 10.0, 0.1, 0.0, 0.0, T)
    assert math.isfinite(fast)
    assert fast == pytest.approx(gains.feedback[-1, 0] * 0.1, rel=1e-3)


def test_car_beside_the_path_is_led_back(bench):
    for name in ("lqr", "lq-preview"):
        found = bench.drive(bench.straight(400.0), 15.0, 6.0, name, position=5.0)
        assert np.abs(found.column("cross_track_error")).max() == 0.0
    line = bench.straight(400.0)
    at = nearest(line, 5.0, 0.5, 5.0)
    assert at.position == 5.0
