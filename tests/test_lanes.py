"""Lane polylines become paths that keep their shape and can be driven."""

import math

import numpy as np
import pytest

from emran_sumo.path import nearest, path_length, point_at
from emran_sumo.world.lanes import LANE_TOLERANCE, SPACING, blended, joined, reached, smooth_path, speed_cap

BORDER = 60.0  # m at either end, where half of the neighbors that smooth a point are missing


def curve(curvature, length: float, step: float = 0.05) -> np.ndarray:
    """(n, 3): position, x, y of the curve with that curvature, integrated far finer than it is sampled."""
    s = np.arange(0.0, length + 0.5 * step, step)
    middle = s[:-1] + 0.5 * step
    yaw = np.concatenate(([0.0], np.cumsum(curvature(middle) * step)))
    half = yaw[:-1] + 0.5 * step * curvature(middle)
    x = np.concatenate(([0.0], np.cumsum(np.cos(half) * step)))
    y = np.concatenate(([0.0], np.cumsum(np.sin(half) * step)))
    return np.column_stack((s, x, y))


def polyline(fine: np.ndarray, every: float) -> np.ndarray:
    """What netconvert makes of a curve: points some meters apart, rounded to centimeters; (n, 4) with tolerance."""
    stride = round(every / (fine[1, 0] - fine[0, 0]))
    points = np.round(fine[::stride, 1:], 2)
    return joined([np.column_stack((points, np.zeros(len(points))))])


def circle(s):
    return np.full_like(s, 1.0 / 600.0)


def clothoid(s):
    """A motorway curve: straight, clothoid of 200 m, R = 800 m, clothoid, straight."""
    return np.clip(np.minimum(s - 300.0, 1100.0 - s) / 200.0, 0.0, 1.0) / 800.0


def nearest_distance(path, fine: np.ndarray) -> np.ndarray:
    inside = (fine[:, 0] > BORDER) & (fine[:, 0] < fine[-1, 0] - BORDER)
    points = fine[inside][::20, 1:]
    xy = np.column_stack((path.x, path.y))
    result = []
    for p in points:
        k = np.clip(np.argmin(((xy - p) ** 2).sum(1)), 1, len(xy) - 2)
        result.append(abs(-np.sin(path.yaw[k]) * (p[0] - xy[k, 0]) + np.cos(path.yaw[k]) * (p[1] - xy[k, 1])))
    return np.array(result)


@pytest.mark.parametrize("every", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("shape", [circle, clothoid])
def test_a_curve_keeps_its_place_and_its_curvature(shape, every):
    fine = curve(shape, 1400.0)
    path = smooth_path(polyline(fine, every))
    # a chord between points `every` apart lies up to every^2 / 8 R beside the arc: the polyline's own error
    sag = every**2 / 8.0 * shape(fine[:, 0]).max()
    assert nearest_distance(path, fine).max() < 0.05 + sag
    s = np.arange(path.x.size) * SPACING
    inside = (s > BORDER) & (s < s[-1] - BORDER)
    largest = shape(s).max()
    assert np.abs(path.curvature - shape(s))[inside].max() < 0.07 * largest
    assert np.sqrt(np.mean((path.curvature - shape(s))[inside] ** 2)) < 0.03 * largest


def test_the_corners_of_the_polyline_are_gone():
    path = smooth_path(polyline(curve(circle, 1000.0), 20.0))
    jump = np.abs(np.diff(path.curvature)).max() / SPACING
    # the polyline has all its bend in corners: 20 m / R within nothing
    assert jump < 0.2 / 600.0  # per meter: no more than a fifth of the curvature
    assert np.abs(path.curvature).max() < 1.2 / 600.0


def test_positions_are_arc_lengths_and_yaw_is_their_direction():
    path = smooth_path(polyline(curve(clothoid, 1400.0), 10.0))
    steps = np.hypot(np.diff(path.x), np.diff(path.y))
    assert path.spacing == SPACING
    np.testing.assert_allclose(steps, SPACING, atol=1e-5)
    direction = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
    np.testing.assert_allclose(direction, 0.5 * (path.yaw[1:] + path.yaw[:-1]), atol=1e-5)
    np.testing.assert_allclose(np.gradient(path.yaw, SPACING)[2:-2], path.curvature[2:-2], atol=1e-5)
    assert path_length(path) == pytest.approx(1400.0, abs=0.5)


def test_yaw_is_continuous_where_the_compass_wraps():
    fine = curve(lambda s: np.full_like(s, 1.0 / 100.0), 700.0)  # more than one full turn
    path = smooth_path(polyline(fine, 5.0))
    assert np.abs(np.diff(path.yaw)).max() < 0.01
    assert path.yaw[-1] - path.yaw[0] == pytest.approx(7.0, abs=0.05)


def test_a_climb_is_a_grade():
    x = np.arange(0.0, 501.0, 10.0)
    path = smooth_path(joined([np.column_stack((x, np.zeros_like(x), 0.04 * x))]))
    np.testing.assert_allclose(path.grade, np.arctan(0.04), atol=1e-6)
    np.testing.assert_allclose(path.y, 0.0, atol=1e-9)


def test_a_straight_of_two_points_is_a_path():
    path = smooth_path(joined([np.array([[0.0, 0.0, 0.0], [30.0, 40.0, 0.0]])]))
    assert path_length(path) == pytest.approx(50.0, abs=SPACING)
    np.testing.assert_allclose(path.yaw, np.arctan2(40.0, 30.0), atol=1e-9)
    np.testing.assert_allclose(path.curvature, 0.0, atol=1e-9)


def test_a_bend_tighter_than_smoothing_likes_stays_within_the_tolerance():
    angle = np.linspace(0.0, 0.5 * np.pi, 40)
    bend = np.column_stack((100.0 + 30.0 * np.sin(angle), 30.0 * (1.0 - np.cos(angle)), np.zeros(40)))
    points = joined([np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]]), bend, np.array([[130.0, 130.0, 0.0]])], [0.2] * 3)
    path = smooth_path(points)
    inner = (path.x > 100.0) & (path.y < 30.0)  # the quarter circle around (100, 30)
    off = np.hypot(path.x[inner] - 100.0, path.y[inner] - 30.0) - 30.0
    assert np.abs(off).max() < 0.25
    assert path.curvature[inner].max() < 1.5 / 30.0


