import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emran_sumo.path import (
    LaneChange,
    Path,
    interpolate,
    lane_change_offset,
    mean_curvature,
    nearest,
    path_from_points,
    path_length,
    point_at,
    project,
    shifted,
    tracking_errors,
    wrap,
)

quick = settings(deadline=None)  # the first call compiles


@quick
@given(st.floats(-1e4, 1e4))
def test_wrapped_angle_is_the_same_direction_within_half_a_turn(angle):
    found = wrap(angle)
    assert -math.pi <= found <= math.pi
    assert math.cos(found) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(found) == pytest.approx(math.sin(angle), abs=1e-9)


def test_half_a_turn_wraps_to_its_negative():
    assert wrap(math.pi) == -math.pi
    assert wrap(-math.pi) == -math.pi


# ---------------------------------------------------------------- points on the grid and between


def test_length_is_that_of_the_grid(bench):
    assert path_length(bench.straight(100.0)) == pytest.approx(100.0)


def test_grid_points_are_passed_exactly(bench):
    path = bench.circle(30.0, 60.0)
    for i in (0, 1, 77, path.x.size - 2):
        p = point_at(path, i * path.spacing)
        assert (p.x, p.y, p.yaw) == pytest.approx((path.x[i], path.y[i], path.yaw[i]), abs=1e-12)


@pytest.mark.parametrize("radius", [10.0, -25.0, 400.0])
def test_points_between_lie_on_the_circle_to_micrometers(bench, radius):
    path = bench.circle(radius, 50.0)
    for position in np.linspace(0.0, 49.9, 333):
        p = point_at(path, position)
        exact = radius * math.sin(position / radius), radius * (1 - math.cos(position / radius))
        assert (p.x, p.y) == pytest.approx(exact, abs=1e-6)
        assert p.yaw == pytest.approx(position / radius, abs=1e-12)
        assert p.curvature == pytest.approx(1 / radius)


def test_interpolation_error_falls_with_the_fourth_power_of_the_spacing(bench):
    # Hermite: h^4 / 384 times the fourth derivative 1 / R^3
    def error(spacing):
        path = bench.circle(10.0, 20.0, spacing)
        middle = [point_at(path, (i + 0.5) * spacing) for i in range(path.x.size - 1)]
        return max(abs(math.hypot(p.x, p.y - 10.0) - 10.0) for p in middle)

    assert error(1.0) == pytest.approx(1 / 384 / 1000, rel=0.1)
    assert error(2.0) / error(1.0) == pytest.approx(16.0, rel=0.1)


def test_clothoid_has_the_yaw_of_its_curvature_integral():
    s = np.arange(0.0, 40.01, 0.5)
    zero = np.zeros_like(s)
    path = Path(s, zero, 0.0005 * s**2, 0.001 * s, zero, 0.5)
    for position in (3.14, 20.0, 39.9):
        assert point_at(path, position).yaw == pytest.approx(0.0005 * position**2, abs=1e-12)
        assert point_at(path, position).curvature == pytest.approx(0.001 * position, abs=1e-12)


def test_values_are_interpolated_linearly_and_held_at_the_ends(bench):
    path = bench.straight(10.0)
    values = 3.0 * path.x + 1.0
    assert interpolate(values, path, 4.321) == pytest.approx(3 * 4.321 + 1)
    assert interpolate(values, path, -5.0) == 1.0
    assert interpolate(values, path, 50.0) == pytest.approx(31.0, abs=1e-4)


def test_mean_curvature_averages_symmetrically(bench):
    path = bench.circle(50.0, 100.0)
    assert mean_curvature(path, 40.0, 3.0) == pytest.approx(0.02)
    ramp = path._replace(curvature=0.001 * np.arange(path.x.size) * path.spacing)
    assert mean_curvature(ramp, 40.0, 3.0) == pytest.approx(0.04)


# ---------------------------------------------------------------- nearest point and errors


