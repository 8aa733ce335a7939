"""Somebody else's SUMO configuration, driven: where SUMO stops the ego stops, and every end has its sentence."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import libsumo
import numpy as np
import pyarrow.parquet as pq
import pytest
from test_recording import rows_of

from emran_sumo import drive, locate, scenario
from emran_sumo.drive import RunResult
from emran_sumo.ego import COLUMNS, Ego, fitted
from emran_sumo.errors import UserError
from emran_sumo.opening import opening
from emran_sumo.path import point_at
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.world import waiting
from emran_sumo.world.records import Pose, TakeOver
from emran_sumo.world.sumo import SumoWorld

TYPES = """\
    <vType id="mine" length="4.7" width="1.85" accel="2.6" decel="4.5" sigma="0" speedFactor="1" speedDev="0"/>
    <vType id="other" sigma="0" speedFactor="1" speedDev="0" lcStrategic="0" lcSpeedGain="0" lcKeepRight="0"
           lcCooperative="0"/>
    <vType id="long" vClass="bus" length="12"/>
"""


def vehicle(
    name: str, edges: str, position: float, speed: str = "max", lane: int = 0, depart: float = 0.0,
    kind: str = "other", inside: str = "",
) -> str:  # fmt: skip
    where = f'departLane="{lane}" departPos="{position}" departSpeed="{speed}"'
    route = f'<route edges="{edges}"/>{inside}'
    return f'<vehicle id="{name}" type="{kind}" depart="{depart}" {where}>{route}</vehicle>'


def ego(edges: str, lane: int = 0, inside: str = "", depart: float = 0.0) -> str:
    return vehicle("ego", edges, 20, "10", lane, depart, "mine", inside)


def written(folder: Path, vehicles: list[str], options: str = "", additional: str = "") -> Path:
    """A configuration on the blocks of `networks/urban`."""
    network = locate.folder("networks") / "urban" / "urban.net.xml"
    ordered = sorted(vehicles, key=lambda text: float(text.split('depart="')[1].split('"')[0]))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cars.rou.xml").write_text(f"<routes>{TYPES}{''.join(ordered)}</routes>", encoding="utf-8")
    inputs = f'<net-file value="{network}"/><route-files value="cars.rou.xml"/>'
    if additional:
        (folder / "more.add.xml").write_text(f"<additional>{additional}</additional>", encoding="utf-8")
        inputs += '<additional-files value="more.add.xml"/>'
    file = folder / "my.sumocfg"
    file.write_text(f"<configuration><input>{inputs}</input>{options}</configuration>", encoding="utf-8")
    return file


def run(file: Path, duration: float, *ids: str, record: bool = False, **given: Any) -> RunResult:
    """Drive a configuration; `__` in a key stands for the dot."""
    values = {key.replace("__", "."): value for key, value in given.items()}
    values |= {"duration": duration} | ({"egos.ids": ids} if ids else {})
    located = scenario.load(str(file), {key: (value, "test") for key, value in values.items()})
    return drive.run(located, file.parent.parent / "runs", record=record)


def summary(result: RunResult) -> dict[str, Any]:
    return json.loads((result.folder / "summary.json").read_text(encoding="utf-8"))


class Way(NamedTuple):
    """Front bumper x, y [m] and speed [m/s] over time [s]."""

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray
    speed: np.ndarray

    def stands(self) -> np.ndarray:
        """Where it first stands."""
        k = int(np.argmax(self.speed < 0.03))
        assert self.speed[k] < 0.03, "it never stands"
        return np.array([self.x[k], self.y[k]])


def native_way(file: Path, duration: float) -> Way:
    located = scenario.load(str(file))
    rows = []
    with opening(located)(file.parent, False) as world:
        assert isinstance(world, SumoWorld)
        while "ego" not in world.present():
            world.advance()
        begin = world.time
        while "ego" in world.present() and world.time - begin < duration:
            v = libsumo.vehicle
            rows.append((world.time - begin, *v.getPosition("ego"), v.getSpeed("ego")))
            world.advance()
    return Way(*np.array(rows).T)


def driven_way(result: RunResult) -> Way:
    def column(name: str) -> np.ndarray:
        return result.trace[:, COLUMNS.index(name)]

    car = fitted(scenario.load("town").values.vehicle, 4.7, 1.85)
    front, yaw = car.front_axle + car.front_overhang, column("yaw")
    x, y = column("x") + front * np.cos(yaw), column("y") + front * np.sin(yaw)
    return Way(column("time"), x, y, column("speed_long"))


def stream(name: str, edges: str, count: int, lane: int = 0) -> list[str]:
    return [vehicle(f"{name}{k}", edges, 5, lane=lane, depart=2.0 * k) for k in range(count)]


STOPS = {
    "a red light": ([ego("b1.b2 b2.b3")], 20.0),
    "a stop": ([ego("c3.d3 d3.east3", inside='<stop lane="c3.d3_0" endPos="110" duration="5"/>')], 20.0),
    "a road with priority": ([ego("west1.a1 a1.b1"), *stream("n", "south_a.a1 a1.a2 a2.a3", 8)], 20.0),
    "oncoming traffic": ([ego("b2.c2 c2.c3", 1), *stream("w", "d2.c2 c2.b2", 40)], 40.0),
}


@pytest.mark.parametrize("lag", [0.1, 0.3])
@pytest.mark.parametrize("situation", STOPS)
def test_the_ego_stands_where_sumos_own_driver_stands(tmp_path, situation, lag):
    vehicles, duration = STOPS[situation]
    file = written(tmp_path / "user", vehicles)
    own = native_way(file, duration).stands()
    result = run(file, duration, "ego", vehicle__torque_lag=lag)
    assert result.ended != "collision", result.reason
    assert float(np.hypot(*(driven_way(result).stands() - own))) < 0.5


@pytest.mark.parametrize(
    ("situation", "why"), [*zip(STOPS, ("at a red light", "at its stop", "gives way", "gives way"), strict=True)]
)
def test_the_recording_tells_why_the_ego_stands(tmp_path, situation, why):
    vehicles, duration = STOPS[situation]
    result = run(written(tmp_path / "user", vehicles), duration, "ego", record=True)
    _, states = rows_of(result.folder / "run.rrd", "/state/maneuver", "StateChange:state")
    assert why in {state for (state,) in states} <= {"keep lane", *waiting.REASONS}
    _, texts = rows_of(result.folder / "run.rrd", "/events", "TextLog:text")
    assert [f"stands: {why}"] in texts


PARKS = {
    "on a verge": ('<stop lane="c3.d3_0" endPos="110" duration="5" parking="true"/>', ""),
    "on a parking area": (
        '<stop parkingArea="lot" duration="5"/>',
        '<parkingArea id="lot" lane="c3.d3_0" startPos="70" endPos="110" roadsideCapacity="4"/>',
    ),
}


@pytest.mark.parametrize("where", PARKS)
def test_who_parks_on_the_way_stands_on_its_lane_and_goes_on(tmp_path, where):
    stop, additional = PARKS[where]
    file = written(tmp_path / "user", [ego("c3.d3 d3.east3", inside=stop)], additional=additional)
    own = native_way(file, 100.0)
    result = run(file, 100.0, "ego")
    assert result.ended == "arrived", result.reason
    way = driven_way(result)
    assert way.time[-1] == pytest.approx(own.time[-1], rel=0.05)
    assert 4.5 < np.sum(way.speed < 0.03) * float(np.median(np.diff(way.time))) < 6.5  # it waits the stop's 5 s
    ahead = way.stands()[0] - own.stands()[0]  # along the lane; SUMO takes the first lot it can still stop at
    assert -0.5 < ahead < (30.5 if additional else 0.5)


@pytest.mark.parametrize("declared", ['arrivalPos="60"', 'arrivalPos="-50"', 'arrivalPos="60" arrivalSpeed="0"'])
def test_the_ego_arrives_where_its_declaration_says(tmp_path, declared):
    car = ego("c3.d3 d3.east3").replace("<vehicle ", f"<vehicle {declared} ")
    file = written(tmp_path / "user", [car])
    own = native_way(file, 100.0)
    result = run(file, 100.0, "ego")
    assert result.ended == "arrived", result.reason
    way = driven_way(result)
    assert abs(way.x[-1] - own.x[-1]) < 1.5
    assert way.time[-1] == pytest.approx(own.time[-1], rel=0.05)


def test_an_ego_that_sumo_takes_away_ends_the_run_with_a_sentence(tmp_path, monkeypatch):
    """SUMO decides so within the step, in which an ego stands longer than it lets it."""
    files = [ego("c3.d3 d3.east3").replace("<vehicle ", '<vehicle arrivalPos="60" arrivalSpeed="0" ')]
    file = written(tmp_path / "user", files, '<processing><time-to-teleport value="10"/></processing>')
    monkeypatch.setattr(SumoWorld, "arrived", lambda *_: False)
    result = run(file, 100.0, "ego")
    assert result.ended == "lost"
    assert "SUMO removed the ego" in result.reason


@pytest.mark.parametrize("lag", [0.1, 0.3])
def test_no_red_light_is_run(tmp_path, lag):
    """The street north has red for 30 s of every minute; its line is at y = 163.5 m, and SUMO stops 1 m before it."""
    for k in range(4):
        file = written(tmp_path / f"user{k}", [ego("b1.b2 b2.b3", depart=5.0 * k)])
        way = driven_way(run(file, 30.0 - 5.0 * k, "ego", vehicle__torque_lag=lag))
        assert way.y.max() < 163.0


def queue(gap: float) -> list[str]:
    """Cars that stand in the left lane for 60 s."""
    stop = '<stop lane="a2.b2_1" endPos="{}" duration="60"/>'
    places = np.arange(160.0, 30.0, -gap)
    return [vehicle(f"q{p:g}", "a2.b2 b2.b3", p, "0", 1, inside=stop.format(p + 0.1)) for p in places]


def test_who_finds_the_lane_to_turn_from_full_changes_late_and_goes_on(tmp_path):
    file = written(tmp_path / "user", [ego("a2.b2 b2.b3"), *queue(8.0)])
    own = native_way(file, 120.0).time[-1]
    result = run(file, 120.0, "ego")
    assert result.ended == "arrived", result.reason
    assert result.metrics["run"]["lane_changes"] == 1
    assert result.metrics["run"]["simulated"] < 1.15 * own


def test_a_changed_route_is_followed(tmp_path):
    inside = '<interval begin="0" end="999"><destProbReroute id="a3.north_a"/></interval>'
    rerouter = f'<rerouter id="r" edges="a1.a2">{inside}</rerouter>'
    file = written(tmp_path / "user", [ego("south_a.a1 a1.a2 a2.b2")], additional=rerouter)
    result = run(file, 90.0, "ego")
    assert result.ended == "arrived", result.reason
    way = driven_way(result)
    assert way.y[-1] > 480.0
    assert abs(way.x[-1]) < 5.0


def test_who_is_off_its_route_is_found_and_led_to_its_destination(tmp_path):
    file = written(tmp_path / "user", [ego("b1.b2 b2.b3")])
    with opening(scenario.load(str(file)))(file.parent, False) as w:
        assert isinstance(w, SumoWorld)
        while "ego" not in w.present():
            w.advance()
        pose = w.take_over("ego", 2.0, 1.85).pose
        x, y = np.mean(libsumo.lane.getShape("a2.b2_0"), axis=0)
        pose = pose._replace(x=float(x), y=float(y), yaw=0.0, speed=5.0)
        for searches in (False, True):
            w.propose({"ego": pose})
            if searches:
                w.search("ego")
            w.commit({"ego": pose})
            assert w.lane_of("ego") == ("a2.b2_0" if searches else "")
        assert w.mirror_error("ego", pose) < 1e-6
        route = libsumo.vehicle.getRoute("ego")
        assert (route[0], route[-1]) == ("a2.b2", "b2.b3")
        w.propose({"ego": pose})
        w.commit({"ego": pose})
        assert w.lane_of("ego") == "a2.b2_0"


def test_waiting_longer_than_others_may_takes_no_ego_from_the_road(tmp_path):
    stands = vehicle("stands", "c3.d3 d3.east3", 100, inside='<stop lane="c3.d3_0" endPos="120" duration="60"/>')
    options = '<time-to-teleport value="10"/>'
    result = run(written(tmp_path / "user", [stands, ego("c3.d3 d3.east3")], options), 50.0, "ego")
    assert result.ended == "finished"
    way = driven_way(result)
    assert (way.speed < 0.03).sum() * 0.01 > 30.0
    # its bumper stands a minGap behind the other's
    assert way.stands()[0] == pytest.approx(413.25 + 120.0 - 5.0 - 2.5, abs=0.5)


def test_time_starts_at_zero_and_the_configurations_end_is_the_end(tmp_path):
    options = '<begin value="100"/><end value="112"/>'
    result = run(written(tmp_path / "user", [ego("b1.b2 b2.b3", depart=102.0)], options), 60.0, "ego")
    assert (result.ended, result.trace[0, COLUMNS.index("time")]) == ("finished", pytest.approx(0.01))
    assert result.metrics["run"]["simulated"] == pytest.approx(10.0, abs=0.11)
    assert result.reason.endswith("to the configuration's own end")


def test_what_is_done_differently_is_in_the_summary(tmp_path):
    file = written(tmp_path / "user", [ego("b1.b2 b2.b3")], '<step-length value="0.5"/><osg-view value="true"/>')
    notes = summary(run(file, 1.0, "ego"))["notes"]
    assert any("0.05 s in place of the configuration's 0.5 s" in note for note in notes)
    assert any("osg-view" in note for note in notes)


def test_several_egos_have_their_own_traces_and_one_end_leaves_the_others(tmp_path):
    edges = ("south_a.a1 a1.a2", "south_d.d1 d1.d2 d2.d3")
    cars = [vehicle(f"car{k}", route, 20, "10", kind="mine") for k, route in enumerate(edges)]
    near = vehicle("near", "west1.a1 a1.b1", 130, "5", kind="mine")
    result = run(written(tmp_path / "user", [*cars, near]), 30.0, "car0", "car1", "near")
    told = summary(result)
    assert set(told["egos"]) == {"car0", "car1", "near"}
    assert [told["egos"][name]["ended"] for name in ("near", "car0", "car1")] == ["arrived", "arrived", "finished"]
    for name, found in told["egos"].items():
        file = result.folder / ("trace.parquet" if name == told["ego"] else f"egos/{name}.parquet")
        times = pq.read_table(file)["time"].to_numpy()
        np.testing.assert_allclose(np.diff(times), 0.01, rtol=1e-6)
        assert found["metrics"]["run"]["simulated"] == pytest.approx(times[-1])
    traces = {found["metrics"]["run"]["distance"] for found in told["egos"].values()}
    assert len(traces) == 3


def test_egos_that_depart_later_are_taken_over_as_they_depart_and_who_never_comes_is_told(tmp_path):
    late = vehicle("late", "south_a.a1 a1.a2", 20, "10", depart=3.0, kind="mine")
    result = run(written(tmp_path / "user", [ego("b1.b2 b2.b3"), late]), 10.0, "ego", "late", "nobody")
    told = summary(result)
    assert set(told["egos"]) == {"ego", "late"}
    assert told["egos"]["late"]["metrics"]["run"]["simulated"] == pytest.approx(7.0, abs=0.1)
    assert "has not departed: nobody" in told["notes"]


def test_a_share_is_taken_of_those_that_depart_on_the_way_too(tmp_path):
    cars = [vehicle(f"c{k}", "b1.b2 b2.b3", 20, "10", depart=3.0 * k) for k in range(5)]
    told = summary(run(written(tmp_path / "user", cars), 15.0, egos__penetration=1.0))
    assert set(told["egos"]) == {f"c{k}" for k in range(5)}


def test_who_departs_while_others_are_driven_is_taken_over_once(tmp_path, monkeypatch):
    taken, original = [], SumoWorld.take_over

    def take_over(world, name, *given):
        taken.append(name)
        return original(world, name, *given)

    monkeypatch.setattr(SumoWorld, "take_over", take_over)
    cars = [vehicle(f"c{k}", "b1.b2 b2.b3", 20, "10", depart=2.0 * k) for k in range(3)]
    run(written(tmp_path / "user", cars), 6.0, egos__penetration=1.0)
    assert taken == ["c0", "c1", "c2"]


@pytest.mark.parametrize("radius", [12.0, -9.0])
def test_who_is_taken_over_in_a_bend_steers_already(bench, radius):
    """With straight wheels it takes the steering's rate, 0.2 to 0.4 s, until the car turns as the bend does."""
    values = scenario.load("town").values
    road = bench.circle(radius, 60.0)
    at = point_at(road, 10.0)
    handed = TakeOver(Pose(at.x, at.y, at.yaw, 4.0, 0.0), road, 3.2, 0, 0, {}, 0.0, 50.0)
    found = Ego("ego", values, values.vehicle, handed, 0.0).state.vehicle
    assert found.yaw_rate == pytest.approx(4.0 / radius, rel=0.01)
    # the rear axle does not slip
    assert found.speed_lat == pytest.approx(found.yaw_rate * values.vehicle.rear_axle)
    wheelbase = values.vehicle.front_axle + values.vehicle.rear_axle
    assert math.tan(found.steer) == pytest.approx(wheelbase / radius, rel=0.01)


