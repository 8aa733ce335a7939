import math

import numpy as np
import pytest

from emran_sumo.control.fuzzy import RULES, FuzzyParams, blank_fuzzy, firing, fuzzy_pid, membership, observe, train
from emran_sumo.plant.vehicle import VehicleParams, rolling_start

CAR = VehicleParams()
P = FuzzyParams(width=0.25, blur=0.15, cross_track_span=0.4, heading_span=0.1)


def car(speed, **state):
    return rolling_start(CAR, speed, 0.0, 0.0, 0.0)._replace(**state)


@pytest.mark.parametrize(
    ("x", "upper", "lower"),
    [
        (0.5, 1.0, math.exp(-0.18)),  # at the center: surely within, 0.6 widths from either mean
        (0.6, 1.0, math.exp(-0.5)),  # between the means, a width from the farther one: 0.25
        (0.65, 1.0, math.exp(-0.72)),  # at a mean
        (0.9, math.exp(-0.5), math.exp(-0.5 * 2.2**2)),  # one width beyond the nearer mean
        (0.1, math.exp(-0.5), math.exp(-0.5 * 2.2**2)),
    ],
)
def test_membership_has_the_values_worked_out_by_hand(x, upper, lower):
    assert membership(x, 0.5, 0.25, 0.15) == pytest.approx((upper, lower), rel=1e-12)


def test_sharp_sets_are_of_type_1():
    for x in (-0.3, 0.2, 0.5):
        upper, lower = membership(x, 0.5, 0.25, 0.0)
        assert upper == lower == pytest.approx(math.exp(-0.5 * ((x - 0.5) / 0.25) ** 2))


def fired(params, e, psi):
    out = np.empty(RULES)
    firing(params, e, psi, out)
    return out.reshape(5, 5)


def test_firing_of_hand_computed_points():
    # sharp sets, both inputs at a center: the neighbors, two widths away, fire with exp(-2), the next with exp(-8)
    one = np.array([math.exp(-8), math.exp(-2), 1.0, math.exp(-2), math.exp(-8)])
    expected = np.outer(one, one) / one.sum() ** 2
    np.testing.assert_allclose(fired(P._replace(blur=0.0), 0.0, 0.0), expected, rtol=1e-12)
    # half way between two centers both fire alike, whatever the blur
    half = fired(P, 0.1, 0.0)
    np.testing.assert_allclose(half[2], half[3], rtol=1e-12)
    # beyond the outermost set the input is held there
    np.testing.assert_array_equal(fired(P, 3.0, -2.0), fired(P, 0.4, -0.1))
    assert fired(P, 3.0, -2.0).argmax() == 4 * 5 + 0


def test_firing_adds_up_and_is_mirror_symmetric():
    rng = np.random.default_rng(0)
    for e, psi in rng.normal(scale=0.2, size=(50, 2)):
        found = fired(P, e, psi)
        assert found.sum() == pytest.approx(1.0)
        assert found.min() > 0.0
        np.testing.assert_allclose(fired(P, -e, -psi), found[::-1, ::-1], rtol=1e-9)


def test_untrained_law_is_a_pid_beside_the_angle_of_the_bend():
    params = P._replace(K_I=0.0, teaching=0.0, disturbance_max=0.0)
    state = car(1.0, yaw_rate=0.05, speed_lat=0.02)  # too slow to learn or to integrate
    found, after = fuzzy_pid(params, blank_fuzzy(params), CAR, state, 0.2, 0.03, 0.1, 0.0, 0.035, 0.01)
    s = 0.2 + params.lookahead * (0.03 + math.atan(1.63 * 0.1))
    rate = math.sin(0.03) - 0.02 * math.cos(0.03) + params.lookahead * (1.0 * 0.1 - 0.05)
    assert found == pytest.approx(math.atan(2.68 * 0.1) + params.K_P * s + params.K_D * rate, rel=1e-12)
    assert (after.integral, after.speed_lat, after.yaw_rate) == (0.0, 0.02, 0.05)


def test_training_is_a_kalman_filter_with_one_block_for_each_rule():
    params, rng = P._replace(gain_range=10.0, drift=1e-3, variance=5.0, noise=0.5), np.random.default_rng(1)
    memory = blank_fuzzy(params)
    theta, p = memory.gains.ravel().copy(), 5.0 * np.eye(3 * RULES)
    blocks = np.kron(np.eye(RULES), np.ones((3, 3)))
    for _ in range(20):
        phi, parts = rng.uniform(size=RULES), rng.normal(size=3)
        phi /= phi.sum()
        train(params, memory, phi, parts, 0.01)
        b = np.outer(phi, parts).ravel()
        gain = p @ b / (0.5 + b @ p @ b)
        theta = theta + gain * 0.01
        theta = np.clip(theta.reshape(-1, 3), memory.gains[0] * 0 + [0.1 * g for g in params[1:4]], None)
        theta = np.minimum(theta, [10.0 * g for g in params[1:4]]).ravel()
        p = (p - np.outer(gain, p @ b)) * blocks
        p[np.diag_indices(3 * RULES)] = np.minimum(np.diag(p) + 1e-3, 5.0)
        np.testing.assert_allclose(memory.gains.ravel(), theta, rtol=1e-10)
        np.testing.assert_allclose(memory.covariance, np.array([p[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(25)]),
                                   rtol=1e-9, atol=1e-12)  # fmt: skip


def test_trained_gains_stay_within_their_range():
    memory, parts = blank_fuzzy(P), np.array([1.0, -1.0, 0.5])
    phi = np.full(RULES, 1.0 / RULES)
    for _ in range(3000):
        train(P, memory, phi, parts, 0.1)
    first = np.array([P.K_P, P.K_I, P.K_D])
    assert (memory.gains <= P.gain_range * first * (1 + 1e-12)).all()
    assert (memory.gains >= first / P.gain_range * (1 - 1e-12)).all()
    assert memory.gains[0, 0] == pytest.approx(P.gain_range * P.K_P)
    assert memory.gains[0, 1] == pytest.approx(P.K_I / P.gain_range)


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_observer_finds_an_acceleration_that_the_bicycle_misses(push):
    # side speed held at 0 on a straight against a constant push: the bicycle misses exactly that push
    from emran_sumo.control.bicycle import bicycle

    model = bicycle(CAR, 15.0)
    steer = -push / model.lat_steer * 1.0
    r = -(model.yaw_steer * steer) / model.yaw_yaw * 0.0
    state = car(15.0, steer=steer, speed_lat=0.0, yaw_rate=r)
    memory = blank_fuzzy(P)
    for _ in range(1500):
        side, turn, miss = observe(P, memory, CAR, state, 0.01)
        memory = memory._replace(speed_lat=side, yaw_rate=turn)
    assert miss == pytest.approx(push, rel=0.05)
    assert (side, turn) == pytest.approx((0.0, 0.0), abs=5e-3)
