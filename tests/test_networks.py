"""The shipped networks: smooth enough to be driven by a vehicle that feels lateral acceleration."""

import importlib.machinery
import importlib.util
import itertools
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
NETWORKS = ROOT / "networks"
DESCRIBED = ("highway", "hills", "curves", "bridge", "urban")
SHIPPED = (*DESCRIBED, "town")
# chords of 15 m on an arc of 700 m, and a little for rounding
VERTEX_TURN = np.degrees(15.0 / 700.0) + 0.07
MAIN = ("main_in", "merge", "main_mid", "diverge", "main_out")


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("build_networks", str(ROOT / "tools" / "build_networks"))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def net() -> ET.Element:
    return read("highway")


@pytest.fixture(scope="module")
def net_of_hills() -> ET.Element:
    return read("hills")


def read(name: str) -> ET.Element:
    return ET.parse(NETWORKS / name / f"{name}.net.xml").getroot()


def points(element: ET.Element) -> np.ndarray:
    return np.array([p.split(",") for p in element.get("shape", "").split()], dtype=float)


def lane_of(net: ET.Element, name: str) -> ET.Element:
    return next(lane for lane in net.iter("lane") if lane.get("id") == name)


def tightest(line: np.ndarray) -> float:
    """Smallest radius [m] of a polyline: length over turn at its vertices."""
    length = np.hypot(*np.diff(line[:, :2], axis=0).T)
    turn = np.abs(np.diff(headings(line)))
    return float(np.min(0.5 * (length[1:] + length[:-1]) / np.maximum(turn, 1e-9)))


def shapes(net: ET.Element) -> dict[str, np.ndarray]:
    return {lane.get("id", ""): points(lane) for lane in net.iter("lane")}


def walk(net: ET.Element, edge: str, lane: int) -> list[str]:
    """Lane ids along the main line from a lane of `edge`, the internal ones included."""
    follow = {
        (c.get("from"), c.get("fromLane")): (c.get("to"), c.get("toLane"), c.get("via"))
        for c in net.iter("connection")
        if c.get("to") in MAIN
    }
    chain = [f"{edge}_{lane}"]
    key = (edge, str(lane))
    while key in follow:
        to, to_lane, via = follow[key]
        chain += [*([via] if via else []), f"{to}_{to_lane}"]
        key = (to, to_lane)
    return [c for c in chain if c]


def headings(points: np.ndarray) -> np.ndarray:
    d = np.diff(points, axis=0)
    return np.unwrap(np.arctan2(d[:, 1], d[:, 0]))


@pytest.mark.parametrize("lane", [0, 1, 2])
def test_the_main_lanes_run_straight_across_every_node(net: ET.Element, lane: int):
    chain = walk(net, "main_in", lane)
    assert [c for c in chain if c[0] != ":"] == [f"{edge}_{lane + (edge in ('merge', 'diverge'))}" for edge in MAIN]
    assert len(chain) == 2 * len(MAIN) - 1  # one internal lane at each node
    shape = shapes(net)
    for before, after in itertools.pairwise(chain):
        gap = np.hypot(*(shape[after][0] - shape[before][-1]))
        turn = headings(shape[after])[0] - headings(shape[before])[-1]
        assert gap < 0.05, (before, after)
        assert abs(np.degrees(turn)) < 0.5, (before, after)


@pytest.mark.parametrize(
    ("before", "via", "after"),
    [("on_ramp_0", ":merge_start_0_0", "merge_0"), ("diverge_0", ":diverge_end_0_0", "off_ramp_0")],
)
def test_the_ramps_meet_their_lane_without_kink_or_sideways_jump(net: ET.Element, before: str, via: str, after: str):
    shape = shapes(net)
    for a, b in ((before, via), (via, after)):
        assert np.hypot(*(shape[b][0] - shape[a][-1])) < 0.05
        assert abs(np.degrees(headings(shape[b])[0] - headings(shape[a])[-1])) < VERTEX_TURN


@pytest.mark.parametrize("lane", [0, 1, 2])
def test_no_main_lane_bends_at_a_vertex_by_more_than_its_sampled_arc_does(net: ET.Element, lane: int):
    shape = shapes(net)
    points = np.concatenate([shape[c] for c in walk(net, "main_in", lane)])
    points = points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-3]]
    assert np.degrees(np.abs(np.diff(headings(points)))).max() < VERTEX_TURN
    length = np.hypot(*np.diff(points, axis=0).T).sum()
    assert length == pytest.approx(5000.0, rel=0.005)