def test_the_reference_comes_to_the_limit_without_swing_or_dawdling(tmp_path):
    imperfect = vehicle("ego", "west2.a2 a2.b2", 5, "2", kind="human")
    types = '<vType id="human" accel="2.6" decel="4.5" sigma="0.5" speedFactor="1" speedDev="0"/>'
    file = written(tmp_path / "user", [imperfect], additional=types)
    columns = {"speed_reference", "accel_reference"}
    result = run(file, 9.0, "ego", controller="coupled-base")
    speed, accel = (result.trace[:, COLUMNS.index(name)] for name in sorted(columns, reverse=True))
    assert speed[-1] == pytest.approx(13.89, abs=0.01)
    assert speed.max() < 13.89 + 0.02
    # steps of 0.05 s: SUMO's driver speeds up at 2.6 m/s2, and the wish ends within 10 m/s3
    assert accel.max() == pytest.approx(2.6, abs=0.1)
    assert accel.min() > -0.1
    assert np.diff(accel).min() > -2 * 10.0 * 0.05
    assert (np.diff(speed[accel > 2.5]) >= 0.0).all()


def test_traffic_that_crosses_is_no_lead(tmp_path):
    crossing = stream("w", "a2.b2 b2.c2", 6)
    result = run(written(tmp_path / "user", [ego("b1.b2 b2.b3"), *crossing]), 15.0, "ego")
    assert result.metrics["safety"]["conflicts"] == 0
    assert result.metrics["safety"]["time_to_collision_min"] is None


