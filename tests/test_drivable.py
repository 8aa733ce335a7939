"""Corners sharper than a car can steer: every path is one that it can drive, as near to its lanes as that allows."""

import math

import numpy as np
import pytest

from emran_sumo.path import path_length
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.world.drivable import drivable
from emran_sumo.world.lanes import (
    LANE_TOLERANCE,
    MOST,
    SPACING,
    TIGHTEST,
    blended,
    dense,
    joined,
    smooth_path,
    speed_cap,
    steered,
    way_in,
    with_begin,
)
from emran_sumo.world.records import Pose

CAR = VehicleParams()
# radius of the center of gravity with the wheels at their stop
TURNING_CIRCLE = math.hypot((CAR.front_axle + CAR.rear_axle) / math.tan(CAR.steer_limit), CAR.rear_axle)


def lanes(*turns: float, length: float = 50.0) -> list[np.ndarray]:
    """Straight lanes in a row with a corner of each of `turns` [rad] between them."""
    point, yaw, found = np.zeros(3), 0.0, []
    for turn in (*turns, 0.0):
        after = point + length * np.array([math.cos(yaw), math.sin(yaw), 0.0])
        found.append(np.vstack((point, after)))
        point, yaw = after, yaw + turn
    return found


def path_along(parts: list[np.ndarray]):
    return smooth_path(joined([dense(part) for part in parts]))


def check(path, begin: int = 0) -> None:
    """What holds for every path that is driven."""
    curvature = path.curvature[begin:]
    assert np.abs(curvature).max() <= MOST
    steps = np.hypot(np.diff(path.x), np.diff(path.y))[begin:]
    np.testing.assert_allclose(steps, path.spacing, atol=2e-3)
    assert np.abs(np.diff(path.yaw[begin:])).max() <= MOST * path.spacing + 0.01
    direction = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))[begin:]
    off = direction - 0.5 * (path.yaw[begin:-1] + path.yaw[begin + 1 :])
    assert np.abs(np.remainder(off + math.pi, 2.0 * math.pi) - math.pi).max() < 0.01
    cap = speed_cap(path, 3.0, 2.0)
    assert (cap[begin:] ** 2 * np.abs(curvature)).max() <= 3.0 + 1e-9


def distances(path, lane: np.ndarray) -> np.ndarray:
    return np.array([np.hypot(path.x - x, path.y - y).min() for x, y, _ in dense(lane)])


def test_the_limit_leaves_the_controller_some_steering():
    assert 1.0 / MOST > 1.05 * TURNING_CIRCLE


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("degrees", [50, 90, 115, 140])
def test_a_corner_is_widened_no_more_than_a_turn_needs(degrees, side):
    turn = side * math.radians(degrees)
    parts = lanes(turn)
    path = path_along(parts)
    check(path)
    assert path.yaw[-1] - path.yaw[0] == pytest.approx(turn, abs=0.1)
    # an arc of radius r inside a corner leaves it by r (1 / cos(turn / 2) - 1)
    sag = TIGHTEST * (1.0 / math.cos(0.5 * turn) - 1.0)
    for part in parts:
        assert distances(path, part).max() < max(1.05 * sag, 1.0)
        away = np.hypot(*(dense(part)[:, :2] - parts[0][1, :2]).T) > 35.0
        assert distances(path, part)[away][:-1].max() < LANE_TOLERANCE + 0.5 * SPACING


@pytest.mark.parametrize(
    "turns", [(1.8, -1.8), (1.5, 1.5), (2.2, -1.0, 2.0), (-2.4, 2.4, 2.4, -2.4), (1.0, 1.0, 1.0, 1.0, 1.0)]
)
@pytest.mark.parametrize("length", [20.0, 35.0])
def test_corners_in_a_row_are_drivable_and_nothing_is_left_out(turns, length):
    parts = lanes(*turns, length=length)
    parts = [np.array([[-60.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), *parts]
    path = path_along(parts)
    check(path)
    assert path.yaw[-1] - path.yaw[0] == pytest.approx(sum(turns), abs=0.1)
    assert path_length(path) > 0.6 * (60.0 + length * (len(turns) + 1))
    assert np.hypot(path.x[-1] - parts[-1][-1, 0], path.y[-1] - parts[-1][-1, 1]) < 1.0


@pytest.mark.parametrize("seed", range(6))
def test_the_kinks_of_imported_lanes_are_drivable(seed):
    """Lanes of 15 to 60 m with a kink of up to 100 degrees inside, and jumps of up to a lane's width between them."""
    random = np.random.default_rng(seed)
    point, yaw, parts = np.zeros(2), 0.0, []
    for _ in range(6):
        shape = [point]
        for _ in range(2):
            shape.append(shape[-1] + random.uniform(8.0, 30.0) * np.array([math.cos(yaw), math.sin(yaw)]))
            yaw += math.radians(random.uniform(-100.0, 100.0))
        parts.append(np.column_stack((shape, np.zeros(3))))
        jump = random.uniform(-3.2, 3.2) * np.array([-math.sin(yaw), math.cos(yaw)])
        point = shape[-1] + jump + 3.0 * np.array([math.cos(yaw), math.sin(yaw)])
    check(path_along(parts))


def test_a_path_that_bends_less_stays_as_it_is():
    path = path_along(lanes(0.3))
    assert drivable(path, MOST) is path


def test_a_lane_change_that_cannot_wait_is_one_that_the_car_can_steer(bench):
    here, beside = bench.straight(120.0), bench.straight(120.0)
    beside = beside._replace(y=beside.y + 3.2)
    sharp = blended(beside, here, 40.0, 40.0, 6.0)
    assert np.abs(sharp.curvature).max() > 1.5 * MOST
    path = steered(sharp, 40.0, 0.0, 0.0)
    begin = int(40.0 / SPACING)
    check(path, begin)
    assert np.hypot(path.x - 40.0, path.y).min() < 0.5 * SPACING + 1e-3
    np.testing.assert_allclose(path.y[path.x > 70.0], 3.2, atol=1e-3)


def test_who_stands_before_the_begin_of_its_lane_is_on_its_path(bench):
    lane = bench.straight(100.0)
    path = with_begin(lane, -1.9, 0.0)
    assert np.hypot(path.x + 1.9, path.y).min() < 0.5 * SPACING + 1e-9
    np.testing.assert_allclose(np.diff(path.x), SPACING)
    pose = Pose(-1.9, 0.0, 0.0, 20.0, 0.0)
    assert way_in(path, pose, 10.0) is path, "nothing leads it aside"
    assert with_begin(lane, 3.0, 0.0) is lane


@pytest.mark.parametrize("turn", [0.4, -0.6])
def test_who_stands_across_its_path_is_led_into_it(bench, turn):
    path = bench.straight(120.0)
    way = way_in(path, Pose(40.0, 0.0, turn, 3.0, 0.0), 40.0)
    k = int(np.argmin(np.hypot(way.x - 40.0, way.y)))
    assert way.yaw[k] == pytest.approx(turn, abs=0.06)
    check(way, k + 1)
    np.testing.assert_allclose(way.y[way.x > 75.0], 0.0, atol=1e-3)
