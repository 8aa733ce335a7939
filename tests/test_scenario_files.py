"""The shipped scenarios, driven by SUMO alone: they load, and what their titles promise can happen on them."""

import functools
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import libsumo
import pytest

from emran_sumo import locate, scenario, shipped
from emran_sumo.world.demand import write_demand
from emran_sumo.world.network import main_limit
from emran_sumo.world.routes import departures

NAMES = ("highway_cruise", "highway_overtake", "ramp_merge", "urban_signals", "wet_curves", "bridge_gust", "town")
STEP = 0.05  # s
OPTIONS = {
    "step-length": str(STEP),
    "step-method.ballistic": "true",
    "default.action-step-length": "0.2",
    "collision.action": "warn",
    "collision.mingap-factor": "0",
    "collision.check-junctions": "true",
    "time-to-teleport": "-1",
    "no-step-log": "true",
    "no-warnings": "true",
    "duration-log.disable": "true",
    "xml-validation": "never",
}


class Seen(NamedTuple):
    """What a native drive showed; times count from the end of the warm-up.

    departed: whether the ego was on the road then or within 5 s after it; arrived: when it left the network, or None;
    lanes: of the ego, in order; lights: states of signals within 40 m ahead; stopped: how long it stood at a stop [s];
    overtaken: vehicles that were ahead on the ego's edge at first and later behind it.
    """

    departed: bool
    arrived: float | None
    distance: float
    lanes: tuple[str, ...]
    speeds: tuple[float, ...]
    lights: frozenset[str]
    stopped: float
    overtaken: frozenset[str]
    vehicles: int
    collisions: frozenset[tuple[str, str]]
    teleports: int


@functools.cache
def drive(name: str, duration: float, seed: int = 1) -> Seen:
    """Drive a scenario natively for its warm-up and `duration` [s]."""
    located = scenario.load(name)
    values = located.values
    network = locate.folder("networks") / values.network / f"{values.network}.net.xml"
    routes = [located.folder / file for file in values.routes]
    limit = values.road.speed_limit or main_limit(network)
    ego = values.ego or "ego"
    with tempfile.TemporaryDirectory() as folder:
        traffic = Path(folder) / "traffic.rou.xml"
        write_demand(traffic, network, routes, values.traffic, limit, seed, departures(routes, [ego], limit))
        files = {"net-file": network, "route-files": ",".join(map(str, [*routes, traffic])), "seed": seed}
        options = [word for key, value in (OPTIONS | files).items() for word in (f"--{key}", str(value))]
        libsumo.start(["sumo", *options])
        try:
            if values.road.speed_limit:
                limit_main_lanes(values.road.speed_limit)
            return watch(ego, values.warm_up, duration)
        finally:
            libsumo.close()


def limit_main_lanes(limit: float) -> None:
    lanes = libsumo.lane.getIDList()
    main = max(map(libsumo.lane.getMaxSpeed, lanes))
    for lane in lanes:
        if libsumo.lane.getMaxSpeed(lane) > 0.9 * main:
            libsumo.lane.setMaxSpeed(lane, limit)


def watch(ego: str, warm_up: float, duration: float) -> Seen:
    vehicle = libsumo.vehicle
    departed, arrived, start, distance, stopped, vehicles = False, None, 0.0, 0.0, 0.0, 0
    lanes: list[str] = []
    speeds: list[float] = []
    lights, ahead, overtaken, collisions, teleports = set(), set[str](), set[str](), set(), 0
    for time in steps(warm_up, duration):
        collisions |= {(c.collider, c.victim) for c in libsumo.simulation.getCollisions()}
        teleports += libsumo.simulation.getStartingTeleportNumber()
        if time < 0.0:
            continue
        vehicles = vehicles or vehicle.getIDCount()
        if ego not in vehicle.getIDList():
            if departed:
                arrived = time
                break
            continue
        if not departed:
            departed, start = time <= 5.0, vehicle.getDistance(ego)
            ahead = {other for other in vehicle.getIDList() if is_behind(ego, other)}
        lane = vehicle.getLaneID(ego)
        lanes += [lane] if not lanes or lanes[-1] != lane else []
        speeds.append(vehicle.getSpeed(ego))
        distance = vehicle.getDistance(ego) - start
        stopped += STEP * vehicle.isStopped(ego)
        lights |= {signal[3] for signal in vehicle.getNextTLS(ego) if signal[2] < 40.0}
        overtaken |= {other for other in ahead - overtaken if is_behind(other, ego)}
    return Seen(
        departed, arrived, distance, tuple(lanes), tuple(speeds), frozenset(lights), stopped, frozenset(overtaken),
        vehicles, frozenset(collisions), teleports,
    )  # fmt: skip


def steps(warm_up: float, duration: float) -> Iterator[float]:
    """Step SUMO; yields the time since the end of the warm-up."""
    for k in range(1, round((warm_up + duration) / STEP) + 1):
        libsumo.simulation.step()
        yield k * STEP - warm_up


