import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emran_sumo.plant.tire import TireParams, slip_angle_for_force, tire_forces

C_KAPPA = 194_000.0
C_ALPHA = 135_000.0
LOAD = 8_830.0

kappas = st.floats(-0.99, 0.99)
tans = st.floats(-5.0, 5.0)
loads = st.floats(500.0, 15_000.0)
frictions = st.floats(0.05, 1.3)


def forces(kappa, tan_alpha, load=LOAD, friction=1.0, gain=1.05, decay=0.4, c_kappa=C_KAPPA, c_alpha=C_ALPHA):
    return tire_forces(c_kappa, c_alpha, gain, decay, kappa, tan_alpha, load, friction)


def brush_force(stiffness, slip, load, friction, cells=200_000):
    """Force of a brush on an elliptical pressure, summed bristle by bristle.

    The deflection grows from the leading edge and is cut off at what friction allows there.
    """
    total = 0.0
    width = 2.0 / cells
    for i in range(cells):
        xi = 1.0 - (i + 0.5) * width  # leading edge first, half contact length 1
        adhesion = 0.5 * stiffness * slip * (1.0 - xi)  # integral over the contact is stiffness * slip
        total += min(adhesion, friction * 2.0 * load / math.pi * math.sqrt(1.0 - xi * xi)) * width
    return total


def test_slope_at_zero_slip_is_the_stiffness():
    h = 1e-6
    assert forces(h, 0.0)[0] / h == pytest.approx(C_KAPPA, rel=1e-4)
    assert forces(0.0, h)[1] / h == pytest.approx(-C_ALPHA, rel=1e-4)
    # below the threshold of the linear law, too
    assert forces(1e-16, 0.0)[0] / 1e-16 == pytest.approx(C_KAPPA, rel=1e-12)


def test_no_slip_no_force_and_no_load_no_force():
    assert forces(0.0, 0.0) == (0.0, 0.0)
    assert forces(0.1, 0.1, load=0.0) == (0.0, 0.0)
    assert forces(0.1, 0.1, friction=0.0) == (0.0, 0.0)


@pytest.mark.parametrize("tan_alpha", [0.005, 0.03, 0.07, 0.2])
def test_force_equals_that_of_a_brush_on_an_elliptical_pressure(tan_alpha):
    expected = brush_force(C_ALPHA, tan_alpha, LOAD, 0.9)
    assert -forces(0.0, tan_alpha, friction=0.9, gain=1.0, decay=0.0)[1] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("demand", [0.3, 1.0, 2.0, 6.0])
def test_sliding_share_equals_salaanis_own_form(demand):
    # f_s alone shows in the difference of two sliding frictions
    tan_alpha = demand * LOAD / C_ALPHA
    s = math.pi / 4 * demand
    u = (1 - s * s) / (1 + s * s)
    f_s = (math.pi / 2 - u * math.sqrt(1 - u * u) - math.asin(u)) / math.pi
    high = -forces(0.0, tan_alpha, gain=1.2, decay=0.0)[1]
    low = -forces(0.0, tan_alpha, gain=1.0, decay=0.0)[1]
    assert (high - low) / (0.2 * LOAD) == pytest.approx(f_s, rel=1e-9)


@pytest.mark.parametrize(("kappa", "degrees"), [(0.05, 2.0), (-0.3, 8.0), (0.8, -20.0), (-0.02, 25.0)])
def test_combined_force_is_that_of_equation_8(kappa, degrees):
    alpha = math.radians(degrees)
    slip = min(1.0, math.hypot(math.sin(alpha), kappa * math.cos(alpha)))
    mu, mu_s = 0.9, 0.9 * 1.05 * (1 - 0.4 * slip)
    c_s = C_KAPPA + (C_ALPHA - C_KAPPA) * slip
    d_a = math.hypot(C_KAPPA * kappa, C_ALPHA * math.tan(alpha)) / mu
    d_s = math.hypot(c_s * kappa, C_ALPHA * math.tan(alpha)) / mu_s
    s = math.pi / 4 * d_a / LOAD
    u = (1 - s * s) / (1 + s * s)
    f_a = 4 / math.pi * s / (1 + s * s) ** 2
    f_s = (math.pi / 2 - u * math.sqrt(1 - u * u) - math.asin(u)) / math.pi
    fx, fy = forces(kappa, math.tan(alpha), friction=mu)
    assert fx == pytest.approx(LOAD * kappa * (C_KAPPA * f_a / d_a + c_s * f_s / d_s), rel=1e-9)
    assert fy == pytest.approx(-LOAD * C_ALPHA * math.tan(alpha) * (f_a / d_a + f_s / d_s), rel=1e-9)


