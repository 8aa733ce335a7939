"""SUMO and the ego are one world: the ego drives as SUMO wants, others react to it, and nobody is harmed by it."""

import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import libsumo
import numpy as np
import pytest

from emran_sumo import drive, opening, scenario
from emran_sumo.errors import UserError
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.world.phantom import PREFIX as PHANTOM
from emran_sumo.world.records import Pose
from emran_sumo.world.session import scenario_options
from emran_sumo.world.sumo import SumoWorld

LINE = Path(__file__).parent / "data" / "line.net.xml"  # 1 km at 30 m/s, then 1 km at 15 m/s, three lanes of 3.2 m
STEP = 0.05
FRONT = 2.2  # m from the center of gravity to the front bumper
WIDTH = 1.8
MAKE = """\
<routes>
    <vType id="plain" length="5" minGap="2.5" accel="2.6" decel="4.5" tau="1.0" sigma="0" speedFactor="1" speedDev="0"
           lcSpeedGain="0" lcKeepRight="0" lcCooperative="0"/>
    <vType id="slow" length="5" minGap="2.5" maxSpeed="12" sigma="0" speedFactor="1" speedDev="0"
           lcSpeedGain="0" lcKeepRight="0" lcCooperative="0"/>
    <route id="all" edges="fast slow"/>
    {vehicles}
</routes>
"""


class Seen(NamedTuple):
    """One vehicle at the end of one step: front bumper [m], speed [m/s], acceleration [m/s2]."""

    time: float
    position: float
    speed: float
    accel: float


def vehicle(name: str, position: float, speed: float, kind: str = "plain", lane: int = 1, inside: str = "") -> str:
    place = f'departLane="{lane}" departPos="{position}" departSpeed="{speed}"'
    return f'<vehicle id="{name}" type="{kind}" route="all" depart="0" {place}>{inside}</vehicle>'


@pytest.fixture
def world(tmp_path) -> Iterator[Callable[..., SumoWorld]]:
    """Opens worlds on the straight road with the given vehicles and closes them."""
    opened: list[SumoWorld] = []

    def open_world(*vehicles: str, seed: int = 1) -> SumoWorld:
        file = tmp_path / f"cars{len(opened)}.rou.xml"
        file.write_text(MAKE.format(vehicles="\n    ".join(vehicles)), encoding="utf-8")
        opened.append(SumoWorld(scenario_options(LINE, [file], [], 0.0), STEP, seed))
        return opened[-1]

    yield open_world
    for one in opened:
        one.close()


def look(name: str) -> Seen:
    v = libsumo.vehicle
    return Seen(libsumo.simulation.getTime(), v.getPosition(name)[0], v.getSpeed(name), v.getAcceleration(name))


def native(open_world: SumoWorld, names: tuple[str, ...], seconds: float) -> dict[str, np.ndarray]:
    """What SUMO's own driver does in its lane: rows of Seen by vehicle, from the first step's end on."""
    rows: dict[str, list[Seen]] = {name: [] for name in names}
    for _ in open_world.warm_up(seconds):
        libsumo.vehicle.setLaneChangeMode("ego", 0)  # it would drive around a vehicle that stops
        for name in names:
            rows[name].append(look(name))
    open_world.close()
    return {name: np.array(row) for name, row in rows.items()}


def mirrored(open_world: SumoWorld, names: tuple[str, ...], seconds: float) -> dict[str, np.ndarray]:
    """The same with "ego" driven from outside by a car that does exactly what SUMO wants."""
    rows: dict[str, list[Seen]] = {name: [] for name in names}
    for _ in open_world.warm_up(STEP):  # the ego departs
        for name in names:
            rows[name].append(look(name))
    pose = open_world.take_over("ego", FRONT, WIDTH).pose
    for _ in range(round(seconds / STEP) - 1):
        wanted = open_world.propose({"ego": pose})["ego"].speed
        x = pose.x + 0.5 * (pose.speed + wanted) * STEP
        pose = Pose(x, pose.y, pose.yaw, wanted, (wanted - pose.speed) / STEP)
        open_world.commit({"ego": pose})
        assert open_world.mirror_error("ego", pose) < 1e-6
        for name in names:
            rows[name].append(look(name))
    open_world.close()
    return {name: np.array(row) for name, row in rows.items()}


