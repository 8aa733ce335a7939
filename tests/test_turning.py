"""Turning back: where the network turns within a lane's width, the car drives a loop that its steering can."""

from pathlib import Path

import numpy as np
import pytest

from emran_sumo import drive, scenario
from emran_sumo.ego import COLUMNS
from emran_sumo.loop import AT
from emran_sumo.path import first_near, path_from_points
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.world.lanes import dense, joined, smooth_path
from emran_sumo.world.turnaround import turned

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
