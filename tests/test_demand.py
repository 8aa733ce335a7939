"""Traffic is as dense as asked, starts without overlaps, lets the ego in, and flows on without accidents."""

import gzip
import itertools
import xml.etree.ElementTree as ET
from pathlib import Path

import libsumo
import pytest

from emran_sumo.errors import UserError
from emran_sumo.locate import folder
from emran_sumo.world.demand import TrafficParams, write_demand
from emran_sumo.world.network import main_lanes
from emran_sumo.world.routes import departures

NET = folder("networks") / "highway" / "highway.net.xml"
ROUTES = folder("scenarios") / "highway_dlc" / "highway_dlc.rou.xml"
THROUGH = ("main_in", "merge", "main_mid", "diverge", "main_out")
LIMIT = 22.22
STEP = 0.05
OPTIONS = (
    *("--step-length", str(STEP), "--step-method.ballistic", "true", "--collision.action", "warn"),
    *("--collision.mingap-factor", "0", "--time-to-teleport", "-1", "--no-step-log", "--no-warnings"),
)


def write(folder: Path, seed: int = 1, **keys) -> tuple[Path, int]:
    file = folder / "traffic.rou.xml"
    egos = departures([ROUTES], ["ego"], LIMIT)
    return file, write_demand(file, NET, [ROUTES], TrafficParams(**keys), LIMIT, seed, egos)


def vehicle_types() -> dict[str, ET.Element]:
    return {t.get("id", ""): t for t in ET.parse(ROUTES).getroot().iter("vType")}


def placed(file: Path) -> list[list[tuple[float, float, ET.Element]]]:
    """(front, back, element) of every vehicle by chain of lanes, from the start of the road on [m]."""
    starts = {
        (k, p.lane): (index, p.start)
        for index, chain in enumerate(main_lanes(NET, THROUGH))
        for k, p in enumerate(chain)
    }
    types = vehicle_types()
    lanes: list[list[tuple[float, float, ET.Element]]] = [[], [], []]
    for v in ET.parse(file).getroot().iter("vehicle"):
        index, start = starts[int(v.get("departEdge", -1)), int(v.get("departLane", -1))]
        front = start + float(v.get("departPos", "nan"))
        lanes[index].append((front, front - float(types[v.get("type", "")].get("length", "nan")), v))
    return [sorted(lane, key=lambda item: item[0]) for lane in lanes]


def start(traffic: Path, seed: int) -> None:
    libsumo.start(["sumo", "-n", str(NET), "-r", f"{ROUTES},{traffic}", "--seed", str(seed), *OPTIONS])
    for lane in libsumo.lane.getIDList():
        if "ramp" not in lane:
            libsumo.lane.setMaxSpeed(lane, LIMIT)


@pytest.mark.parametrize("density", [5.0, 15.0, 30.0, 40.0])
def test_after_the_warm_up_the_road_is_as_dense_as_asked_and_drives_safely(tmp_path: Path, density: float):
    file, _ = write(tmp_path, density=density)
    collisions = teleports = hard = 0
    start(file, seed=1)
    try:
        for step in range(int(24.0 / STEP)):
            libsumo.simulationStep()
            collisions += libsumo.simulation.getCollidingVehiclesNumber()
            teleports += libsumo.simulation.getStartingTeleportNumber()
            if step * STEP == 20.0:
                on_main = [e for e in libsumo.edge.getIDList() if "ramp" not in e]
                count = sum(libsumo.edge.getLastStepVehicleNumber(e) for e in on_main)
            if step * STEP >= 20.0 and step % 10 == 0:  # harder than the types' own decel of 4.5 m/s2
                hard += sum(libsumo.vehicle.getAcceleration(v) < -4.6 for v in libsumo.vehicle.getIDList())
    finally:
        libsumo.close()
    assert (collisions, teleports, hard) == (0, 0, 0)
    assert count / (3 * 5.0) == pytest.approx(density, rel=0.10)


def test_the_ego_enters_in_the_first_step_whatever_the_seed(tmp_path: Path):
    for seed in range(10):
        file, _ = write(tmp_path, seed=seed, density=40.0)
        start(file, seed)
        try:
            libsumo.simulationStep()
            assert "ego" in libsumo.vehicle.getIDList(), seed
            assert libsumo.vehicle.getSpeed("ego") > 19.0
        finally:
            libsumo.close()


@pytest.mark.parametrize("density", [1.0, 15.0, 45.0, 80.0])
def test_nobody_overlaps_and_everybody_could_stop_behind_the_one_ahead(tmp_path: Path, density: float):
    types = vehicle_types()
    for seed in range(5):
        for lane in placed(write(tmp_path, seed=seed, density=density)[0]):
            for (front, back, v), (_, back_ahead, ahead) in itertools.pairwise(lane):
                kind = types[v.get("type", "")]
                gap = back_ahead - front
                assert gap > float(kind.get("minGap", "nan")) - 0.02
                assert back > -0.02
                b, tau = float(kind.get("decel", "nan")), float(kind.get("tau", "nan"))
                speed, speed_ahead = (float(x.get("departSpeed", "nan")) for x in (v, ahead))
                assert tau * speed + speed**2 / (2 * b) < gap + speed_ahead**2 / (2 * b) + 0.1


def test_nobody_starts_faster_than_its_own_wish_under_the_limit(tmp_path: Path):
    for lane in placed(write(tmp_path, density=10.0)[0]):
        for _, _, v in lane:
            speed = float(v.get("departSpeed", "nan"))
            assert 0.5 * LIMIT < speed <= float(v.get("speedFactor", "nan")) * LIMIT + 0.01


