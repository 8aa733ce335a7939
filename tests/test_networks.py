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
HIGHWAY = ROOT / "networks" / "highway"
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
    return ET.parse(HIGHWAY / "highway.net.xml").getroot()


def shapes(net: ET.Element) -> dict[str, np.ndarray]:
    return {
        lane.get("id", ""): np.array([p.split(",") for p in lane.get("shape", "").split()], dtype=float)
        for lane in net.iter("lane")
    }


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
    line = tool.alignment([(length, 1.0 / radius)])
    s = np.linspace(0.0, length, 33)
    scale = np.sqrt(np.pi * radius * length)
    sine, cosine = special.fresnel(s / scale)
    np.testing.assert_allclose(tool.position(line, s), scale * np.stack((cosine, sine), 1), atol=1e-10)


def test_the_sources_are_what_the_tool_writes(tool: ModuleType, tmp_path: Path):
    tool.write_sources("highway", tmp_path)
    for kind in ("nod", "edg", "con"):
        written, committed = (ET.parse(f / f"highway.{kind}.xml").getroot() for f in (tmp_path, HIGHWAY))
        assert len(written) == len(committed)
        for new, old in zip(written, committed, strict=True):
            for key in set(new.keys()) | set(old.keys()):
                if key in ("shape", "x", "y"):
                    a, b = (np.array(e.get(key, "").replace(",", " ").split(), float) for e in (new, old))
                    np.testing.assert_allclose(a, b, atol=2e-4)
                else:
                    assert new.get(key) == old.get(key)


def test_the_built_network_belongs_to_the_sources(tool: ModuleType, net: ET.Element):
    edges, connections = tool.highway()
    built = {e.get("id"): e for e in net.iter("edge") if e.get("function") != "internal"}
    assert built.keys() == edges.keys()
    for name, edge in edges.items():
        lanes = built[name].findall("lane")
        assert len(lanes) == edge.lanes
        assert {float(lane.get("speed", "nan")) for lane in lanes} == {edge.speed}
        assert {float(lane.get("width", "nan")) for lane in lanes} == {tool.LANE_WIDTH}
        border = np.array([p.split(",") for p in built[name].get("shape", "").split()], float)
        expected = tool.corners(edge.left_border)
        if len(expected) > 2:  # netconvert keeps no shape of a straight edge
            np.testing.assert_allclose(border, expected, atol=1e-4)
    links = {
        (c.get("from"), c.get("to"), int(c.get("fromLane", -1)), int(c.get("toLane", -1)))
        for c in net.iter("connection")
        if not c.get("from", "").startswith(":")
    }
    assert links == set(connections)
    head = (HIGHWAY / "highway.net.xml").read_text(encoding="utf-8")[:2000]
    assert " ".join(tool.OPTIONS).replace("--", "") in head


def test_a_missing_netconvert_is_named_in_one_sentence(tmp_path: Path):
    script = tmp_path / "build_networks"
    script.write_bytes((ROOT / "tools" / "build_networks").read_bytes())
    code = f"import runpy, sys, shutil; sys.executable = '/none'; shutil.which = lambda _: None; \
sys.argv = ['build_networks']; runpy.run_path({str(script)!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "netconvert is missing: install it with `pip install 'eclipse-sumo==1.28.*'`.\n"
