"""The reference follows SUMO's wish as a calm driver would, and brakes hard at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from emran_sumo.reference import HARD_BRAKING, HARDER, SOFTER, SpeedReference

STEP = 0.05


def driven(speed: float, accel: float, top: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Speeds and accelerations of a car that follows exactly what a driver of SUMO wishes who speeds up to the top."""
    reference = SpeedReference(speed, 0.0, STEP, 9.0)
    speeds, accels = [speed], [0.0]
    for _ in range(round(seconds / STEP)):
        present = speeds[-1]
        reference.toward(min(present + accel * STEP, top), present, top, np.inf)
        speeds.append(reference.speed)
        accels.append(reference.accel)
    return np.array(speeds), np.array(accels)


@given(
    speed=st.floats(5.0, 20.0), rise=st.floats(0.01, 15.0), accel=st.floats(0.5, 4.0),
)  # fmt: skip
def test_it_comes_to_the_allowed_speed_without_going_beyond_or_swinging(speed, rise, accel):
    top = speed + rise
    # the way to the top at the acceleration, and the jerk at both ends
    speeds, accels = driven(speed, accel, top, rise / accel + 2.0 * accel / SOFTER + 2.0)
    assert speeds.max() <= top + 1e-9
    assert speeds[-1] == pytest.approx(top, abs=1e-3)
    assert (np.diff(speeds) >= -1e-9).all()
    assert accels.max() <= accel + 1e-6
    assert np.diff(accels).max() <= SOFTER * STEP + 1e-6
    assert np.diff(accels).min() >= -HARDER * STEP - 1e-6


@given(speed=st.floats(10.0, 30.0), braking=st.floats(HARD_BRAKING + 0.1, 9.0))
def test_hard_braking_is_followed_at_once(speed, braking):
    reference = SpeedReference(speed, 1.0, STEP, 9.0)
    rise = reference.toward(speed - braking * STEP, speed, 40.0, np.inf)
    assert rise == pytest.approx(-braking * STEP)


@given(speed=st.floats(10.0, 30.0), braking=st.floats(0.5, HARD_BRAKING - 0.1))
def test_gentle_braking_comes_within_the_jerk_of_a_calm_driver(speed, braking):
    reference = SpeedReference(speed, 0.0, STEP, 9.0)
    rise = reference.toward(speed - braking * STEP, speed, 40.0, np.inf)
    assert rise == pytest.approx(-min(braking, HARDER * STEP) * STEP)


def test_no_more_is_braked_than_the_controller_may_ask_for():
    reference = SpeedReference(20.0, 0.0, STEP, 9.0)
    assert reference.toward(0.0, 20.0, 40.0, np.inf) == pytest.approx(-9.0 * STEP)