TIGHT = "; its route turns within 1.6 m there, and the car needs 3.8 m"


@pytest.mark.parametrize(("radius", "words"), [(1.6, TIGHT), (8.0, "")])
def test_who_is_lost_where_no_car_can_turn_is_told_so(bench, radius, words):
    car = SimpleNamespace(vehicle=VehicleParams(), base=bench.circle(radius, 20.0), state=SimpleNamespace(position=5.0))
    assert Ego.too_tight(cast(Any, car)) == words


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("early", "departs at 2 s, and SUMO leaves out who departs before the configuration's begin of 5 s"),
        ("eerly", 'is declared in none of the files. .*"early"'),
        ("many.9", "was not on the road"),  # of a flow: the files do not tell whether it ever comes
    ],
)
def test_who_departs_before_the_begin_and_who_is_nowhere_have_sentences_of_their_own(tmp_path, name, words):
    flow = '<flow id="many" begin="6" depart="6" end="7" number="1"><route edges="b1.b2 b2.b3"/></flow>'
    early = vehicle("early", "b1.b2 b2.b3", 20, depart=2.0)
    file = written(tmp_path / "user", [early, flow], '<time><begin value="5"/></time>')
    with pytest.raises(UserError, match=words):
        run(file, 10.0, name)


def test_a_sentence_lists_a_few_of_many_names(tmp_path):
    cars = [vehicle(f"c{k:03d}", "b1.b2 b2.b3", 20, depart=float(k)) for k in range(60)]
    with pytest.raises(UserError, match=r"declared in none of the files. Known: c000, .*, c023 and 36 more\.$"):
        run(written(tmp_path / "user", cars), 30.0, "zzz")