STOP = '<stop lane="fast_1" endPos="600" duration="5"/>'
LONG_STOP = STOP.replace('"5"', '"20"')
SITUATIONS = {
    "free road": ((vehicle("ego", 50, 20),), 20.0),
    "a lower limit ahead": ((vehicle("ego", 700, 29),), 30.0),
    "a slower leader": ((vehicle("ego", 50, 25), vehicle("other", 200, 12, "slow")), 40.0),
    "a stop": ((vehicle("ego", 200, 20, inside=STOP),), 45.0),
    "a leader that stops": ((vehicle("ego", 200, 20), vehicle("other", 260, 20, inside=LONG_STOP)), 60.0),
    "a follower behind a stop": ((vehicle("ego", 200, 20, inside=STOP), vehicle("other", 160, 22)), 45.0),
}


@pytest.mark.parametrize("situation", SITUATIONS)
def test_the_ego_and_the_others_do_what_they_do_when_sumo_drives(world, situation):
    vehicles, seconds = SITUATIONS[situation]
    names = ("ego", "other") if len(vehicles) > 1 else ("ego",)
    own = native(world(*vehicles), names, seconds)
    ours = mirrored(world(*vehicles), names, seconds)
    for name in names:
        assert ours[name].shape == own[name].shape
        # the predicted pose of the proposal assumes constant speed: half a step's worth of acceleration, not more
        np.testing.assert_allclose(ours[name][:, 2], own[name][:, 2], atol=0.35, err_msg=f"speed of {name}")
        np.testing.assert_allclose(ours[name][:, 1], own[name][:, 1], atol=0.5, err_msg=f"position of {name}")


def test_the_ego_keeps_the_limit_of_the_next_edge_when_it_gets_there(world):
    rows = mirrored(world(vehicle("ego", 700, 29)), ("ego",), 25.0)["ego"]
    there = rows[:, 1] > 1000.0
    assert there.any()
    assert rows[there, 2].max() < 15.05
    assert rows[rows[:, 1] < 850.0, 2].min() > 28.9, "and does not brake long before"


def test_the_ego_stands_a_gap_behind_a_standing_leader_and_goes_on(world):
    vehicles = (vehicle("ego", 200, 20), vehicle("other", 260, 20, inside=LONG_STOP))
    rows = mirrored(world(*vehicles), ("ego", "other"), 60.0)
    standing = (rows["ego"][:, 2] < 0.01) & (rows["other"][:, 2] < 0.01)
    assert standing.sum() * STEP > 15.0
    gap = (rows["other"][:, 1] - 5.0 - rows["ego"][:, 1])[standing]
    np.testing.assert_allclose(gap, 2.5, atol=0.1)  # minGap
    assert rows["ego"][-1, 2] > 5.0


def test_the_ego_stops_where_its_stop_is(world):
    rows = mirrored(world(vehicle("ego", 200, 20, inside=STOP)), ("ego",), 40.0)["ego"]
    standing = rows[rows[:, 2] < 0.01]
    assert 5.0 - 2 * STEP <= len(standing) * STEP <= 6.0
    np.testing.assert_allclose(standing[:, 1], 600.0, atol=0.3)
    assert rows[-1, 2] > 10.0


def test_others_are_told_the_true_speed_although_it_is_beyond_the_limit(world):
    w = world(vehicle("ego", 50, 20), vehicle("other", 20, 20))
    list(w.warm_up(STEP))
    pose = w.take_over("ego", FRONT, WIDTH).pose._replace(speed=38.0, accel=-6.0)
    for _ in range(40):
        w.propose({"ego": pose})
        pose = pose._replace(x=pose.x + pose.speed * STEP)
        w.commit({"ego": pose})
        assert libsumo.vehicle.getSpeed("ego") == pytest.approx(38.0, abs=1e-9)
        assert libsumo.vehicle.getAcceleration("ego") == pytest.approx(-6.0, abs=1e-9)


class Change(NamedTuple):
    """One step of a lane change: reach of the body over the middle line [m] from the left and right, leaders."""

    left: float
    right: float
    leader_left: str
    leader_right: str
    phantom: bool


