import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from emran_sumo.plant.disturbance import DisturbanceParams, Environment, environment


def at(params, time=0.0, position=0.0, speed=0.0, friction=1.0, grade=0.0, slope=0.0):
    return environment(params, friction, grade, slope, time, position, speed)


HILLS = DisturbanceParams(grade_pulse=math.radians(40), grade_return=-math.radians(40))


@settings(deadline=None)  # the first call compiles
@given(st.floats(0, 1e4), st.floats(0, 1e5), st.floats(0, 40))
def test_nothing_disturbs_by_default(time, position, speed):
    assert at(DisturbanceParams(), time, position, speed) == Environment()


def test_road_is_passed_on():
    e = at(DisturbanceParams(), speed=20.0, friction=0.4, grade=0.05, slope=-0.001)
    assert e == Environment(friction=0.4, grade=0.05, pitch_rate=-0.02)


def test_grade_schedule_goes_up_flat_down_flat():
    for time, degrees in (
        (9.99, 0),
        (11.0, 40),
        (15, 40),
        (20, 40),
        (21, 0),
        (30, 0),
        (31, -40),
        (40, -40),
        (41, 0),
    ):
        assert at(HILLS, time).grade == pytest.approx(math.radians(degrees), abs=1e-12)
    assert at(HILLS, 10.5).grade == pytest.approx(math.radians(20))


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 50.0))
def test_pitch_rate_is_the_rate_of_the_grade(time):
    h = 1e-6
    difference = (at(HILLS, time + h).grade - at(HILLS, time - h).grade) / (2 * h)
    assert at(HILLS, time).pitch_rate == pytest.approx(difference, abs=1e-5)


def test_grade_without_transition_is_a_step_without_rate():
    params = HILLS._replace(grade_transition=0.0)
    assert at(params, 9.999).grade == 0.0
    assert at(params, 10.0) == Environment(grade=math.radians(40))
    assert at(params, 20.0).grade == 0.0


def test_friction_changes_in_the_patch_and_over_time():
    params = DisturbanceParams(patch_start=100.0, patch_end=120.0, patch_friction=0.3, friction_amplitude=0.5)
    assert at(params, position=99.9).friction == 1.0
    assert at(params, position=110.0).friction == pytest.approx(0.3)
    assert at(params, position=120.0).friction == 1.0
    assert at(params, time=math.pi / 2).friction == pytest.approx(1.5)
    assert at(params, time=3 * math.pi / 2, position=110.0, friction=0.8).friction == pytest.approx(0.8 * 0.5 * 0.3)


def test_sinusoids_of_the_published_robustness_case():
    params = DisturbanceParams(mass_amplitude=0.15, inertia_amplitude=0.2, friction_amplitude=0.5, wind_amplitude=15.0)
    quarter = at(params, time=math.pi / 2)
    assert quarter.mass_factor == pytest.approx(1.15)
    assert quarter.inertia_factor == pytest.approx(1.2)
    assert quarter.friction == pytest.approx(1.5)
    assert quarter.wind_long == pytest.approx(15.0)


def test_side_force_and_gust_add_and_only_the_gust_turns_the_car():
    params = DisturbanceParams(
        lateral_force=1500.0, lateral_force_start=1.0, gust_force=1000.0, gust_speed=25.0, gust_duration=3.0
    )
    assert at(params, 0.5) == Environment()
    assert at(params, 1.0) == Environment(force_lat=1500.0)
    assert at(params, 2.05) == pytest.approx(Environment(force_lat=2000.0, moment_yaw=0.705 * 500.0, wind_lat=12.5))
    assert at(params, 3.0) == pytest.approx(Environment(force_lat=2500.0, moment_yaw=705.0, wind_lat=25.0))
    assert at(params, 5.2) == Environment(force_lat=1500.0)


def test_parameters_and_actuators_change():
    params = DisturbanceParams(
        mass_factor=1.2,
        inertia_factor=0.8,
        stiffness_front=0.85,
        stiffness_rear=1.15,
        steer_effectiveness=0.6,
        steer_effectiveness_start=4.0,
        torque_effectiveness=0.5,
        torque_effectiveness_start=6.0,
    )
    expected = Environment(mass_factor=1.2, inertia_factor=0.8, stiffness_front_factor=0.85, stiffness_rear_factor=1.15)
    assert at(params, 3.9) == expected
    assert at(params, 5.0) == expected._replace(steer_effectiveness=0.6)
    assert at(params, 6.0) == expected._replace(steer_effectiveness=0.6, torque_effectiveness=0.5)


def test_parameters_are_a_checked_table():
    adapter = TypeAdapter(DisturbanceParams)
    params = adapter.validate_python({"grade_pulse": 0.1, "mass_factor": 1})
    assert params == DisturbanceParams(grade_pulse=0.1, mass_factor=1.0)
    assert all(type(value) is float for value in params)
    for wrong in ({"friction_amplitude": 1.0}, {"gradient": 0.1}, {"patch_friction": 0.0}):
        with pytest.raises(ValidationError):
            adapter.validate_python(wrong)