@pytest.mark.parametrize("radius", [20.0, -20.0, 150.0])
@pytest.mark.parametrize("off", [-6.0, -0.3, 0.0, 0.01, 2.0, 6.0])
@pytest.mark.parametrize("miss", [-3.0, 0.0, 2.0])
def test_nearest_point_of_a_circle_has_the_angle_of_the_vehicle(bench, radius, off, miss):
    path, position = bench.circle(radius, 100.0), 40.0
    turn, away = position / radius, radius - off  # off to the left of the path, left is toward a left turn's center
    x, y = away * math.sin(turn), radius - away * math.cos(turn)
    p = nearest(path, x, y, position + miss)
    assert p.position == pytest.approx(position, abs=1e-5)
    cross_track, heading = tracking_errors(p, x, y, turn - 0.1)
    assert cross_track == pytest.approx(-off, abs=1e-6)
    assert heading == pytest.approx(0.1, abs=1e-6)


def test_nearest_point_has_converged_after_a_control_period(bench, double_lane_change):
    # hint: last position plus travelled distance, wrong by a few millimeters
    path = double_lane_change
    for position in np.arange(40.0, 120.0, 0.37):
        p = point_at(path, position)
        x, y = p.x - 0.1 * math.sin(p.yaw), p.y + 0.1 * math.cos(p.yaw)
        q = nearest(path, x, y, position + 0.005)
        along = (x - q.x) * math.cos(q.yaw) + (y - q.y) * math.sin(q.yaw)
        assert abs(along) < 1e-9


def test_position_is_held_at_the_ends_of_the_path(bench):
    path = bench.straight(100.0)
    assert nearest(path, -20.0, 1.0, 5.0).position == 0.0
    assert nearest(path, 130.0, 1.0, 95.0).position == pytest.approx(100.0)


def test_branch_near_the_hint_is_found_where_a_path_crosses_itself(bench):
    path = bench.circle(20.0, 2.5 * math.pi * 20.0)  # a lap and a quarter
    lap = 2 * math.pi * 20.0
    x, y = 20.0 * math.sin(0.5), 20.0 * (1 - math.cos(0.5))
    assert nearest(path, x, y, 11.0).position == pytest.approx(10.0, abs=1e-5)
    assert nearest(path, x, y, lap + 9.0).position == pytest.approx(lap + 10.0, abs=1e-5)


def test_path_to_the_left_is_a_positive_error_in_every_direction(bench):
    for yaw in np.linspace(-math.pi, math.pi, 9):
        s = np.arange(0.0, 50.1, 0.25)
        zero = np.zeros_like(s)
        path = Path(s * math.cos(yaw), s * math.sin(yaw), zero + yaw, zero, zero, 0.25)
        x, y = 20 * math.cos(yaw) + math.sin(yaw), 20 * math.sin(yaw) - math.cos(yaw)  # a meter to the right
        p = nearest(path, x, y, 18.0)
        assert tracking_errors(p, x, y, yaw) == pytest.approx((1.0, 0.0), abs=1e-9)
        assert tracking_errors(p, x, y, yaw + 2 * math.pi - 0.2)[1] == pytest.approx(0.2)


def test_projected_points_keep_position_offset_and_the_direction_of_the_path(bench):
    path = bench.circle(200.0, 400.0)
    rng = np.random.default_rng(0)
    position, offset = rng.uniform(60.0, 340.0, 50), rng.uniform(-8.0, 8.0, 50)
    x = (200.0 - offset) * np.sin(position / 200.0)
    y = 200.0 - (200.0 - offset) * np.cos(position / 200.0)
    found = project(path, x, y, 200.0, 160.0)
    np.testing.assert_allclose(found, np.column_stack((position, offset, position / 200.0)), atol=1e-5)


# ---------------------------------------------------------------- made paths


def test_path_through_points_of_a_circle_is_that_circle(bench):
    exact = bench.circle(80.0, 150.0, 0.5)
    path = path_from_points(exact.x, exact.y, 0.02)
    inside = slice(4, -4)
    np.testing.assert_allclose(path.yaw[inside], exact.yaw[inside], atol=1e-9)
    np.testing.assert_allclose(path.curvature[inside], 1 / 80.0, rtol=1e-5)
    assert path.spacing == pytest.approx(0.5, rel=1e-5)
    np.testing.assert_array_equal(path.grade, 0.02)