def change_lanes(w: SumoWorld, others: int) -> list[Change]:
    """Slowly from lane 1 to lane 2 and back, one follower in each; checks what must hold in every step."""
    for _ in w.warm_up(1.0):
        pass
    pose = start = w.take_over("ego", FRONT, WIDTH).pose
    border = start.y + 1.6
    steps = []
    for k in range(500):
        share = 0.5 - 0.5 * math.cos(2.0 * math.pi * k / 500)
        w.propose({"ego": pose})
        pose = pose._replace(x=pose.x + pose.speed * STEP, y=start.y + 3.2 * share)
        w.commit({"ego": pose})
        assert w.mirror_error("ego", pose) < 1e-6
        ids = w.neighbors("ego").ids
        assert sorted(ids) == sorted(f"follower{i}" for i in range(others))
        assert w.vehicle_count() == others + 1
        assert w.collisions() == []
        leaders = [(libsumo.vehicle.getLeader(f"follower{i}", 150.0) or ("", 0.0))[0] for i in (1, 0)]
        there = any(name.startswith(PHANTOM) for name in libsumo.vehicle.getIDList())
        reach = 0.5 * WIDTH
        steps.append(Change(pose.y + reach - border, border - (pose.y - reach), leaders[0], leaders[1], there))
    assert not any(name.startswith(PHANTOM) for name in libsumo.vehicle.getIDList()), "and is gone in the end"
    return steps


def test_followers_in_both_lanes_have_the_ego_before_them_while_it_is_in_both(world):
    followers = (vehicle("follower0", 100, 12, "slow", 1), vehicle("follower1", 100, 12, "slow", 2))
    steps = change_lanes(world(vehicle("ego", 150, 12), *followers), 2)
    body = ("ego", PHANTOM + "ego")
    for before, now in itertools.pairwise(steps):
        if min(before.left, now.left) > 0.1:
            assert now.leader_left in body, now
        if min(before.right, now.right) > 0.1:
            assert now.leader_right in body, now
        if max(before.left, now.left) < -0.05:
            assert now.leader_left == ""
            assert not now.phantom
    both = [s for s in steps if s.left > 0.1 and s.right > 0.1]
    assert len(both) > 100
    assert {s.leader_left for s in both} == {s.leader_right for s in both} == set(body)


def test_a_faster_follower_in_the_other_lane_brakes_for_the_phantom(world):
    w = world(vehicle("ego", 150, 12), vehicle("follower0", 20, 12, "slow"), vehicle("follower1", 20, 25, lane=2))
    for _ in w.warm_up(STEP):
        pass
    start = pose = w.take_over("ego", FRONT, WIDTH).pose
    closest = math.inf
    for k in range(400):
        y = start.y + min(k / 40, 1.0) * 1.2  # the body reaches half a meter into the lane, the bumper's center stays
        w.propose({"ego": pose})
        pose = pose._replace(x=pose.x + 12.0 * STEP, y=y, speed=12.0)
        w.commit({"ego": pose})
        assert libsumo.vehicle.getLaneIndex("ego") == 1
        closest = min(closest, pose.x + FRONT - 5.0 - look("follower1").position)
    assert look("follower1").speed == pytest.approx(12.0, abs=0.5)
    assert closest > 2.4  # the standing gap of its type


@pytest.mark.parametrize(("side", "leader"), [(-1, PHANTOM + "ego"), (0, "")])
def test_a_lane_that_the_ego_holds_keeps_its_traffic_behind_it(world, side, leader):
    w = world(vehicle("ego", 150, 12, lane=2), vehicle("follower0", 60, 25))
    for _ in w.warm_up(STEP):
        pass
    pose = w.take_over("ego", FRONT, WIDTH).pose
    w.hold("ego", side)
    for _ in range(10):
        w.propose({"ego": pose})
        pose = pose._replace(x=pose.x + 12.0 * STEP, speed=12.0)
        w.commit({"ego": pose})
    assert (libsumo.vehicle.getLeader("follower0", 150.0) or ("", 0.0))[0] == leader
    w.hold("ego", 0)
    w.propose({"ego": pose})
    w.commit({"ego": pose})
    assert not any(name.startswith(PHANTOM) for name in libsumo.vehicle.getIDList())


