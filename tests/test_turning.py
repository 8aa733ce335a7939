"""Turning back: where the network turns within a lane's width, the car drives a loop that its steering can."""

from pathlib import Path

import libsumo
import numpy as np
import pytest

from emran_sumo import drive, scenario
from emran_sumo.ego import COLUMNS
from emran_sumo.loop import AT
from emran_sumo.path import first_near, path_from_points
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.world import turning
from emran_sumo.world.crossings import free_length
from emran_sumo.world.lanes import dense, joined, smooth_path
from emran_sumo.world.records import Traffic
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.turnaround import turned
from emran_sumo.world.turning import Turning

NET = Path(__file__).parent / "data" / "turnarounds.net.xml"
CAR = VehicleParams()
TIGHTEST = (CAR.front_axle + CAR.rear_axle) / np.tan(CAR.steer_limit)  # m, radius of the rear axle


def lanes(apart: float, heading: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A road that ends at the origin, and the lane back, `apart` to its left [m]."""
    out, back = np.array([[-80.0, 0.0], [0.0, 0.0]]), np.array([[0.0, apart], [-80.0, apart]])
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    return tuple(np.column_stack((line @ turn.T, np.zeros(2))) for line in (out, back))  # type: ignore[return-value]


@pytest.mark.parametrize("apart", [2.5, 3.2, 6.4, -3.2])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_a_path_that_turns_back_is_one_that_a_car_can_drive(apart, heading):
    before, after = lanes(apart, heading)
    parts = turned(before, after)
    assert parts is not None
    path = smooth_path(joined([dense(part) for part in parts]))
    assert 1.0 / np.abs(path.curvature).max() > TIGHTEST
    assert np.hypot(path.x[-1] - after[-1, 0], path.y[-1] - after[-1, 1]) < 1.0
    assert path.yaw[-1] - path.yaw[0] == pytest.approx(np.sign(apart) * np.pi, abs=0.05)
    # a half circle between the lanes is tighter than any car: that is why
    assert 0.5 * abs(apart) < TIGHTEST


def test_lanes_far_enough_apart_and_other_turns_keep_the_networks_way():
    assert turned(*lanes(23.0)) is None
    before, _ = lanes(3.2)
    assert turned(before, np.array([[0.0, 4.0, 0.0], [0.0, 80.0, 0.0]])) is None


def test_the_first_passage_in_the_direction_of_travel_is_found_where_a_path_returns():
    """Out along y = 0, back along y = 3, and out along y = 0 again."""
    out = np.arange(0.0, 100.0, 0.5)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 10)[1:-1]
    east = (100.0 + 1.5 * np.cos(angle), 1.5 + 1.5 * np.sin(angle))
    west = (0.0 - 1.5 * np.cos(angle), 1.5 - 1.5 * np.sin(angle))
    x = np.concatenate((out, east[0], 100.0 - out, west[0], out))
    y = np.concatenate((0.0 * out, east[1], 0.0 * out + 3.0, west[1], 0.0 * out))
    path = path_from_points(x, y)
    share = path.spacing / 0.5  # positions of the path count its mean spacing
    assert first_near(path, 40.0, 0.4, 0.1) == pytest.approx(40.0 * share, abs=0.6)
    assert first_near(path, 40.0, 0.4, np.pi) == pytest.approx((100.0 + 4.0 + 60.0) * share, abs=2.0)


def configuration(folder: Path, vehicles: str) -> str:
    folder.mkdir(parents=True)
    (folder / "cars.rou.xml").write_text(f'<routes><vType id="car"/>{vehicles}</routes>', encoding="utf-8")
    inputs = f'<net-file value="{NET}"/><route-files value="cars.rou.xml"/>'
    (folder / "my.sumocfg").write_text(f"<configuration><input>{inputs}</input></configuration>", encoding="utf-8")
    return str(folder / "my.sumocfg")


def car(name: str, edges: str, depart: float) -> str:
    return f'<vehicle id="{name}" type="car" depart="{depart}" departSpeed="10"><route edges="{edges}"/></vehicle>'


def driven(tmp_path: Path, others: str = "", edges: str = "in out") -> drive.RunResult:
    file = configuration(tmp_path / "user", car("ego", edges, 0.0) + others)
    located = scenario.load(file, {"egos.ids": (("ego",), "test"), "duration": (120.0, "test")})
    return drive.run(located, tmp_path / "runs", record=False)


@pytest.mark.parametrize("edges", ["in out", "in on off down"])
def test_an_ego_turns_back_at_a_junction_and_at_the_end_of_a_road_and_arrives(tmp_path, edges):
    result = driven(tmp_path, edges=edges)
    assert result.ended == "arrived", result.reason
    assert np.abs(result.trace[:, AT.cross_track_error]).max() < 0.15
    assert np.abs(result.trace[:, AT.steer]).max() < CAR.steer_limit
    turn = np.unwrap(result.trace[:, AT.yaw])
    assert abs(turn[-1] - turn[0]) > 0.4 * np.pi
    mirrored = result.trace[:, COLUMNS.index("mirror_error")]
    on_loop = np.isnan(mirrored)
    assert 0.02 < on_loop.mean() < 0.5, "SUMO has the ego beside its place on the loop, and nowhere else"
    assert mirrored[~on_loop].max() < 1e-6


def test_an_ego_lets_pass_who_comes_before_it_turns_back(tmp_path):
    """Two cars on the road that the loop crosses, which would meet the ego in it: it waits, and turns behind them."""
    free = driven(tmp_path / "free").trace
    others = "".join(car(f"e{k}", "off out", 6.0 + 3.0 * k) for k in range(4))
    result = driven(tmp_path / "busy", others)
    assert result.ended == "arrived", result.reason
    assert result.trace[-1, AT.time] > free[-1, AT.time] + 3.0


def at_the_line(name: str, edges: str, depart: float) -> str:
    """A car that stands at the end of its first edge and sets off at a time [s]."""
    start = f'id="{name}" type="car" depart="{depart}" departPos="-1" departSpeed="0"'
    return f'<vehicle {start}><route edges="{edges}"/></vehicle>'


@pytest.fixture
def counts(monkeypatch) -> list[tuple[int, int, int]]:
    """Vehicles that are told to be on the road, those that SUMO has there, and phantoms on loops, after each step."""
    found: list[tuple[int, int, int]] = []
    done = SumoWorld.commit

    def commit(world: SumoWorld, poses) -> None:
        done(world, poses)
        assert len(world.present()) == world.vehicle_count()
        found.append((len(world.present()), libsumo.vehicle.getIDCount(), world._turning.phantoms))

    monkeypatch.setattr(SumoWorld, "commit", commit)
    return found


@pytest.mark.parametrize(
    ("edges", "depart"), [("off out", 13.5), ("off down", 12.5), ("up on", 11.5), ("up out", 12.5)]
)
def test_who_sets_off_while_a_loop_is_driven_waits_for_the_ego(tmp_path, counts, edges, depart):
    """A free ego is on its loop from 11 to 17 s; the four ways across it are all that this junction has."""
    result = driven(tmp_path, at_the_line("other", edges, depart))
    assert result.ended == "arrived", result.reason
    seen, in_sumo, phantoms = np.array(counts).T
    assert phantoms.max() >= 4, "one stands in each way"
    assert phantoms[-1] == 0, "and none is left when the loop is driven"
    assert np.array_equal(in_sumo, seen + phantoms)
    assert seen.max() == 2


def test_an_ego_that_nobody_lets_turn_back_closes_the_ways_across_its_loop_for_a_while(tmp_path, counts):
    """A car every 3 s, for 100 s, on the road that the loop crosses: there never are 10 s without one."""
    result = driven(tmp_path, "".join(car(f"e{k}", "off out", 3.0 * k) for k in range(33)))
    assert result.ended == "arrived", result.reason
    assert result.trace[-1, AT.time] < 11.0 + turning.PATIENCE + turning.ASKS + turning.HOLDS
    phantoms = np.array(counts)[:, 2]
    assert 0 < np.count_nonzero(phantoms) * 0.05 < turning.ASKS + turning.HOLDS
    assert phantoms[-1] == 0


@pytest.mark.parametrize("edges", ["in out in down", "in out in out in down", "on off on off out"])
def test_a_route_that_passes_an_edge_again_is_driven_to_its_end(tmp_path, edges):
    result = driven(tmp_path, edges=edges)
    assert result.ended == "arrived", result.reason
    way = np.hypot(*np.diff(result.trace[:, [AT.x, AT.y]], axis=0).T).sum()
    least = 142.8 * len(edges.split()) - 45.0  # "down" has 92.8 m, and the ends count from and to the car
    assert way > least


def test_a_way_is_free_as_far_as_no_body_reaches_into_it():
    """A straight way east; a car of 4 x 2 m across it at 20 m, and one beside it whose side is 1.35 m away."""
    way = np.column_stack((np.arange(0.0, 40.0, 0.5), np.zeros(80)))
    size = np.array([4.0, 4.0]), np.array([2.0, 2.0]), np.array([1.5, 1.5])
    both = Traffic(("across", "beside"), np.array([20.0, 10.0]), np.array([0.0, 2.35]), np.array([np.pi / 2, 0.0]),
                   *size, np.zeros(2))  # fmt: skip
    # from 20 m less half its width, half the ego's and 0.4 m on
    assert free_length(way, 1.8, both) == pytest.approx(20.0 - 1.0 - 0.9 - 0.4, abs=0.5)
    nearer = both._replace(y=np.array([0.0, 1.9]))
    assert free_length(way, 1.8, nearer) < 10.0
    assert free_length(way, 1.8, both._replace(y=np.array([8.0, 8.0]))) == np.inf
    # one that comes is counted where it will be: 10 m/s for 0.7 s
    comes = both._replace(y=np.array([-8.0, 8.0]), speed=np.array([10.0, 0.0]))
    assert free_length(way, 1.8, comes) == pytest.approx(17.7, abs=0.5)


def test_places_on_the_lanes_follow_the_loop_from_its_begin_to_its_end(tmp_path):
    """SUMO has the ego on the lanes that turn back, ever farther along them, whatever way the loop takes."""
    seen: list[tuple[int, float]] = []
    order = ("in_0", ":middle_8_0", ":middle_11_0", "out_0")

    class Noting(Turning):
        def look(self, ego, x, y):
            found = super().look(ego, x, y)
            if found is not None:
                along = [self._map.beside(lane, found.x, found.y) for lane in order]
                k = int(np.argmin([np.hypot(p.x - found.x, p.y - found.y) for p in along]))
                seen.append((k, float(np.hypot(along[k].x - found.x, along[k].y - found.y))))
            return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("emran_sumo.world.sumo.Turning", Noting)
        driven(tmp_path)
    lanes, off = np.array(seen).T
    assert (np.diff(lanes) >= 0).all()
    assert set(lanes) == {0, 1, 2, 3}
    assert off.max() < 0.3
