import math

import numpy as np
import pytest
from scipy.signal import TransferFunction, step

from emran_sumo.control.pid import PidMemory, PidParams, pid

BLANK = PidMemory(0.0, 0.0, 0.0)


def closed_loop_step(params, time_constant, period, duration):
    """Unit step of the PID with the plant 1 / (time_constant s + 1), exact for a held command."""
    keep = math.exp(-period / time_constant)
    y, memory, out = 0.0, BLANK, []
    for _ in range(round(duration / period)):
        out.append(y)
        u, memory = pid(params, memory, 1.0 - y, 0.0, period)
        y = keep * y + (1.0 - keep) * u
    return np.array(out)


def theory(params, time_constant, times):
    """u = (K_P + K_I / s + K_D s / (T s + 1)) e around the same plant, continuous."""
    p, i, d, lag = params.K_P, params.K_I, params.K_D, params.derivative_lag
    controller = np.array([p * lag + d, p + i * lag, i])
    plant = np.polymul([lag, 1.0, 0.0], [time_constant, 1.0])
    return step(TransferFunction(controller, np.polyadd(plant, controller)), T=times)[1]


@pytest.mark.parametrize("params", [PidParams(), PidParams(K_P=3.0, K_I=0.5, K_D=0.0), PidParams(2.0, 4.0, 0.3, 0.2)])
def test_closed_loop_converges_with_the_period_to_the_continuous_one(params):
    errors = []
    for period in (0.004, 0.002, 0.001):
        found = closed_loop_step(params, 0.8, period, 6.0)
        expected = theory(params, 0.8, np.arange(found.size) * period)
        errors.append(np.abs(found - expected).max())
    assert errors[2] < 5e-3
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.15)  # first order in the period
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.15)


def test_each_term_acts_alone():
    only = PidParams(K_P=0.0, K_I=0.0, K_D=0.0)
    assert pid(only._replace(K_P=2.0), BLANK, 1.5, 0.0, 0.01)[0] == 3.0
    assert pid(only._replace(K_I=2.0), BLANK, 1.5, 0.0, 0.01)[0] == pytest.approx(0.03)
    assert pid(only._replace(K_D=2.0), PidMemory(0.0, 0.0, 1.5), 1.5, 0.0, 0.01)[0] == 0.0


def test_derivative_of_a_ramp_is_its_slope_after_the_filter():
    params = PidParams(K_P=0.0, K_I=0.0, K_D=0.7, derivative_lag=0.05)
    memory, found = BLANK, []
    for k in range(1, 101):
        found.append(pid(params, memory, 3.0 * k * 0.001, 0.0, 0.001)[0])
        memory = pid(params, memory, 3.0 * k * 0.001, 0.0, 0.001)[1]
    expected = 0.7 * 3.0 * (1 - np.exp(-np.arange(1, 101) * 0.001 / 0.05))
    np.testing.assert_allclose(found, expected, rtol=0.02)


@pytest.mark.parametrize("period", [0.001, 0.01, 0.05])
def test_derivative_kick_of_a_step_has_the_area_of_the_gain(period):
    params = PidParams(K_P=0.0, K_I=0.0, K_D=0.682)
    memory, area = BLANK, 0.0
    for _ in range(2000):
        command, memory = pid(params, memory, 1.0, 0.0, period)
        area += command * period
    assert area == pytest.approx(0.682, rel=1e-9)


@pytest.mark.parametrize("period", [0.001, 0.01])
def test_derivative_is_never_larger_than_its_filter_allows(period):
    params = PidParams(K_P=0.0, K_I=0.0, K_D=0.682, derivative_lag=0.05)
    assert pid(params, BLANK, 1.0, 0.0, period)[0] <= 0.682 / 0.05


@pytest.mark.parametrize(("error", "limit"), [(2.0, 1.0), (-3.0, -2.0)])
def test_windup_ends_where_back_calculation_balances_the_error(error, limit):
    # K_I e + anti_windup (achieved - asked) = 0
    params, memory, asked = PidParams(), BLANK, 0.0
    for _ in range(3000):
        achieved = min(asked, limit) if limit > 0 else max(asked, limit)
        asked, memory = pid(params, memory, error, achieved - asked, 0.01)
    assert asked == pytest.approx(limit + params.K_I * error / params.anti_windup, rel=1e-6)


def overshoot(params):
    """A vehicle, dv/dt = u with |u| <= 1, asked for 10 m/s more; the memory of a command is that of the last one."""
    v, memory, asked, achieved, highest = 0.0, BLANK, 0.0, 0.0, 0.0
    for _ in range(6000):
        asked, memory = pid(params, memory, 10.0 - v, achieved - asked, 0.01)
        achieved = min(max(asked, -1.0), 1.0)
        v += 0.01 * achieved
        highest = max(highest, v)
    return highest - 10.0, v


def test_anti_windup_keeps_a_limited_command_from_overshooting():
    without, _ = overshoot(PidParams(anti_windup=0.0))
    with_it, last = overshoot(PidParams())
    assert without > 3.0
    assert with_it < 0.5 * without
    assert last == pytest.approx(10.0, abs=0.01)


def test_steady_disturbance_leaves_no_error():
    v, memory = 0.0, BLANK
    for _ in range(4000):
        u, memory = pid(PidParams(), memory, -v, 0.0, 0.01)
        v += 0.01 * (u - 1.7)
    assert v == pytest.approx(0.0, abs=1e-9)
    assert memory.integral == pytest.approx(1.7)