def test_after_a_lane_change_sumo_weighs_its_wishes_from_zero_as_after_its_own(world):
    w = world(vehicle("ego", 150, 12))
    for _ in w.warm_up(STEP):
        pass
    w.take_over("ego", FRONT, WIDTH)
    wishes = [f"laneChangeModel.{w}" for w in ("keepRightProbability", "speedGainProbabilityLeft")]
    for wish in wishes:
        libsumo.vehicle.setParameter("ego", wish, "3")
    w.changed_lane("ego")
    assert [float(libsumo.vehicle.getParameter("ego", wish)) for wish in wishes] == [0.0, 0.0]


def watch(w: SumoWorld, poses: int, broken: int = -1) -> np.ndarray:
    """Positions of everybody over some steps; at step `broken` the block is left between proposal and pose."""
    with w:
        for _ in w.warm_up(1.0):
            pass
        pose = w.take_over("ego", FRONT, WIDTH).pose
        rows = []
        for k in range(poses):
            wanted = w.propose({"ego": pose})["ego"].speed
            if k == broken:
                raise ZeroDivisionError
            pose = pose._replace(x=pose.x + 0.5 * (pose.speed + wanted) * STEP, speed=wanted)
            w.commit({"ego": pose})
            rows.append([look(name)[1:3] for name in ("ego", "other")])
        assert sorted(libsumo.vehicle.getIDList()) == ["ego", "other"]
    return np.array(rows)


def test_a_simulation_that_broke_leaves_nothing_to_the_next(world):
    cars = (vehicle("ego", 200, 20), vehicle("other", 160, 22))
    fresh = watch(world(*cars), 100)
    with pytest.raises(ZeroDivisionError):
        watch(world(*cars), 100, broken=30)
    np.testing.assert_array_equal(watch(world(*cars), 100), fresh)


def test_closing_twice_is_closing_once(world):
    w = world(vehicle("ego", 200, 20))
    w.close()
    w.close()
    assert not libsumo.simulation.isLoaded()


def test_an_ego_off_the_road_is_told_as_lost(world):
    w = world(vehicle("ego", 200, 20))
    list(w.warm_up(STEP))
    pose = w.take_over("ego", FRONT, WIDTH).pose
    w.propose({"ego": pose})
    away = pose._replace(y=pose.y + 200.0)
    w.commit({"ego": away})
    assert w.lane_of("ego") == ""
    assert w.mirror_error("ego", away) == math.inf


def test_what_sumo_says_while_it_steps_is_one_plain_error(world, capfd):
    w = world(vehicle("ego", 200, 99))
    with pytest.raises(UserError, match=r"SUMO stopped: .*too high"):
        list(w.warm_up(1.0))
    assert capfd.readouterr().err == ""


def test_the_take_over_hands_over_the_car_where_it_is(world):
    w = world(vehicle("ego", 200, 20, inside='<param key="double_lane_change.start" value="300"/>'))
    list(w.warm_up(1.0))
    handed = w.take_over("ego", FRONT, WIDTH)
    x, y = libsumo.vehicle.getPosition("ego")
    assert (handed.pose.x + FRONT, handed.pose.y, handed.pose.yaw) == pytest.approx((x, y, 0.0), abs=1e-9)
    assert handed.route_position == pytest.approx(x - FRONT, abs=1e-6)
    assert (handed.lanes_left, handed.lanes_right, handed.lane_width) == (1, 1, 3.2)
    assert handed.params == {"double_lane_change.start": "300"}
    np.testing.assert_allclose(handed.path.y, -4.8, atol=1e-6)
    assert handed.path.x[-1] == pytest.approx(2060.0, abs=0.3), "along the whole route, and 60 m on for the preview"


def test_the_speed_limit_of_a_scenario_is_the_one_of_the_main_lanes(tmp_path):
    file = tmp_path / "cars.rou.xml"
    file.write_text(MAKE.format(vehicles=vehicle("ego", 200, 20)), encoding="utf-8")
    with SumoWorld(scenario_options(LINE, [file], [], 0.0), STEP, 1, speed_limit=25.0):
        assert {libsumo.lane.getMaxSpeed(f"fast_{i}") for i in range(3)} == {25.0}
        assert {libsumo.lane.getMaxSpeed(f"slow_{i}") for i in range(3)} == {15.0}