def test_joined_lanes_have_no_point_twice():
    a = np.array([[0.0, 0.0, 1.0], [10.0, 0.0, 1.0]])
    b = np.array([[10.0, 0.0, 1.0], [10.0, 0.005, 1.0], [10.1, 0.0, 1.0], [20.0, 0.0, 2.0]])
    points = joined([a, b], [0.1, 0.5])
    np.testing.assert_array_equal(points, [[0, 0, 1, 0.1], [10, 0, 1, 0.1], [10.1, 0, 1, 0.5], [20, 0, 2, 0.5]])


def test_joined_lanes_keep_a_lone_lane_as_it_is():
    a = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0]])
    np.testing.assert_array_equal(joined([a]), np.column_stack((a, [LANE_TOLERANCE] * 2)))


def test_the_speed_cap_keeps_the_lateral_acceleration_and_can_be_braked_down_to():
    path = smooth_path(polyline(curve(lambda s: np.where(s < 500.0, 0.0, 1.0 / 50.0), 700.0), 2.0))
    cap = speed_cap(path, 2.0, 1.5)
    assert (cap**2 * np.abs(path.curvature)).max() <= 2.0 + 1e-9
    braking = -np.diff(cap**2) / (2.0 * SPACING)
    assert braking.max() <= 1.5 + 1e-6
    middle = round(600.0 / SPACING)
    assert cap[middle] == pytest.approx(np.sqrt(2.0 * 50.0), rel=0.05)
    far = round(300.0 / SPACING)  # 200 m before the bend
    assert cap[far] == pytest.approx(np.sqrt(100.0 + 2.0 * 1.5 * 200.0), rel=0.05)


def test_a_blended_path_leaves_the_old_one_smoothly_and_ends_on_the_target():
    old = smooth_path(polyline(curve(circle, 1000.0), 10.0))
    x = np.arange(0.0, 1001.0, 10.0)
    target = smooth_path(joined([np.column_stack((x, np.full_like(x, 3.2), np.zeros_like(x)))]))
    path = blended(target, old, 30.0, 30.0, 80.0)
    here = point_at(old, 30.0)
    k = np.argmin((path.x - here.x) ** 2 + (path.y - here.y) ** 2)
    assert np.hypot(path.x[k] - here.x, path.y[k] - here.y) < SPACING
    assert path.yaw[k] == pytest.approx(here.yaw, abs=2e-3)
    assert path.curvature[k] == pytest.approx(here.curvature, abs=1e-3)
    after = path.x > 115.0
    np.testing.assert_allclose(path.y[after], 3.2, atol=1e-6)
    np.testing.assert_allclose(path.yaw[after], 0.0, atol=1e-6)


@pytest.mark.parametrize(("aside", "turn"), [(1.7, 0.0), (-1.7, 0.1), (0.4, -0.1)])
def test_who_stands_beside_a_path_is_led_to_it_from_where_it_is_without_a_kink(bench, aside, turn):
    path = bench.circle(300.0, 400.0)
    there = point_at(path, 100.0)
    x, y = there.x - aside * math.sin(there.yaw), there.y + aside * math.cos(there.yaw)
    way = reached(path, x, y, there.yaw + turn, 100.0, 60.0)
    begin = nearest(way, x, y, 100.0)
    assert math.hypot(begin.x - x, begin.y - y) < 0.01
    assert begin.yaw == pytest.approx(there.yaw + turn, abs=0.01)
    k = int(170.0 / path.spacing)
    end = nearest(path, way.x[k], way.y[k], 170.0)
    assert math.hypot(end.x - way.x[k], end.y - way.y[k]) < 0.002
    driven = way.curvature[int(begin.position / path.spacing) + 1 : k]  # behind its begin nobody drives
    assert np.abs(np.diff(driven)).max() < 0.002  # 1/m in 0.25 m
