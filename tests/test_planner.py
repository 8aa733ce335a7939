"""Lane changes that SUMO wishes are begun with room, latched, ended, and given up when the gap closes."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from emran_sumo.ego import Ego as RealEgo
from emran_sumo.maneuver import DoubleLaneChange
from emran_sumo.path import Path, first_near
from emran_sumo.planner import AT_THE_END, OVER, SPARE, TIGHTEST, WAITING_TO_RETURN, DoubleLaneChanger, LaneFollower
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.scenario import RoadParams
from emran_sumo.world.records import Intent, Others

WIDTH = 3.2
FREE = Others(*(np.zeros(0) for _ in range(5)))


def lane(y: float) -> Path:
    x = np.arange(0.0, 1000.0, 0.25)
    zero = np.zeros_like(x)
    return Path(x, zero + y, zero, zero, zero, 0.25)


class Ego:
    """As much of an ego as a planner touches, at x = 100 m on the lane y = 0."""

    def __init__(self, speed: float) -> None:
        self.name, self.speed, self.time, self.lane_width = "ego", speed, 10.0, WIDTH
        self.base = self.path = lane(0.0)
        self.state = SimpleNamespace(position=100.0, vehicle=SimpleNamespace(x=100.0, y=0.0, yaw=0.0))
        self.vehicle = VehicleParams()
        self.scenario = SimpleNamespace(road=RoadParams())
        self.maneuver, self.said = "keep lane", []

    can_drive = RealEgo.can_drive

    def take_path(self, base: Path, path: Path, bends: bool = False) -> None:
        self.base, self.path, self.slows_for_it = base, path, bends

    def enter(self, name: str, text: str, level: str = "INFO") -> None:
        del level
        self.maneuver = name
        self.said.append(text)

    def say(self, _level: str, text: str) -> None:
        self.said.append(text)


class Lanes:
    """Lanes at y = 0 and to the left of it."""

    def __init__(self) -> None:
        self.left = lane(WIDTH)

    def lane_path(self, _ego: str, side: int) -> Path | None:
        return self.left if side > 0 else None

    def ask_for_room(self, ego: str, side: int) -> None:
        raise AssertionError

    def hold(self, ego: str, side: int) -> None:
        self.held = side

    def changed_lane(self, ego: str) -> None:
        self.changes = getattr(self, "changes", 0) + 1


def begun(speed: float, room: float = math.inf) -> tuple[Any, LaneFollower, Lanes]:
    ego, lanes = cast(Any, Ego(speed)), Lanes()
    follower = LaneFollower(True, lambda _: room)
    follower.plan(ego, Intent(speed, 1), FREE, lanes)
    return ego, follower, lanes


def reached(path: Path) -> float:
    """Where the path has arrived in the left lane, counted from x = 100 m."""
    return float(path.x[np.argmax(path.y > WIDTH - 0.01)]) - 100.0


@pytest.mark.parametrize("speed", [15.0, 30.0])
def test_a_change_takes_four_seconds_and_leaves_the_lane_without_a_kink(speed):
    ego, follower, _ = begun(speed)
    assert follower.count == 1
    assert 3.2 * speed < reached(ego.path) < 4.0 * speed
    assert np.abs(ego.path.curvature).max() * speed**2 < 2.0  # m/s2
    assert ego.path.y[400] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("speed", "room"), [(15.0, 50.0), (8.0, 25.0), (4.5, 12.0)])
def test_a_change_ends_before_the_lane_does(speed, room):
    ego, _, _ = begun(speed, room)
    assert reached(ego.path) <= max(room - SPARE, TIGHTEST)


def test_a_change_that_is_too_sharp_before_the_end_of_the_lane_is_mostly_done_there():
    ego, follower, lanes = begun(8.0, 14.0)
    assert follower.count == 1
    assert reached(ego.path) <= OVER * 14.0
    assert np.interp(114.0, ego.path.x, ego.path.y) > 0.85 * WIDTH
    assert ego.base is lanes.left


def test_a_change_that_cannot_be_driven_at_the_present_speed_waits_until_it_can():
    ego, follower, _ = begun(9.5, 12.0)
    assert (follower.count, ego.said) == (0, [])
    assert ego.path is ego.base
    ego.speed = 4.0
    follower.plan(ego, Intent(4.0, 1), FREE, cast(Any, Lanes()))
    assert follower.count == 1
    assert ego.slows_for_it, "it must not speed up within the bends of the change"


def test_who_can_no_longer_stop_before_the_end_of_the_lane_changes_it_at_once():
    assert begun(11.0, 12.0)[1].count == 1


def ring(radius: float) -> Path:
    """Counter-clockwise around (0, 100) from below."""
    s = np.arange(0.0, 1.9 * np.pi * radius, 0.25)
    yaw = s / radius
    zero = np.zeros_like(s)
    return Path(radius * np.sin(yaw), 100.0 - radius * np.cos(yaw), yaw, zero + 1.0 / radius, zero, 0.25)


def in_a_ring(speed: float, room: float) -> tuple[Any, LaneFollower]:
    """An ego a quarter around on the inner lane of a roundabout, radius 16 m, that has to leave it."""
    ego, lanes = cast(Any, Ego(speed)), cast(Any, Lanes())
    ego.base = ego.path = ring(16.0)
    ego.state.position = 25.0
    ego.state.vehicle = SimpleNamespace(**{k: float(getattr(ego.path, k)[100]) for k in ("x", "y", "yaw")})
    lanes.lane_path = lambda _ego, _side: ring(16.0 + WIDTH)
    follower = LaneFollower(True, lambda _: room)
    follower.plan(ego, Intent(speed, -1), FREE, lanes)
    return ego, follower


@pytest.mark.parametrize("room", [11.0, 14.0, 20.0, 40.0])
@pytest.mark.parametrize("speed", [2.0, 4.0, 6.0, 7.6])
def test_a_change_in_a_roundabout_is_begun_only_where_the_car_can_drive_it(speed, room):
    ego, follower = in_a_ring(speed, room)
    car, v = ego.state.vehicle, ego.vehicle
    begin = round(first_near(ego.path, car.x, car.y, car.yaw) / 0.25)
    curvature = ego.path.curvature[begin + 3 : begin + 160]
    if follower.count == 1:
        assert np.abs(curvature).max() < np.tan(v.steer_limit) / (v.front_axle + v.rear_axle)
        assert np.abs(curvature[0]) * speed**2 <= 1.5 * 3.0
        # what is ahead may be braked for, at 2 m/s2
        allowed = speed**2 - 2.0 * 2.0 * 0.25 * np.arange(curvature.size)
        assert (np.abs(curvature) * allowed).max() < 1.02 * 1.5 * 3.0
    elif room < 40.0:
        assert speed > 5.0, "a slow car can always change"
    else:
        raise AssertionError("there is room enough")


def test_a_path_that_begins_ahead_of_the_car_is_not_taken_as_its_further_way():
    ego, lanes = cast(Any, Ego(8.0)), cast(Any, Lanes())
    short = Path(*(values[:800] for values in ego.path[:5]), spacing=0.25)  # 100 m are left
    ego.base = ego.path = short
    lanes.lane_path = lambda _ego, _side: Path(*(v[416:] for v in lane(2.0)[:5]), spacing=0.25)  # from x = 104 m
    follower = LaneFollower(True, lambda _: math.inf)
    follower.plan(ego, Intent(8.0), FREE, lanes)
    assert ego.path is short
    lanes.lane_path = lambda _ego, _side: lane(0.0)
    follower.plan(ego, Intent(8.0), FREE, lanes)
    assert ego.path is not short


def test_in_a_queue_only_a_change_that_cannot_wait_begins():
    assert begun(0.0, AT_THE_END + 1.0)[1].count == 0
    assert begun(0.0, AT_THE_END - 1.0)[1].count == 1


def test_no_change_begins_where_there_is_no_lane_or_none_is_wanted():
    ego, lanes = cast(Any, Ego(20.0)), Lanes()
    for follower, side in ((LaneFollower(True, lambda _: 99.0), -1), (LaneFollower(False, lambda _: 99.0), 1)):
        follower.plan(ego, Intent(20.0, side), FREE, lanes)
        assert follower.count == 0


def test_a_change_is_latched_and_ends_after_its_way():
    ego, follower, lanes = begun(20.0)
    way = ego.path
    follower.plan(ego, Intent(20.0, 0), FREE, lanes)
    assert ego.path is way
    ego.state.position = 181.0
    follower.plan(ego, Intent(20.0, 0), FREE, lanes)
    assert ego.said[-1] == "lane change left done"
    assert cast(Any, lanes).changes == 1, "SUMO weighs its wishes anew"


def beside(speed: float, own_offset: float) -> Others:
    """Somebody 10 m behind the ego in the lane that it changes to."""
    one = np.ones(1)
    return Others(-10.0 * one, 0.0 * one, speed * one, 5.0 * one, 1.8 * one, own_offset)


def test_a_change_is_given_up_when_the_gap_closes_while_the_ego_is_in_its_own_lane():
    ego, follower, lanes = begun(20.0)
    follower.plan(ego, Intent(20.0), beside(20.0, -3.0), lanes)
    assert ego.base is lanes.left, "nobody comes closer"
    follower.plan(ego, Intent(20.0), beside(35.0, -1.0), lanes)
    assert ego.base is lanes.left, "too late: most of it is across"
    follower.plan(ego, Intent(20.0), beside(35.0, -3.0), lanes)
    assert "abandoned" in ego.said[-1]
    assert ego.base.y[0] == 0.0
    assert ego.path.y[-1] == pytest.approx(0.0, abs=1e-9)


# ---------------------------------------------------------------- declared double lane change


def out_and_there(beside: Others) -> tuple[Any, DoubleLaneChanger, Lanes]:
    """An ego in the lane on the left, where the way back begins, with `beside` around it."""
    ego, lanes = cast(Any, Ego(20.0)), Lanes()
    ego.position, ego.trace = 100.0, lambda: np.zeros((0, 60))
    handed = cast(Any, SimpleNamespace(lanes_left=1, lanes_right=0))
    changer = DoubleLaneChanger(DoubleLaneChange(50.0, 25.0, 21.95, 1), handed, "ego")
    changer.plan(ego, Intent(20.0), FREE, cast(Any, lanes))
    ego.state.position = 140.0  # the way back begins at 156.46 m
    changer.plan(ego, Intent(20.0), beside, cast(Any, lanes))
    return ego, changer, lanes


def offset_at(ego: Any, x: float) -> float:
    return float(ego.path.y[int(x / 0.25)])


IN_THE_WAY = Others(*(np.array([v]) for v in (3.0, 0.0, 18.0, 5.0, 1.8)), own_offset=WIDTH)
AWAY = IN_THE_WAY._replace(ahead=np.array([40.0]))


def test_way_back_of_a_double_lane_change_is_driven_where_the_own_lane_is_free():
    ego, _, lanes = out_and_there(AWAY)
    assert ego.maneuver == "change right"
    assert lanes.held == -1
    assert abs(offset_at(ego, 200.0)) < 0.02


def test_way_back_waits_beside_whoever_has_come_into_the_own_lane_and_is_driven_after_that():
    ego, changer, lanes = out_and_there(IN_THE_WAY)
    assert ego.maneuver == WAITING_TO_RETURN
    assert lanes.held == -1
    assert [offset_at(ego, x) for x in (200.0, 900.0)] == pytest.approx([WIDTH, WIDTH], abs=0.01)
    ego.state.position = 300.0
    changer.plan(ego, Intent(20.0), AWAY, cast(Any, lanes))
    assert ego.maneuver == "change right"
    assert offset_at(ego, 302.0) == pytest.approx(WIDTH, abs=0.05)
    assert abs(offset_at(ego, 360.0)) < 0.02
    ego.state.position = 360.0
    changer.plan(ego, Intent(20.0), AWAY._replace(own_offset=0.0), cast(Any, lanes))
    assert (ego.maneuver, lanes.held) == ("keep lane", 0)


def test_a_wish_that_somebody_blocks_is_told_once_it_lasts_and_again_after_a_while():
    ego, lanes = cast(Any, Ego(20.0)), Lanes()
    follower = LaneFollower(True, lambda _: math.inf)
    told = []
    for k in range(300):  # 15 s; the wish is away for a moment at 0.5 s
        ego.time = 10.0 + 0.05 * k
        follower.plan(ego, Intent(20.0, blocked=0 if k == 10 else -1), FREE, cast(Any, lanes))
        told += [ego.time] * (len(ego.said) - len(told))
    assert ego.said == ["lane change right wished, but somebody is in the way"] * 2
    assert told[0] == pytest.approx(10.0 + 0.55 + 1.05, abs=0.051)
    assert told[1] - told[0] == pytest.approx(10.0, abs=0.1)


def test_who_never_changes_the_lane_is_told_of_no_wish():
    ego, follower = cast(Any, Ego(20.0)), LaneFollower(False, lambda _: math.inf)
    for k in range(100):
        ego.time = 10.0 + 0.05 * k
        follower.plan(ego, Intent(20.0, blocked=1), FREE, cast(Any, Lanes()))
    assert not ego.said