class Watched(SumoWorld):
    """Looks at SUMO a second time after every step; a class of its own because the run opens its world itself."""

    def __init__(self, *args) -> None:
        self.departed_ids: set[str] = set()
        self.arrived_ids: set[str] = set()
        self.missing: set[str] = set()
        self.teleported = self.miscounted = self.phantoms_told = 0
        self.mirror_errors: list[float] = []
        self.speed_errors: list[float] = []
        self.phantoms: list[int] = []
        super().__init__(*args)
        WATCHED.append(self)

    def _note_travel(self) -> None:
        self.departed_ids |= set(libsumo.simulation.getDepartedIDList())
        self.arrived_ids |= set(libsumo.simulation.getArrivedIDList())

    def _note_step(self) -> None:
        self._note_travel()
        ids = set(libsumo.vehicle.getIDList())
        phantoms = {name for name in ids | self.departed_ids if name.startswith(PHANTOM)}
        self.phantoms.append(len(phantoms & ids))
        present = self.departed_ids - self.arrived_ids - phantoms
        self.missing |= present ^ (ids - phantoms)
        self.miscounted += self.vehicle_count() != len(present)
        self.teleported += libsumo.simulation.getStartingTeleportNumber()

    def advance(self) -> None:
        super().advance()
        self._note_step()

    def propose(self, poses):
        intents = super().propose(poses)
        self._note_travel()  # half of the step: who leaves the road leaves it here
        return intents

    def commit(self, poses) -> None:
        super().commit(poses)
        self._note_step()
        pose = poses["ego"]
        x, y = libsumo.vehicle.getPosition("ego")
        off = math.hypot(x - pose.x - EGO_FRONT * math.cos(pose.yaw), y - pose.y - EGO_FRONT * math.sin(pose.yaw))
        turned = math.remainder(90.0 - libsumo.vehicle.getAngle("ego") - math.degrees(pose.yaw), 360.0)
        self.mirror_errors.append(max(off, abs(math.radians(turned)) * EGO_FRONT))
        self.speed_errors.append(libsumo.vehicle.getSpeed("ego") - pose.speed)
        told = [*self.neighbors("ego").ids, *(name for pair in self.collisions() for name in pair)]
        self.phantoms_told += any(name.startswith(PHANTOM) for name in told)


WATCHED: list[Watched] = []
EGO_FRONT = VehicleParams().front_axle + VehicleParams().front_overhang


class Ledger(NamedTuple):
    """A whole run of highway_dlc: what was watched and what the run says of itself."""

    world: Watched
    result: drive.RunResult


@pytest.fixture(scope="module")
def ledger(tmp_path_factory) -> Ledger:
    located = scenario.load("highway_dlc", {"duration": (30.0, "test")})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(opening, "SumoWorld", Watched)
        result = drive.run(located, tmp_path_factory.mktemp("runs"), record=False)
    return Ledger(WATCHED.pop(), result)


def test_the_copy_of_the_ego_in_sumo_is_within_a_millimeter_in_every_step(ledger):
    assert len(ledger.world.mirror_errors) == 600
    assert max(ledger.world.mirror_errors) < 1e-3
    assert ledger.result.metrics["run"]["mirror_error_max"] < 1e-3


def test_sumo_knows_the_speed_of_the_ego(ledger):
    assert max(map(abs, ledger.world.speed_errors)) < 1e-9


def test_nobody_is_teleported_or_removed_for_the_ego(ledger):
    assert len(ledger.world.departed_ids) > 200
    assert ledger.world.arrived_ids
    assert ledger.world.missing == set()
    assert ledger.world.teleported == ledger.world.miscounted == 0
    assert ledger.result.metrics["safety"]["collisions"] == 0
    assert ledger.result.metrics["safety"]["collisions_of_others"] == 0


def test_the_double_lane_change_is_driven_with_a_phantom_that_nobody_is_told_of(ledger):
    assert ledger.result.metrics["run"]["double_lane_change_began"] is not None
    phantoms = np.array(ledger.world.phantoms)
    # both transitions are driven at 18 to 20 m/s; a body of 1.85 m is in two lanes for a second or so in each
    assert 1.0 < (phantoms > 0).sum() * STEP < 8.0
    assert phantoms.max() == 1
    assert phantoms[-1] == 0
    assert ledger.world.phantoms_told == 0