def test_the_center_line_never_bends_more_than_one_per_600_meters(net: ET.Element):
    """Curvature of the circle through three points 30 m apart, which rounding to 0.1 mm moves by 1e-6 / m."""
    shape = shapes(net)
    points = np.concatenate([shape[c] for c in walk(net, "main_in", 1)])
    points = points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-3]]
    s = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    grid = np.arange(0.0, s[-1], 30.0)
    a, b, c = (np.stack([np.interp(grid + d, s, points[:, k]) for k in (0, 1)], 1)[:-3] for d in (0, 30, 60))
    u, v, w = b - a, c - b, c - a
    curvature = 2.0 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    curvature /= np.hypot(*u.T) * np.hypot(*v.T) * np.hypot(*w.T)
    assert np.abs(curvature).max() < 1.0 / 600.0
    assert curvature.max() > 1.0 / 1000.0  # and it does bend, to both sides
    assert curvature.min() < -1.0 / 1000.0


def test_a_clothoid_of_the_tool_agrees_with_the_fresnel_integrals(tool: ModuleType):
    special = pytest.importorskip("scipy.special")
    radius, length = 800.0, 160.0
    line = tool.geometry.alignment([(length, 1.0 / radius)])
    s = np.linspace(0.0, length, 33)
    scale = np.sqrt(np.pi * radius * length)
    sine, cosine = special.fresnel(s / scale)
    np.testing.assert_allclose(tool.geometry.position(line, s), scale * np.stack((cosine, sine), 1), atol=1e-10)


@pytest.mark.parametrize("name", DESCRIBED)
def test_the_sources_are_what_the_tool_writes(tool: ModuleType, tmp_path: Path, name: str):
    for file in tool.write_sources(name, tmp_path):
        written, committed = (ET.parse(f / file).getroot() for f in (tmp_path, NETWORKS / name))
        assert len(written) == len(committed)
        for new, old in zip(written, committed, strict=True):
            for key in set(new.keys()) | set(old.keys()):
                if key in ("shape", "x", "y", "z"):
                    a, b = (np.array(e.get(key, "").replace(",", " ").split(), float) for e in (new, old))
                    np.testing.assert_allclose(a, b, atol=2e-4)
                else:
                    assert new.get(key) == old.get(key)


@pytest.mark.parametrize("name", DESCRIBED)
def test_the_built_network_belongs_to_the_sources(tool: ModuleType, name: str):
    network, net = tool.NETWORKS[name](), read(name)
    built = {e.get("id"): e for e in net.iter("edge") if e.get("function") != "internal"}
    assert built.keys() == network.edges.keys()
    for edge_id, edge in network.edges.items():
        lanes = built[edge_id].findall("lane")
        assert len(lanes) == edge.lanes
        assert {float(lane.get("speed", "nan")) for lane in lanes} == {edge.speed}
        assert {float(lane.get("width", "nan")) for lane in lanes} == {edge.width}
        expected = tool.geometry.corners(edge.left_border)
        if len(expected) > 2:  # netconvert keeps no shape of a straight edge
            np.testing.assert_allclose(points(built[edge_id]), expected, atol=1e-4)
    if network.connections is not None:
        links = {
            (c.get("from"), c.get("to"), int(c.get("fromLane", -1)), int(c.get("toLane", -1)))
            for c in net.iter("connection")
            if not c.get("from", "").startswith(":")
        }
        assert links == set(network.connections)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_network_is_small_near_the_origin_and_tells_how_it_was_built(tool: ModuleType, name: str):
    file = NETWORKS / name / f"{name}.net.xml"
    assert file.stat().st_size < 400_000
    options = tool.GENERATED[name] if name in tool.GENERATED else tool.NETWORKS[name]().options
    text = file.read_text(encoding="utf-8")
    assert " ".join(options).replace("--", "") in text[:2000]
    boundary = read(name).find("location").get("convBoundary", "")  # type: ignore[union-attr]
    assert max(abs(float(v)) for v in boundary.split(",")) < 6000.0
    words = " ".join((NETWORKS / name / "README.md").read_text(encoding="utf-8").split())
    assert "made for this project" in words or "as netgenerate draws it" in words