def is_behind(one: str, other: str) -> bool:
    """Whether all of `one` is behind `other` on the same edge."""
    vehicle = libsumo.vehicle
    if one not in vehicle.getIDList() or vehicle.getRoadID(one) != vehicle.getRoadID(other):
        return False
    return vehicle.getLanePosition(one) < vehicle.getLanePosition(other) - vehicle.getLength(other)


def test_all_of_them_are_shipped_with_a_title_of_one_line():
    known = shipped.scenarios()
    for name in NAMES:
        assert 20 < len(known[name]) < 100
        assert "\n" not in known[name]


@pytest.mark.parametrize("name", NAMES)
def test_sumo_drives_it_without_collision_or_teleport(name: str):
    seen = drive(name, 60.0)
    assert seen.departed
    assert seen.distance > 100.0
    assert not seen.collisions
    assert seen.teleports == 0


@pytest.mark.parametrize("name", NAMES)
def test_the_ego_is_an_ordinary_car_whose_lane_sumo_may_change(name: str):
    located = scenario.load(name)
    text = (located.folder / located.values.routes[0]).read_text(encoding="utf-8")
    ego_type = text[text.index('<vType id="ego_sedan"') :].partition("/>")[0]
    for words in ('sigma="0"', 'speedFactor="1"', 'speedDev="0"', 'vClass="passenger"', 'length="4.7"'):
        assert words in ego_type
    assert "lcSpeedGain" not in ego_type
    assert "lcKeepRight" not in ego_type


@pytest.mark.parametrize("name", NAMES)
def test_the_way_is_long_enough_for_the_duration_or_ends_in_an_arrival(name: str):
    values = scenario.load(name).values
    assert 60.0 <= values.duration <= 200.0
    if name in ("ramp_merge", "wet_curves", "urban_signals"):
        seen = drive(name, values.duration)
        assert seen.arrived is not None
        assert seen.arrived < values.duration
    else:
        at = {"highway_cruise": 28.0, "highway_overtake": 27.78, "bridge_gust": 25.0, "town": 13.89}[name]
        seen = drive(name, 60.0)
        assert seen.arrived is None
        assert seen.distance <= 60.0 * at * 1.001


def test_highway_cruise_slows_down_where_the_limit_changes():
    seen = drive("highway_cruise", 60.0)
    assert [lane.partition("_")[0] for lane in seen.lanes if lane[0] != ":"][-1] == "slow"
    assert max(seen.speeds) == pytest.approx(28.0, abs=0.05)
    assert seen.speeds[-1] < 25.05


def test_highway_overtake_passes_both_slow_trucks():
    seen = drive("highway_overtake", scenario.load("highway_overtake").values.duration)
    assert seen.lanes[0] == "main_in_0"
    assert {"truck_behind", "truck_ahead"} <= seen.overtaken


@pytest.mark.parametrize("seed", [1, 2])
def test_ramp_merge_comes_from_one_ramp_and_leaves_by_the_other(seed: int):
    seen = drive("ramp_merge", scenario.load("ramp_merge").values.duration, seed)
    assert seen.lanes[0] == "on_ramp_0"
    assert any(lane.startswith("main_mid") for lane in seen.lanes)
    assert seen.lanes[-1] == "off_ramp_0"
    assert seen.vehicles > 250


def test_urban_signals_meets_red_and_green_gives_way_and_stops():
    seen = drive("urban_signals", scenario.load("urban_signals").values.duration)
    assert {"r", "G", "g"} <= seen.lights  # "g": green that gives way to oncoming traffic
    assert seen.stopped == pytest.approx(5.0, abs=0.3)
    edges = [lane.partition("_")[0] for lane in seen.lanes if lane[0] != ":"]
    assert list(dict.fromkeys(edges)) == ["west1.a1", "a1.b1", "b1.b2", "b2.c2", "c2.c3", "c3.d3", "d3.east3"]


def test_wet_curves_is_slippery_in_its_two_tightest_curves():
    values = scenario.load("wet_curves").values
    patch = values.disturbance
    # networks/curves/README.md: the curves of 60 m and 80 m radius
    assert patch.patch_start < 1200.0
    assert patch.patch_end > 1530.0
    assert 0.5 <= patch.patch_friction * values.road.friction <= 0.8
    assert values.road.friction <= 0.8
    seen = drive("wet_curves", values.duration)
    assert max(seen.speeds) <= 22.23


def test_bridge_gust_blows_while_the_ego_is_on_the_bridge():
    values = scenario.load("bridge_gust").values
    gust = values.disturbance
    assert 3000.0 <= gust.gust_force <= 4000.0
    seen = drive("bridge_gust", 60.0)
    before = 900.0 - 815.0  # m from where it is at most taken over to the bridge, which is 1400 m long
    assert gust.gust_start * min(seen.speeds) > before
    assert (gust.gust_start + gust.gust_duration) * 25.0 < before + 1400.0


def test_the_town_holds_more_than_300_vehicles():
    assert drive("town", 60.0).vehicles > 300
