import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from emran_sumo.control.stanley import stanley

gains, offsets, angles, speeds = st.floats(0.1, 10), st.floats(-20, 20), st.floats(-3.1, 3.1), st.floats(0.2, 60)
quick = settings(deadline=None)  # the first call compiles


@quick
@given(gains, st.floats(0, 5), offsets, angles, speeds)
def test_angle_is_that_of_eq_22(gain, softening, offset, heading, speed):
    expected = heading + math.atan2(gain * offset, softening + speed)
    assert stanley(gain, softening, offset, heading, speed) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@quick
@given(gains, st.floats(1e-3, 20), speeds)
def test_car_steers_to_the_side_where_the_path_lies(gain, offset, speed):
    assert stanley(gain, 0.0, offset, 0.0, speed) > 0.0
    assert stanley(gain, 0.0, -offset, 0.0, speed) < 0.0
    assert stanley(gain, 0.0, 0.0, 0.1, speed) == 0.1


@quick
@given(gains, offsets, angles, speeds)
def test_law_is_mirror_symmetric(gain, offset, heading, speed):
    assert stanley(gain, 1.0, -offset, -heading, speed) == -stanley(gain, 1.0, offset, heading, speed)


@quick
@given(gains, st.floats(-1e9, 1e9), speeds)
def test_far_path_is_approached_at_no_more_than_a_right_angle(gain, offset, speed):
    assert abs(stanley(gain, 0.0, offset, 0.0, speed)) <= 0.5 * math.pi


@quick
@given(gains, st.floats(0.01, 20), st.floats(0.2, 30))
def test_same_offset_is_corrected_more_gently_at_higher_speed(gain, offset, speed):
    assert stanley(gain, 0.0, offset, 0.0, 2 * speed) < stanley(gain, 0.0, offset, 0.0, speed)


@pytest.mark.parametrize("speed", [0.0, -1.0, 0.05])
def test_standing_car_gets_a_finite_angle(speed):
    assert 0.0 < stanley(2.5, 0.0, 0.01, 0.0, speed) < 0.5 * math.pi


def kinematic_offset(gain, speed, offset, yaw, time):
    """Offset of the front axle of a kinematic car without steering limit; the front wheel rolls at `speed`."""
    y, wheelbase, dt = -offset, 2.68, 1e-3

    def rate(state):
        delta = stanley(gain, 0.0, -state[0], -state[1], speed)
        return speed * math.sin(state[1] + delta), speed * math.sin(delta) / wheelbase

    for _ in range(round(time / dt)):
        a = rate((y, yaw))
        b = rate((y + 0.5 * dt * a[0], yaw + 0.5 * dt * a[1]))
        y, yaw = y + dt * b[0], yaw + dt * b[1]
    return -y, yaw


@pytest.mark.parametrize("offset", [0.01, 3.0, -8.0])
@pytest.mark.parametrize("speed", [3.0, 12.0])
def test_kinematic_car_converges_as_the_closed_form_says(offset, speed):
    # de/dt = -k e / sqrt(1 + (k e / v)^2): w + log(u / (1 + w)) + k t is constant, u = k |e| / v, w = sqrt(1 + u^2)
    gain, time = 1.5, 2.0

    def charge(e):
        u = gain * abs(e) / speed
        w = math.sqrt(1 + u * u)
        return w + math.log(u / (1 + w))

    wanted = charge(offset) - gain * time
    expected = math.copysign(brentq(lambda e: charge(e) - wanted, 1e-9, abs(offset)), offset)
    found, _ = kinematic_offset(gain, speed, offset, 0.3, time)
    assert found == pytest.approx(expected, rel=1e-4)
    if abs(offset) < 0.1:
        assert found == pytest.approx(offset * math.exp(-gain * time), rel=1e-3)


def test_kinematic_car_ends_on_the_path():
    offset, yaw = kinematic_offset(2.5, 10.0, 5.0, -1.0, 12.0)
    assert (offset, yaw) == pytest.approx((0.0, 0.0), abs=1e-6)
