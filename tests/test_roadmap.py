"""Paths on networks as they come: jumps at junctions become lane changes, turns stay turns, lanes are kept."""

import libsumo
import numpy as np
import pytest

from emran_sumo import locate
from emran_sumo.world import wishes
from emran_sumo.world.lanes import LANE_TOLERANCE, joined, loosened, shift_between, smooth_path, speed_cap
from emran_sumo.world.lanes import dense as with_points
from emran_sumo.world.session import scenario_options
from emran_sumo.world.sumo import SumoWorld


def straight(x0: float, x1: float, y: float) -> np.ndarray:
    return np.array([[x0, y, 0.0], [x1, y, 0.0]])


@pytest.mark.parametrize("height", [1.0, -2.5, 3.2])
def test_a_lane_that_goes_on_beside_its_end_is_reached_like_a_lane_change(height):
    """A quintic of height h at v with 2 m/s2 has the length L = v sqrt(5.77 h / 2)."""
    speed = 27.8
    before, after = straight(0.0, 300.0, 0.0), straight(304.0, 600.0, height)
    assert shift_between(before, after) == pytest.approx(height)
    kink = joined([with_points(before), with_points(after)])
    smooth = smooth_path(loosened(kink, np.array([302.0, 0.5 * height]), height, speed))
    assert (smooth.curvature**2).max() * speed**4 < 4.0**2  # m/s2 squared
    assert (smooth_path(kink).curvature ** 2).max() * speed**4 > 10.0**2, "else there is nothing to smooth"
    length = speed * np.sqrt(5.77 * abs(height) / 2.0)
    far = np.abs(smooth.x - 302.0) > 0.5 * length + 4.0
    lane = np.where(smooth.x < 302.0, 0.0, height)
    assert np.abs(smooth.y - lane)[far].max() <= LANE_TOLERANCE + 0.05


def test_a_turn_is_no_shift():
    north = np.array([[304.0, 4.0, 0.0], [304.0, 100.0, 0.0]])
    assert shift_between(straight(0.0, 300.0, 0.0), north) == 0.0


def test_points_are_no_more_than_two_meters_apart_and_keep_the_line():
    line = np.array([[0.0, 0.0, 1.0], [70.0, 0.0, 2.0], [70.0, 3.0, 2.0]])
    points = with_points(line)
    assert np.hypot(*np.diff(points[:, :2], axis=0).T).max() <= 2.0 + 1e-9
    for corner in line:
        assert np.isclose(points, corner).all(axis=1).any()
    np.testing.assert_allclose(points[points[:, 1] == 0.0, 2], 1.0 + points[points[:, 1] == 0.0, 0] / 70.0)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory):
    routes = tmp_path_factory.mktemp("blocks") / "none.rou.xml"
    routes.write_text("<routes/>", encoding="utf-8")
    network = locate.folder("networks") / "urban" / "urban.net.xml"
    with SumoWorld(scenario_options(network, [routes], [], 0.0), 0.1, 1) as world:
        yield world


ROUTE = ("west1.a1", "a1.b1", "b1.b2", "b2.c2", "c2.c3", "c3.d3", "d3.east3")


def test_a_path_stays_near_the_lanes_outside_junctions_and_turns_within_what_a_car_can(blocks):
    path = blocks.map.path("west1.a1_0", ROUTE, 0)
    assert np.abs(path.curvature).max() < 1.0 / 5.5
    # from b2 to c2 the right turn leads into the right lane, from which no way leads to the left
    for lane in ("west1.a1_0", "a1.b1_0", "b1.b2_0", "b2.c2_0"):
        points = with_points(blocks.map.shape(lane))[1:-1]
        distance = np.array([np.hypot(path.x - x, path.y - y).min() for x, y, _ in points])
        assert distance.max() < 0.3 + 0.5 * path.spacing, lane


def test_a_turn_has_the_speed_that_its_radius_allows(blocks):
    path = blocks.map.path("west1.a1_0", ROUTE, 0)
    cap = speed_cap(path, 3.0, 2.0)
    assert 4.0 < cap.min() < 8.0  # the tightest lane has 8.3 m
    assert (np.diff(cap**2) >= -2.0 * 2.0 * path.spacing - 1e-9).all(), "it can be braked down to"


def test_the_chain_from_the_wrong_lane_ends_where_the_lane_does(blocks):
    wrong = blocks.map.path("b2.c2_0", ROUTE[3:], 0)
    right = blocks.map.path("b2.c2_1", ROUTE[3:], 0)
    assert right.x.size > wrong.x.size


def test_neighbors_are_on_the_same_edge(blocks):
    assert blocks.map.neighbor("b2.c2_0", 1) == "b2.c2_1"
    assert blocks.map.neighbor("b2.c2_0", -1) is None
    assert blocks.map.neighbor("b2.c2_1", 1) is None


def test_a_path_from_inside_a_junction_begins_on_the_edge_before_it(blocks):
    whole = blocks.map.path("a1.b1_0", ROUTE, 1)
    inside = next(link[4] for link in libsumo.lane.getLinks("a1.b1_0") if link[0].startswith("b1.b2"))
    path = blocks.map.path(inside, ROUTE, 1)
    x, y, _ = blocks.map.shape("a1.b1_0")[-1]
    assert np.hypot(path.x - x, path.y - y).argmin() * path.spacing > 50.0, "the lane before the junction"
    there = np.hypot(whole.x[:, None] - path.x[::40], whole.y[:, None] - path.y[::40]).min(axis=0)
    assert there.max() < 0.2, "and the same way as from that lane"


@pytest.mark.parametrize(
    ("wished_on", "lane", "side", "meant"),
    [
        ("a2.b2_0", "a2.b2_0", 1, "a2.b2_1"),
        ("a2.b2_0", "a2.b2_1", 1, ""),  # SUMO has it there by now
        ("a2.b2_1", "a2.b2_0", 1, ""),  # no lane on the left of the one it was read on
        ("b2.c2_0", "a2.b2_0", 1, "a2.b2_1"),  # read on another edge: counts from where the ego is
        (":a1_0_0", ":a1_0_0", 1, ""),
    ],
)
def test_a_wish_is_for_the_lane_beside_the_one_it_was_read_on(blocks, wished_on, lane, side, meant):
    assert libsumo.edge.getLaneNumber("a2.b2") == 2
    assert wishes.meant(blocks.map, wished_on, lane, side) == meant