def test_an_ego_whose_type_decides_less_often_than_each_step_is_told_of(tmp_path):
    file = written(tmp_path / "user", [ego("c3.d3 d3.east3")])
    assert "SUMO's own driver" not in " ".join(summary(run(file, 1.0, "ego"))["notes"])
    cars = file.parent / "cars.rou.xml"
    cars.write_text(cars.read_text().replace('id="mine"', 'id="mine" actionStepLength="1"'), encoding="utf-8")
    assert "SUMO's own driver of its type does so every 1 s" in " ".join(summary(run(file, 1.0, "ego"))["notes"])


@pytest.mark.parametrize(
    ("vehicles", "most"),
    [
        ([ego("b2.c2 c2.c3", 1), *stream("w", "d2.c2 c2.b2", 6)], 0.45),
        ([ego("west1.a1 a1.b1"), vehicle("n", "south_a.a1 a1.a2 a2.a3", 5, depart=1.7)], 1.7),
    ],
)
def test_the_ego_goes_on_as_soon_as_who_crosses_is_past(tmp_path, vehicles, most):
    """Waiting until the other has left the junction costs 0.2 to 0.5 s more."""
    file = written(tmp_path / "user", vehicles)
    own = native_way(file, 100.0).time[-1]
    result = run(file, 100.0, "ego")
    assert result.ended == "arrived", result.reason
    assert result.metrics["run"]["simulated"] < own + most