def test_the_hills_have_grades_of_three_to_six_percent_and_no_edge_between_them(net_of_hills: ET.Element):
    shape = shapes(net_of_hills)
    line = np.concatenate([shape["fast_1"], shape["slow_1"]])
    # netconvert cuts 0.3 m out at the node, with heights that are 1 mm wrong: 0.3 % of grade there
    line = line[np.r_[True, np.hypot(*np.diff(line[:, :2], axis=0).T) > 1.0]]
    run = np.hypot(*np.diff(line[:, :2], axis=0).T)
    grade = np.diff(line[:, 2]) / run
    assert 0.04 < grade.max() < 0.06
    assert -0.06 < grade.min() < -0.04
    assert np.sum(np.diff(np.sign(grade[np.abs(grade) > 0.02])) != 0) == 3  # up, down, up, down
    # a parabola of radius R turns by (distance between the middles of two chords) / R
    assert np.max(np.abs(np.diff(grade)) / (0.5 * (run[1:] + run[:-1]))) < 1.0 / 5000.0
    limits = {edge: float(lane_of(net_of_hills, f"{edge}_0").get("speed", "nan")) for edge in ("fast", "slow")}
    assert limits == {"fast": 28.0, "slow": 25.0}


def test_the_hills_run_on_where_the_limit_changes(net_of_hills: ET.Element):
    shape = shapes(net_of_hills)
    for lane in range(3):
        before, after = shape[f"fast_{lane}"], shape[f"slow_{lane}"]
        gap = after[0] - before[-1]
        assert np.hypot(*gap[:2]) < 0.5
        assert abs(gap[2]) < 0.03
        assert abs(np.degrees(headings(after)[0] - headings(before)[-1])) < 1.0


def test_the_country_road_bends_at_most_as_its_tightest_curve(tool: ModuleType):
    """The lane inside the curve of 60 m lies half a lane nearer to its center, that outside as far away from it."""
    shape = shapes(read("curves"))
    for lane, radius in (("east_0", 60.0 - 1.75), ("west_0", 60.0 + 1.75)):
        assert tightest(shape[lane]) == pytest.approx(radius, rel=0.01), lane
        assert np.degrees(np.abs(np.diff(headings(shape[lane]))).max()) < 2.6
    assert headings(tool.NETWORKS["curves"]().edges["east"].left_border).max() < np.pi / 2  # never turns back


def test_the_bridge_is_straight():
    for shape in shapes(read("bridge")).values():
        assert np.ptp(shape[:, 1]) == 0.0


@pytest.mark.parametrize(("name", "least"), [("urban", 8.0), ("town", 6.5)])
def test_a_car_can_drive_every_turn(name: str, least: float):
    """A car with a wheelbase of 2.7 m that steers by 30 degrees runs on a circle of 4.7 m."""
    found = [tightest(line) for lane, line in shapes(read(name)).items() if lane[0] == ":" and len(line) > 2]
    assert len(found) > 100
    assert min(found) > least


def test_the_streets_have_lights_main_roads_and_turns_against_oncoming_traffic():
    net = read("urban")
    kinds = [j.get("type") for j in net.iter("junction") if not j.get("id", "").startswith(":")]
    assert kinds.count("traffic_light") == 2
    assert kinds.count("priority") == 10
    assert {logic.get("type") for logic in net.iter("tlLogic")} == {"static", "actuated"}
    left = next(c for c in net.iter("connection") if c.get("from") == "b2.c2" and c.get("to") == "c2.c3")
    state = "".join(p.get("state", "")[int(left.get("linkIndex", -1))] for p in net.iter("phase"))
    assert left.get("dir") == "l"
    assert "g" in state  # green, but others go first


def test_the_town_has_dozens_of_junctions_and_some_lights():
    kinds = [j.get("type") for j in read("town").iter("junction") if not j.get("id", "").startswith(":")]
    inner = len(kinds) - kinds.count("dead_end")
    assert 40 <= inner <= 80
    assert kinds.count("traffic_light") == 20


def test_the_committed_files_are_what_the_tools_of_sumo_build():
    if importlib.util.find_spec("sumo") is None or not (Path(sys.executable).parent / "netconvert").exists():
        pytest.skip("needs eclipse-sumo")
    command = [sys.executable, str(ROOT / "tools" / "build_networks"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_missing_netconvert_is_named_in_one_sentence(tmp_path: Path):
    for file in ("build_networks", *(f.name for f in (ROOT / "tools").glob("networks_*.py"))):
        (tmp_path / file).write_bytes((ROOT / "tools" / file).read_bytes())
    script = tmp_path / "build_networks"
    code = f"import runpy, sys, shutil; sys.executable = '/none'; shutil.which = lambda _: None; \
sys.argv = ['build_networks']; runpy.run_path({str(script)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "netconvert is missing: install it with `pip install 'eclipse-sumo==1.28.*'`.\n"