@pytest.mark.parametrize(("radius", "offset"), [(100.0, 3.5), (100.0, -3.5), (-60.0, 3.0), (40.0, 5.0)])
def test_shifted_circle_is_a_circle_of_the_shifted_radius(bench, radius, offset):
    base = bench.circle(radius, 120.0)
    flat = np.zeros_like(base.x)
    path = shifted(base, flat + offset, flat, flat)
    left = radius - offset
    np.testing.assert_allclose(np.hypot(path.x, path.y - radius), abs(left), rtol=1e-9)
    np.testing.assert_allclose(path.curvature, 1 / left, rtol=1e-9)
    assert path.spacing == base.spacing
    np.testing.assert_allclose(np.hypot(np.diff(path.x), np.diff(path.y)), path.spacing, rtol=1e-4)
    assert path_length(path) == pytest.approx(120.0 * left / radius, abs=path.spacing)


def test_unshifted_path_stays_the_same(bench):
    base = bench.circle(100.0, 50.0)
    flat = np.zeros_like(base.x)
    path = shifted(base, flat, flat, flat)
    for found, expected in zip(path[:5], base[:5], strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_yaw_and_curvature_of_a_shifted_bend_are_those_of_its_points():
    s = np.arange(0.0, 200.0, 0.05)
    curvature = 0.01 * np.sin(s / 20.0)
    yaw = 0.2 * (1 - np.cos(s / 20.0))
    steps = 0.5 * 0.05

    def integral(values):
        return np.concatenate(([0.0], np.cumsum((values[1:] + values[:-1]) * steps)))

    base = Path(integral(np.cos(yaw)), integral(np.sin(yaw)), yaw, curvature, 0 * s, 0.05)
    path = shifted(base, *lane_change_offset((LaneChange(3.5, 60.0, 40.0),), s))
    dx, dy = np.gradient(path.x, path.spacing), np.gradient(path.y, path.spacing)
    inside = slice(20, -20)
    np.testing.assert_allclose(np.arctan2(dy, dx)[inside], path.yaw[inside], atol=1e-5)
    np.testing.assert_allclose(np.gradient(path.yaw, path.spacing)[inside], path.curvature[inside], atol=1e-5)


def published(x):
    """Eq. 23 as printed: y_r and psi_r, and the curvature of that curve."""
    z1, z2 = 2.4 / 25 * (x - 27.19) - 1.2, 2.4 / 21.95 * (x - 56.46) - 1.2
    y = 4.05 / 2 * (1 + np.tanh(z1)) - 5.7 / 2 * (1 + np.tanh(z2))
    slope = 4.05 * np.cosh(z1) ** -2 * (1.2 / 25) - 5.7 * np.cosh(z2) ** -2 * (1.2 / 21.95)
    bend = np.gradient(slope, x)
    return y, np.arctan(slope), bend / (1 + slope**2) ** 1.5


def test_double_lane_change_is_that_of_eq_23(double_lane_change):
    path = double_lane_change
    y, yaw, curvature = published(path.x)
    np.testing.assert_allclose(path.y, y, atol=1e-8)
    np.testing.assert_allclose(path.yaw, yaw, atol=1e-8)
    np.testing.assert_allclose(path.curvature[2:-2], curvature[2:-2], atol=2e-6)
    np.testing.assert_allclose(np.hypot(np.diff(path.x), np.diff(path.y)), path.spacing, rtol=1e-6)


def test_double_lane_change_has_its_known_extremes(double_lane_change):
    path = double_lane_change
    assert (path.y.min(), path.y.max()) == pytest.approx((-1.65, 3.53), abs=0.005)
    assert np.degrees((path.yaw.min(), path.yaw.max())) == pytest.approx((-17.1, 10.8), abs=0.05)
    right, left = np.argmin(path.curvature), np.argmax(path.curvature)
    assert (path.curvature[right], path.curvature[left]) == pytest.approx((-0.0271, 0.0245), abs=5e-5)
    assert (path.x[right], path.x[left]) == pytest.approx((60.7, 73.8), abs=0.06)
    assert path.y[np.argmin(np.abs(path.x))] == pytest.approx(0.002, abs=5e-4)


@quick
@given(st.floats(-6, 6), st.floats(-50, 150), st.floats(5, 100))
def test_offset_of_a_lane_change_comes_with_its_derivatives(height, start, length):
    s, h = np.linspace(-100, 250, 200), 1e-3
    change = (LaneChange(height, start, length), LaneChange(-0.5 * height, start + 20, length))
    _, slope, bend = lane_change_offset(change, s)
    before, after = lane_change_offset(change, s - h), lane_change_offset(change, s + h)
    np.testing.assert_allclose(slope, (after[0] - before[0]) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(bend, (after[1] - before[1]) / (2 * h), atol=1e-5)