def test_the_number_of_vehicles_is_density_times_lane_kilometers(tmp_path: Path):
    """In the lanes without the ego; at most one vehicle more or two less, at the ends of the road."""
    for density in (5.0, 20.3, 60.0):
        for seed in range(5):
            file, count = write(tmp_path, seed=seed, density=density)
            lanes = placed(file)
            assert sum(map(len, lanes)) == count
            for lane in (lanes[0], lanes[2]):
                assert -2.0 <= len(lane) - density * 5.0 <= 1.0


def test_the_lane_of_the_ego_is_free_around_it(tmp_path: Path):
    for seed in range(10):
        lane = placed(write(tmp_path, seed=seed, density=40.0, gap_ego=60.0)[0])[1]
        assert not [1 for front, back, _ in lane if back < 700.0 + 60.0 and front > 700.0 - 4.7 - 60.0]


def test_the_mix_is_the_distribution_and_trucks_keep_off_the_left_lane(tmp_path: Path):
    types = vehicle_types()
    heavy = total = 0
    for seed in range(5):
        lanes = placed(write(tmp_path, seed=seed, density=40.0)[0])
        trucks = [sum(types[v.get("type", "")].get("vClass") != "passenger" for *_, v in lane) for lane in lanes]
        assert trucks[0] > trucks[1] > trucks[2] == 0
        heavy += sum(trucks)
        total += sum(map(len, lanes))
    assert heavy / total == pytest.approx(0.15, abs=0.02)  # 0.15 +- 0.0065 (one sigma) for 3000 draws


def test_only_vehicles_well_before_the_exit_take_it(tmp_path: Path):
    file, _ = write(tmp_path, density=40.0, share_exit=0.5)
    lanes = placed(file)
    for index, lane in enumerate(lanes):
        leaving = [front for front, _, v in lane if v.get("route") == "exit"]
        staying = [front for front, _, v in lane if v.get("route") == "through"]
        assert max(leaving) < 4080.0 - 300.0 * (index + 1)
        assert max(staying) > 4400.0
        upstream = sum(f < 3000.0 for f in leaving) / sum(f < 3000.0 for f in leaving + staying)
        assert upstream == pytest.approx(0.5, abs=0.2)


def test_the_flows_carry_what_the_moving_density_carries_away(tmp_path: Path):
    file, _ = write(tmp_path, density=15.0, share_exit=0.1, share_enter=0.2)
    rates: dict[str, float] = {}
    for flow in ET.parse(file).getroot().iter("flow"):
        route = flow.get("route", "")
        period = flow.get("period", "")
        rates[route] = rates.get(route, 0.0) + float(period.removeprefix("exp(").removesuffix(")"))
    # mean of speed factors weighted by the mix of the route file, all vehicles able to drive the limit
    factor = 0.25 * 1.0 + 0.40 * 1.02 + 0.20 * 1.03 + 0.07 * 0.96 + 0.08 * 0.95
    main = 0.015 * 3 * LIMIT * factor
    assert rates == pytest.approx({"through": 0.9 * main, "exit": 0.1 * main, "enter": 0.2 * main}, rel=1e-4)


def test_density_zero_leaves_the_road_empty(tmp_path: Path):
    file, count = write(tmp_path, density=0.0)
    assert count == 0
    assert len(ET.parse(file).getroot()) == 0


def test_the_seed_decides_everything(tmp_path: Path):
    texts = [write(tmp_path, seed=seed)[0].read_text() for seed in (3, 3, 4)]
    assert texts[0] == texts[1] != texts[2]


def test_a_packed_network_gives_the_same_traffic(tmp_path: Path):
    packed = tmp_path / "highway.net.xml.gz"
    packed.write_bytes(gzip.compress(NET.read_bytes()))
    assert main_lanes(packed, THROUGH) == main_lanes(NET, THROUGH)


def test_the_main_lanes_are_five_kilometers_long_and_shift_by_one_beside_a_fourth_lane():
    for index, chain in enumerate(main_lanes(NET, THROUGH)):
        assert [(p.edge, p.lane) for p in chain] == [(e, index + (e in ("merge", "diverge"))) for e in THROUGH]
        assert chain[-1].start + chain[-1].length == pytest.approx(5000.0, rel=1e-3)


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"type": "nobody"}, 'found "nobody", which no route file declares'),
        ({"through": "nowhere"}, 'found the route "nowhere", which no route file declares'),
        ({"enter": "nowhere"}, 'found the route "nowhere", which no route file declares'),
        ({"density": 400.0}, "400 vehicles/km/lane of these lengths do not fit on the road"),
    ],
)
def test_what_cannot_be_is_said_in_a_sentence(tmp_path: Path, keys: dict, sentence: str):
    with pytest.raises((ValueError, UserError), match=sentence):
        write(tmp_path, **keys)


def test_departures_are_read_from_the_route_file(tmp_path: Path):
    assert departures([ROUTES], ["ego"], LIMIT) == (("main_in", 1, 700.0, 20.0, 4.7),)
    other = tmp_path / "other.rou.xml"
    other.write_text(
        '<routes><vehicle id="late" depart="5"/>'
        '<vehicle id="vague" depart="0" departLane="best"><route edges="a b"/></vehicle></routes>'
    )
    assert departures([other], ["late"], LIMIT) == ()
    with pytest.raises(ValueError, match=r"^vehicle 'vague' needs numbers as departLane and departPos$"):
        departures([other], ["vague"], LIMIT)
    with pytest.raises(ValueError, match=r"^vehicle 'ghost' is in none of the route files$"):
        departures([other], ["ghost"], LIMIT)