def test_without_cars_the_end_is_a_sentence_that_names_what_came(tmp_path):
    bus = vehicle("bus", "c3.d3 d3.east3", 20, kind="long")
    with pytest.raises(UserError, match=r"a passenger car of .* was not on the road .* of class bus; --ego takes"):
        run(written(tmp_path / "user", [bus]), 30.0)


def test_a_bus_is_driven_when_it_is_named_with_its_own_size(tmp_path):
    bus = vehicle("bus", "c3.d3 d3.east3", 20, kind="long")
    result = run(written(tmp_path / "user", [bus]), 10.0, "bus")
    assert result.ended == "finished"
    assert "bus is 12 m long and driven as one rigid body, which needs wide bends" in summary(result)["notes"]


def game() -> list[Path]:
    """Configurations that ship with eclipse-sumo, where it is installed."""
    try:
        import sumo
    except ImportError:
        return []
    return sorted((Path(sumo.SUMO_HOME) / "tools" / "game").glob("*.sumocfg"))


@pytest.mark.slow
@pytest.mark.parametrize("file", game(), ids=lambda file: file.stem)
def test_scenarios_of_sumos_own_tools_end_with_a_reason(file, tmp_path):
    import shutil

    shutil.copytree(file.parent, tmp_path / "game")
    before = sorted(path.name for path in (tmp_path / "game").rglob("*"))
    if file.stem.startswith(("rail", "DRT")):  # no cars
        with pytest.raises(UserError, match="was not on the road"):
            run(tmp_path / "game" / file.name, 60.0)
        return
    result = run(tmp_path / "game" / file.name, 60.0)
    assert result.ended in ("arrived", "finished"), result.reason
    assert result.reason
    assert sorted(path.name for path in (tmp_path / "game").rglob("*")) == before