@settings(deadline=None)  # the first call compiles
@given(kappas, tans, loads, frictions)
def test_force_stays_inside_the_friction_circle_and_opposes_the_slip(kappa, tan_alpha, load, friction):
    fx, fy = forces(kappa, tan_alpha, load, friction)
    assert math.hypot(fx, fy) <= 1.05 * friction * load * (1 + 1e-12)
    assert fx * kappa >= 0.0
    assert fy * tan_alpha <= 0.0
    alike = forces(kappa, tan_alpha, load, friction, gain=1.0, decay=0.0)
    assert math.hypot(*alike) <= friction * load * (1 + 1e-12)


@settings(deadline=None)  # the first call compiles
@given(kappas, tans, loads, frictions)
def test_force_is_odd_in_each_slip_exactly(kappa, tan_alpha, load, friction):
    fx, fy = forces(kappa, tan_alpha, load, friction)
    assert forces(-kappa, tan_alpha, load, friction) == (-fx, fy)
    assert forces(kappa, -tan_alpha, load, friction) == (fx, -fy)


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), loads, frictions)
def test_pure_side_force_grows_with_slip_when_sliding_costs_nothing(a, b, load, friction):
    low, high = sorted((a, b))
    small = -forces(0.0, low, load, friction, gain=1.0, decay=0.0)[1]
    large = -forces(0.0, high, load, friction, gain=1.0, decay=0.0)[1]
    assert small <= large + 1e-9 * load


@settings(deadline=None)  # the first call compiles
@given(st.floats(0.02, 0.2), st.floats(0.0, 0.4), st.floats(0.05, 0.4))
def test_braking_costs_side_force(tan_alpha, kappa, more):
    less_braked = abs(forces(-kappa, tan_alpha)[1])
    assert abs(forces(-kappa - more, tan_alpha)[1]) < less_braked


def test_slip_ratio_is_clamped_before_the_wheel_stands():
    assert forces(5.0, 0.1) == forces(0.99, 0.1)
    assert forces(-5.0, 0.1) == forces(-0.99, 0.1)


def test_default_peak_is_near_the_friction_and_falls_when_sliding():
    tire = TireParams()
    side = [-forces(0.0, math.tan(math.radians(a)), c_alpha=135_000.0)[1] / LOAD for a in range(1, 60)]
    assert max(side) == pytest.approx(0.946, abs=0.002)  # analysis of the elliptical tire: 0.946 at 10.8 degrees
    assert side.index(max(side)) + 1 == 11
    assert side[33] == pytest.approx(0.813, abs=0.002)
    along = [forces(k / 1000, 0.0, c_kappa=tire.slip_stiffness * LOAD)[0] / LOAD for k in range(1, 990)]
    assert max(along) == pytest.approx(0.967, abs=0.002)
    assert along.index(max(along)) + 1 == pytest.approx(146, abs=4)


@settings(deadline=None)  # the first call compiles
@given(st.floats(-7_000.0, 7_000.0))
def test_slip_angle_for_force_inverts_the_tire(force):
    alpha = slip_angle_for_force(force, LOAD, C_ALPHA, 1.05, 0.4, 1.0, 0.14)
    assert -forces(0.0, math.tan(alpha))[1] == pytest.approx(force, abs=1e-4)
    assert slip_angle_for_force(-force, LOAD, C_ALPHA, 1.05, 0.4, 1.0, 0.14) == -alpha


def test_slip_angle_for_an_impossible_force_is_the_limit():
    assert slip_angle_for_force(2 * LOAD, LOAD, C_ALPHA, 1.05, 0.4, 1.0, 0.14) == 0.14
    assert slip_angle_for_force(-2 * LOAD, LOAD, C_ALPHA, 1.05, 0.4, 1.0, 0.14) == -0.14
    assert slip_angle_for_force(0.0, LOAD, C_ALPHA, 1.05, 0.4, 1.0, 0.14) == 0.0
