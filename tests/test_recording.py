"""The files of a run: what the viewer opens, what a reader reads back, what a crash leaves."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
import tracemalloc
from contextlib import contextmanager
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli
from PIL import Image
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning
from rerun.experimental import ViewerClient

from emran_sumo import report
from emran_sumo.control.emran import LEARNED, NEURONS, SAMPLES, EmranParams, blank_memory
from emran_sumo.drive import run as drive_scenario
from emran_sumo.path import Path as Line
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.recording import colors, plots, road
from emran_sumo.recording.car import EgoShape
from emran_sumo.recording.insight import Insight, insight
from emran_sumo.recording.layout import FORCES, LETTERS, SPACE_SPEED, SPACE_STEERING, TABS
from emran_sumo.recording.recorder import Recorder
from emran_sumo.recording.surroundings import Patch, patch_on
from emran_sumo.recording.table import read_trace, read_units, write_trace
from emran_sumo.recording.watch import Limits, Watch
from emran_sumo.scenario import load
from emran_sumo.world.records import Lane, Road, StopLine, Traffic

RERUN = str(Path(rerun_cli.__file__).parent / "rerun")  # the binary itself; `rerun` on PATH is a wrapper
QUIET = {**os.environ, "CI": "1"}
EGO = EgoShape(length=4.8, width=1.85, height=1.5, wheelbase=2.7, front_axle=1.3, front_overhang=0.9)
COLUMNS = """
    time x y yaw speed_long speed_lat yaw_rate accel_long accel_lat steer steer_command steer_law
    steer_network
    accel_command accel_law accel_network torque slip_ratio_front slip_ratio_rear slip_angle_front
    slip_angle_rear load_front load_rear friction friction_use_front friction_use_rear speed_reference
    speed_error reference_yaw cross_track_error heading_error neurons_speed neurons_steering signal_speed
    signal_steering learned_speed learned_steering grown_speed grown_steering pruned_speed pruned_steering
    merged_speed merged_steering force_long_front force_long_rear force_lat_front force_lat_rear grade
    force_external_lat lead_gap time_to_collision deceleration_to_avoid
""".split()  # noqa: SIM905

# The road: a highway bending left, and a street with a concave junction at its end.
LANES, WIDTH, BEND = 3, 3.5, 900.0


def on_highway(s, left):
    """Pose at arc length `s` [m] along the highway's middle, `left` [m] of it."""
    yaw = np.asarray(s) / BEND
    return (BEND - left) * np.sin(yaw), BEND - (BEND - left) * np.cos(yaw), yaw


STOPS = (
    StopLine(np.array([(-1.75, 390.0), (1.75, 390.0)]), True),
    StopLine(np.array([(1.75, 410.0), (-1.75, 410.0)]), True),
    StopLine(np.array([(7.0, 390.0), (7.0, 410.0)]), False),
)
LIMITS = Limits(steer=0.6, steer_rate=0.8, accel=4.0, decel=9.0)
PATCH = Patch(np.column_stack((np.linspace(100.0, 140.0, 21), np.zeros(21))), 3.5, 0.5)


def small_road() -> Road:
    s = np.linspace(-400.0, 2600.0, 301)
    lanes = []
    for index in range(LANES):
        x, y, _ = on_highway(s, (index - 1) * WIDTH)
        shape = np.column_stack((x, y, np.zeros_like(x)))
        lanes.append(Lane(f"highway_{index}", "highway", index, LANES, WIDTH, shape))
    crossing = np.array([(-7.0, 390.0), (7.0, 390.0), (7.0, 410.0), (0.0, 402.0), (-7.0, 410.0)])
    shape = np.array([(0.0, 20.0, 0.0), (0.0, 390.0, 0.0)])
    lanes.append(Lane("street_0", "street", 0, 1, WIDTH, shape))
    return Road(tuple(lanes), (crossing,), STOPS)


def smooth_step(t, start, duration):
    p = np.clip((t - start) / duration, 0.0, 1.0)
    return p * p * (3 - 2 * p)


def ego_trace(seconds: float, seed: int = 0) -> np.ndarray:
    """A drive with two lane changes and a braking; smooth motion plus measured noise, every column filled."""
    rng = np.random.default_rng(seed)
    t = np.arange(1, round(seconds * 100) + 1) / 100.0
    n = len(t)
    reference = 26.0 + 4 * smooth_step(t, 5, 6) - 8 * smooth_step(t, 30, 8)
    lag = np.exp(-np.arange(300) / 60.0)
    speed = np.convolve(np.r_[np.full(299, reference[0]), reference], lag / lag.sum(), "valid")
    s = np.cumsum(speed) / 100.0
    wish = WIDTH * (smooth_step(t, 12, 4.5) - smooth_step(t, 40, 4.5))
    error = np.convolve(rng.normal(size=n + 149), np.hanning(150) / 40, "valid") * 0.08
    x, y, road_yaw = on_highway(s, wish - error)
    yaw = road_yaw + np.gradient(wish - error, s)
    noise = {c: np.convolve(rng.normal(size=n + 29), np.hanning(30) / 15, "valid") for c in COLUMNS}
    accel, rate = np.gradient(speed, 0.01), np.gradient(yaw, 0.01)
    steer = 2.7 * rate / speed + 0.002 * noise["steer"]
    share = smooth_step(t, 3, 20) * 0.7
    neurons = np.minimum(np.floor(t / 3), 9)
    values = {
        "time": t, "x": x, "y": y, "yaw": yaw, "speed_long": speed, "yaw_rate": rate, "accel_long": accel,
        "accel_lat": speed * rate, "steer": steer, "steer_command": steer + 0.0005 * noise["steer_command"],
        "steer_law": steer * (1 - share), "steer_network": steer * share, "accel_command": accel,
        "accel_law": accel * (1 - share), "accel_network": accel * share,
        "torque": 1500 * 0.32 * accel - 600.0 * ((t > 14) & (t <= 15)),
        "speed_reference": reference, "speed_error": reference - speed, "reference_yaw": road_yaw,
        "cross_track_error": error, "heading_error": road_yaw - yaw, "neurons_steering": neurons,
        "load_front": 7600 - 300 * accel, "load_rear": 7100 + 300 * accel, "neurons_speed": neurons // 2,
        "learned_speed": np.floor(t * 40), "learned_steering": np.floor(t * 55), "grown_steering": neurons,
        "grown_speed": neurons // 2, "friction": np.where((t > 7) & (t <= 9), 0.5, 0.9),
        "force_external_lat": np.where((t > 10) & (t <= 12), -2500.0, 0.0), "grade": 0.02 * np.sin(t / 5),
        "force_long_front": 1500 * accel, "force_lat_front": 700 * speed * rate, "force_lat_rear": 600 * speed * rate,
        "time_to_collision": np.where(t % 4 < 1, 3.0, np.inf), "lead_gap": np.where(t > 2, 40.0, np.inf),
    }  # fmt: skip
    for column in COLUMNS:
        if column.startswith(("pruned", "merged")):
            values[column] = np.floor(t / 25)
        values.setdefault(column, 0.02 * noise[column] + 0.05)
    return np.column_stack([values[column] for column in COLUMNS])


def no_path() -> np.ndarray:
    """Nothing ahead."""
    return np.zeros((0, 2))


def traffic_at(t: float, vehicles: int) -> Traffic:
    """Cars and trucks in three lanes, each with a speed that swings slowly about its lane's."""
    i = np.arange(vehicles)
    lane = i % LANES
    phase = 2.0 * np.pi * (i * 0.618 % 1.0)
    mean = 20.0 + 5.0 * lane
    s = -150.0 + 1200.0 * (i * 0.7548 % 1.0) + mean * t + 4.0 / 0.2 * np.sin(0.2 * t + phase)
    x, y, yaw = on_highway(s, (lane - 1) * WIDTH)
    truck = (lane == 0) & (i % 2 == 0)
    return Traffic(
        tuple(f"v{k}" for k in i),
        x,
        y,
        yaw,
        np.where(truck, 12.0, 4.6),
        np.where(truck, 2.5, 1.8),
        np.where(truck, 3.6, 1.5),
        mean + 4.0 * np.cos(0.2 * t + phase),
    )


def path_ahead(row: np.ndarray) -> np.ndarray:
    x, y = row[COLUMNS.index("x")], row[COLUMNS.index("y")]
    s, left = BEND * np.arctan2(x, BEND - y), BEND - np.hypot(x, BEND - y)
    x, y, _ = on_highway(s + np.linspace(0.0, 75.0, 40), np.round(left / WIDTH) * WIDTH)
    return np.column_stack((x, y))


def open_recorder(file: Path, **changes) -> Recorder:
    given = {"recording": "drive-1", "name": "A drive", "road": small_road(), "ego": EGO, "columns": COLUMNS}
    given |= {"limits": LIMITS}
    return Recorder(file, **{**given, **changes})


STATES = {  # by row of the trace
    300: [("learning", "learning")],
    1000: [("maneuver", "waiting for a gap")],
    1200: [("maneuver", "change left")],
    1650: [("maneuver", "keep lane")],
    4000: [("maneuver", "change right"), ("learning", "settled")],
    4450: [("maneuver", "keep lane")],
}


SIGNALS = {0.05: "rG", 6.0: "ry", 9.0: "Gr"}


def network_at(t: float) -> Insight:
    """One neuron more every 2 s, up to 4; the car moves along the first input."""
    n = min(int(t / 2), 4)
    memory = blank_memory(EmranParams(neurons_max=6), 4)
    memory.counts[[NEURONS, SAMPLES, LEARNED]] = n, 200, 50
    memory.centers[:n] = np.arange(n)[:, None] * (1.0, 2.0, 3.0, 4.0)
    memory.widths[:n] = 0.5 + np.arange(n)
    memory.weights[:n] = 0.1 * (np.arange(n) - 1.5)
    memory.covariance[:n] = np.eye(6) * (1.0 + np.arange(n))[:, None, None]
    return insight(memory, np.array((0.1 * t, 0.0, 0.0, 0.0)))


def drive(recorder: Recorder, trace: np.ndarray, vehicles: int) -> None:
    recorder.state(0.0, "learning", "off")
    recorder.state(0.0, "maneuver", "keep lane")
    recorder.patch(0.05, PATCH)
    for end in range(5, len(trace) + 1, 5):
        rows = trace[end - 5 : end]
        now = end / 100
        if end % 300 == 0:
            recorder.event(now, "INFO", f"steering network: neuron added, {end // 300} neurons")
        if end in (500, 3000):
            recorder.event(now, "WARN", "gap 21 m below the desired 28 m")
        if now in SIGNALS:
            recorder.signals(now, SIGNALS[now])
        if end % 50 == 0:
            recorder.network(now, "steering", network_at(now))
        for name, value in STATES.get(end, ()):
            recorder.state(now, name, value)
        recorder.write(rows, traffic_at(now, vehicles), lambda rows=rows: path_ahead(rows[-1]))


SUMMARY = """**Highway, 100 vehicles, seed 4: goal reached in 60 s, no collision.**

| lateral RMS | lateral max | heading RMS | speed RMS | neurons steering + speed |
|---|---|---|---|---|
| **0.047 m** | 0.19 m | 0.13° | 0.36 m/s | 9 + 7 |
"""


@pytest.fixture(autouse=True)
def strict():
    """Rerun raises on bad data instead of dropping it."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def trace() -> np.ndarray:
    return ego_trace(20.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, trace) -> Path:
    """Twenty seconds among 100 vehicles, closed properly."""
    file = tmp_path_factory.mktemp("recorded") / "drive.rrd"
    with open_recorder(file) as recorder:
        drive(recorder, trace, 100)
        recorder.close(SUMMARY, {"controller": "pid-stanley", "seed": 4, "goal": True, "rms": 0.047})
    return file


def rerun(*arguments: object) -> int:
    command = [RERUN, "rrd", *map(str, arguments)]
    return subprocess.run(command, env=QUIET, capture_output=True, timeout=60, check=False).returncode


def rows_of(file: Path, entity: str, component: str):
    """Times [ns] and values per instant of one component, read by Rerun itself."""
    times, values = [], []
    for chunk in RrdReader(str(file)).stream().filter(content=entity, has_timeline="sim_time"):
        batch = chunk.to_record_batch()
        if component in batch.schema.names:
            times.extend(batch.column("sim_time").cast("int64").to_pylist())
            values.extend(batch.column(component).to_pylist())
    return np.array(times), values


def static_text(file: Path) -> list[str]:
    chunks = RrdReader(str(file)).stream().filter(content="/summary")
    return [text for c in chunks for (text,) in c.to_record_batch().column("TextDocument:text").to_pylist()]


def test_a_closed_file_is_verified_by_rerun(recorded):
    assert rerun("verify", recorded) == 0


def test_a_cut_file_is_refused_by_rerun(recorded, tmp_path):
    cut = tmp_path / "cut.rrd"
    cut.write_bytes(recorded.read_bytes()[:-2000])
    assert rerun("verify", cut) == 1


def test_two_equal_drives_make_equal_files_and_another_drive_a_different_one(tmp_path):
    def record(name, seed):
        with open_recorder(tmp_path / name) as recorder:
            drive(recorder, ego_trace(6.0, seed), 20)
        return tmp_path / name

    first, again, other = record("a.rrd", 0), record("b.rrd", 0), record("c.rrd", 1)
    assert rerun("compare", first, again) == 0
    assert rerun("compare", first, other) == 1


def test_every_plotted_curve_reads_back_as_the_trace_at_exact_times(recorded, trace):
    expected = trace[1::2]  # 50 Hz of 100 Hz
    units = {"": 1.0, "deg": 180 / np.pi, "percent": 100.0, "kN": 1e-3}
    assert len(plots.CURVES) > 30
    for curve in plots.CURVES:
        times, values = rows_of(recorded, "/plots/ego", f"trace:{curve.component}")
        np.testing.assert_array_equal(times, np.arange(20, 20001, 20) * 1_000_000)
        column = expected[:, COLUMNS.index(curve.column)] * units[curve.unit]
        shown = np.array([value[0] if value else np.nan for value in values])  # nothing is a gap
        column = np.where(np.isfinite(column), column, np.nan)
        np.testing.assert_allclose(shown, column, rtol=1e-6, atol=1e-30)


def test_every_plot_of_the_layout_is_on_a_tab_and_every_tab_shows_plots_that_exist():
    shown = {plot for rows in TABS.values() for row in rows for plot in row}
    assert shown == {*plots.PLOTS, *plots.INSIGHTS, FORCES, SPACE_STEERING, SPACE_SPEED}


def test_ego_and_traffic_stand_where_they_were_at_the_same_instants(recorded, trace):
    times, centers = rows_of(recorded, "/world/traffic", "Boxes3D:centers")
    ego_times, places = rows_of(recorded, "/world/ego", "Transform3D:translation")
    np.testing.assert_array_equal(times, INSTANTS)
    np.testing.assert_array_equal(times, ego_times)
    expected = np.column_stack((column(trace, "x"), column(trace, "y")))
    np.testing.assert_allclose(np.array(places)[:, 0, :2], expected, atol=1e-3)
    for k in (0, 1, 80, 81, 400):  # around a chunk's border too
        then = traffic_at(max(k, 1) / 20, 100)
        np.testing.assert_allclose(np.array(centers[k])[:, 0], then.x, atol=1 / 128 + 1e-4)
        np.testing.assert_allclose(np.array(centers[k])[:, 1], then.y, atol=1 / 128 + 1e-4)


def test_an_instant_without_vehicles_clears_the_traffic(tmp_path):
    trace = ego_trace(0.15)
    with open_recorder(tmp_path / "a.rrd") as recorder:
        for k, vehicles in enumerate((3, 0, 2)):
            rows = trace[5 * k : 5 * k + 5]
            recorder.write(rows, traffic_at(0.0, vehicles), no_path)
    _, centers = rows_of(tmp_path / "a.rrd", "/world/traffic", "Boxes3D:centers")
    assert [len(c) for c in centers] == [3, 3, 0, 2], "the first step twice: where the file opens, and at its end"


def test_other_egos_are_boxes_of_their_own_with_their_ids(tmp_path):
    trace = ego_trace(0.15)
    with open_recorder(tmp_path / "a.rrd") as recorder:
        for k, egos in enumerate(((), ("v1", "v7", "v2"), ("v1",))):
            recorder.write(trace[5 * k : 5 * k + 5], traffic_at(0.0, 4), no_path, egos)
    then = traffic_at(0.0, 4)
    _, others = rows_of(tmp_path / "a.rrd", "/world/traffic", "Boxes3D:centers")
    assert [len(c) for c in others] == [4, 4, 2, 3]
    _, egos = rows_of(tmp_path / "a.rrd", "/world/traffic/egos", "Boxes3D:centers")
    _, ids = rows_of(tmp_path / "a.rrd", "/world/traffic/egos", "Boxes3D:labels")
    assert ids == [[], [], ["v1", "v2"], ["v1"]]
    np.testing.assert_allclose(np.array(egos[2])[:, 0], then.x[1:3], atol=1 / 64)


def test_faster_traffic_is_never_redder_and_the_ends_are_red_and_blue():
    shown = colors.speed_colors(np.array([0.0, 8.0, 16.0, 24.0, 32.0, 60.0]))
    assert [hex(c) for c in shown] == [
        "0xdc322fff", "0xf58c28ff", "0xfad746ff", "0x5fcd82ff", "0x4696ffff", "0x4696ffff",
    ]  # fmt: skip


def test_states_and_events_keep_their_times_and_repeated_states_are_dropped(tmp_path):
    with open_recorder(tmp_path / "a.rrd") as recorder:
        for time_, value in ((0.0, "off"), (1.05, "off"), (2.15, "learning")):
            recorder.state(time_, "learning", value)
        for time_ in (0.0, 0.3, 0.31, 0.35, 12.4):
            recorder.event(time_, "WARN", "gap too small")
    times, states = rows_of(tmp_path / "a.rrd", "/state/learning", "StateChange:state")
    assert (times.tolist(), states) == ([0, 2_150_000_000], [["off"], ["learning"]])
    times, texts = rows_of(tmp_path / "a.rrd", "/events", "TextLog:text")
    assert (times / 1e9).tolist() == [0.0, 0.3, 0.31, 0.35, 12.4]
    assert texts == [["gap too small"]] * 5


def column(trace: np.ndarray, name: str) -> np.ndarray:
    """A column at the first row, where the file opens, and at the ends of the SUMO steps."""
    return trace[np.r_[0, 4 : len(trace) : 5], COLUMNS.index(name)]


def held(times: np.ndarray, values: list, instants: np.ndarray) -> list:
    """What the viewer shows at the instants: the latest value."""
    return [values[k] for k in np.searchsorted(times, instants, side="right") - 1]


INSTANTS = np.r_[10, 50:20001:50] * 1_000_000


def test_the_brake_lights_shine_exactly_while_the_wheels_are_braked(recorded, trace):
    times, shown = rows_of(recorded, "/world/ego/brake_lights", "Boxes3D:colors")
    braked = column(trace, "torque") < -100.0
    assert braked.any()
    assert not braked.all()
    on, off = (int(colors.packed([c])[0]) for c in (colors.BRAKE_ON, colors.BRAKE_OFF))
    assert [c[0] for c in held(times, shown, INSTANTS)] == [on if b else off for b in braked]
    assert len(times) == 1 + np.count_nonzero(np.diff(braked)), "only changes are sent"


def test_the_arrow_of_a_side_force_ends_at_the_side_it_pushes_and_goes_with_the_force(recorded, trace):
    times, vectors = rows_of(recorded, "/world/ego/side_force", "Arrows3D:vectors")
    _, origins = rows_of(recorded, "/world/ego/side_force", "Arrows3D:origins")
    force = column(trace, "force_external_lat")
    shown = held(times, vectors, INSTANTS)
    assert [bool(v) for v in shown] == (force != 0.0).tolist()
    (vector,), (origin,) = next((v, o) for v, o in zip(vectors, origins, strict=True) if v)
    assert vector[1] < 0.0, "to the right, as the force"
    np.testing.assert_allclose(np.add(origin, vector)[:2], (0.0, EGO.width / 2), atol=1e-6)


def test_a_word_beside_the_ego_tells_the_grade_to_half_a_percent_and_none_where_it_is_flat(recorded, trace):
    times, words = rows_of(recorded, "/world/ego/grade", "Points3D:labels")
    percent = 100.0 * np.tan(column(trace, "grade"))
    assert (np.abs(percent) < 0.2).any()
    assert percent.min() < -0.3 < 0.3 < percent.max()
    for shown, true in zip(held(times, words, INSTANTS), percent, strict=True):
        signed = 0.0
        for word in shown or ():
            way, number, _ = word.split()
            signed = float(number) * {"uphill": 1.0, "downhill": -1.0}[way]
        assert abs(signed - true) < 0.2501


@pytest.mark.parametrize(("axle", "middle"), [("front", -10.0), ("rear", 10.0)])
def test_tire_forces_and_their_circle_of_friction_times_load_are_those_of_the_trace(recorded, trace, axle, middle):
    times, vectors = rows_of(recorded, "/tires/forces", "Arrows2D:vectors")
    np.testing.assert_array_equal(times, INSTANTS)
    expected = np.column_stack((-column(trace, f"force_lat_{axle}"), -column(trace, f"force_long_{axle}"))) / 1e3
    np.testing.assert_allclose(np.array(vectors)[:, int(middle > 0)], expected, rtol=1e-6, atol=1e-6)
    times, scales = rows_of(recorded, f"/tires/{axle}/limit", "Transform3D:scale")
    _, places = rows_of(recorded, f"/tires/{axle}/limit", "Transform3D:translation")
    radius = column(trace, "friction") * column(trace, f"load_{axle}") / 1e3
    shown = np.array(held(times, scales, INSTANTS))[:, 0]
    np.testing.assert_allclose(shown[:, 0], radius, atol=0.0251)
    np.testing.assert_array_equal(shown[:, 0], shown[:, 1])
    assert {place[0][0] for place in places} == {middle}


def test_the_lights_show_at_each_stop_line_what_sumo_said_last(recorded):
    green, yellow, red = (34, 197, 94), (250, 204, 21), (239, 40, 40)
    for entity, component in (("lines", "LineStrips3D:colors"), ("lamps", "Points3D:colors")):
        times, shown = rows_of(recorded, f"/world/signals/{entity}", component)
        assert times.tolist() == [50_000_000, 6_000_000_000, 9_000_000_000]
        assert shown == [colors.packed(pair).tolist() for pair in ((red, green), (red, yellow), (green, red))]


def static_of(file: Path, entity: str, component: str):
    chunks = RrdReader(str(file)).stream().filter(content=entity)
    batches = [chunk.to_record_batch() for chunk in chunks]
    (found,) = [b.column(component).to_pylist()[0] for b in batches if component in b.schema.names]
    return found


def test_stop_lines_lie_where_the_road_has_them(recorded):
    lit = np.array(static_of(recorded, "/world/signals/lines", "LineStrips3D:strips"))
    np.testing.assert_allclose(lit[..., :2], [STOPS[0].ends, STOPS[1].ends])
    plain = np.array(static_of(recorded, "/world/road/stop_lines", "LineStrips3D:strips"))
    np.testing.assert_allclose(plain[..., :2], [STOPS[2].ends])


def test_a_stretch_with_another_friction_is_a_surface_on_the_asphalt(recorded):
    times, (vertices,) = rows_of(recorded, "/world/road/patch", "Mesh3D:vertex_positions")
    _, (triangles,) = rows_of(recorded, "/world/road/patch", "Mesh3D:triangle_indices")
    assert times.tolist() == [50_000_000]
    vertices = np.array(vertices)
    assert area(vertices, np.array(triangles)) == pytest.approx(40.0 * 3.5)
    assert road.ASPHALT_LEVEL < vertices[:, 2].min() <= vertices[:, 2].max() < road.LINE_LEVEL
    assert rows_of(recorded, "/world/road/patch/label", "Points3D:labels")[1] == [["friction × 0.5"]]


def test_the_words_about_a_stretch_stand_beside_it_as_often_as_one_can_be_in_sight(tmp_path):
    long = PATCH._replace(line=np.column_stack((np.linspace(0.0, 250.0, 126), np.zeros(126))))
    with open_recorder(tmp_path / "a.rrd") as recorder:
        recorder.patch(0.05, long)
    _, (places,) = rows_of(tmp_path / "a.rrd", "/world/road/patch/label", "Points3D:positions")
    _, (words,) = rows_of(tmp_path / "a.rrd", "/world/road/patch/label", "Points3D:labels")
    assert words == ["friction × 0.5"] * 4
    assert [place[0] for place in places] == [0.0, 80.0, 160.0, 240.0]
    assert {place[1] < -3.5 / 2 for place in places} == {True}, "at the right edge or farther"


def test_the_stretch_moves_to_another_lane_and_goes_where_none_is_in_sight(tmp_path):
    beside = PATCH._replace(line=np.add(PATCH.line, (0.0, 3.5)))
    with open_recorder(tmp_path / "a.rrd") as recorder:
        for time_, patch in ((0.05, None), (1.0, PATCH), (2.0, beside), (3.0, None)):
            recorder.patch(time_, patch)
    times, found = rows_of(tmp_path / "a.rrd", "/world/road/patch", "Mesh3D:vertex_positions")
    assert times.tolist() == [1_000_000_000, 2_000_000_000, 3_000_000_000]
    np.testing.assert_allclose(np.subtract(found[1], found[0]), np.tile((0.0, 3.5, 0.0), (42, 1)), atol=1e-5)
    assert found[2] == []


def test_the_stretch_is_where_the_disturbance_says_along_the_path():
    x = np.arange(0.0, 500.0, 0.25)
    flat = np.zeros_like(x)
    line = Line(x - 20.0, flat, flat, flat, flat, 0.25)
    found = patch_on(DisturbanceParams(patch_start=100.0, patch_end=150.0, patch_friction=0.6), line, 3.5)
    assert found is not None
    assert (found.line[0, 0], found.line[-1, 0], found.width, found.friction) == (80.0, 130.0, 3.5, 0.6)
    assert patch_on(DisturbanceParams(), line, 3.5) is None


def test_the_inside_of_a_network_is_recorded_as_it_was(recorded):
    times, centers = rows_of(recorded, "/networks/steering/centers", "Ellipsoids3D:centers")
    np.testing.assert_array_equal(times, np.arange(500, 20001, 500) * 1_000_000)
    seen = [network_at(t) for t in times / 1e9]
    assert [len(c) for c in centers] == [len(one.widths) + 1 for one in seen]
    np.testing.assert_allclose(centers[-1][:-1], seen[-1].centers[:, :3])
    np.testing.assert_allclose([c[-1][0] for c in centers], 1e-10 * times, rtol=1e-6)  # the car
    for name in ("weights", "widths"):
        _, values = rows_of(recorded, "/plots/steering_network", f"trace:{name}")
        np.testing.assert_allclose(values[-1][:4], getattr(seen[-1], name), rtol=1e-6)
        assert not any(values[-1][4:])
    _, values = rows_of(recorded, "/plots/steering_network", "trace:covariance")
    # the car is nearest to the neuron at the origin up to 0.1 t = 15, whose P is the unit matrix
    assert values == [[6.0] if t >= 2.0e9 else [] for t in times]
    _, values = rows_of(recorded, "/plots/steering_network", "trace:share_learned")
    np.testing.assert_allclose(np.ravel(values), 25.0)


def test_a_disturbance_that_comes_and_goes_is_an_event_and_a_state(recorded):
    times, texts = rows_of(recorded, "/events", "TextLog:text")
    found = {text: t / 1e9 for t, (text,) in zip(times, texts, strict=True)}
    assert found["friction falls to 0.50"] == pytest.approx(7.01)
    assert found["friction rises to 0.90"] == pytest.approx(9.01)
    assert found["side force begins, to the right"] == pytest.approx(10.01)
    assert found["side force over, 2.5 kN at the most"] == pytest.approx(12.01)
    assert (np.diff(times) >= 0).all()
    times, states = rows_of(recorded, "/state/disturbance", "StateChange:state")
    assert np.round(times / 1e9, 2).tolist() == [7.01, 9.01, 10.01, 12.01]
    assert [state for (state,) in states] == ["low friction", "none", "side force", "none"]


def watched(**given: np.ndarray) -> list[str]:
    """Texts of the events of rows at 100 Hz that are quiet but for the given columns."""
    n = len(next(iter(given.values())))
    values = {name: np.zeros(n) for name in ("steer", "steer_command", "accel_command", "force_external_lat")}
    values |= {"time": np.arange(1, n + 1) / 100.0, "friction": np.ones(n)} | given
    watch = Watch(LIMITS, list(values).index)
    rows = np.column_stack(list(values.values()))
    return [f"{note.time:.2f} {note.text}" for part in np.array_split(rows, 7) for note in watch.look(part)[0]]


def test_a_limit_that_is_held_is_one_event_and_one_that_is_hit_again_later_is_another():
    wave = np.zeros(400)
    wave[100:150], wave[160:170], wave[300:310] = -9.0, -9.0, -9.0
    assert watched(accel_command=wave) == [
        "1.01 braking command at its limit",
        "3.01 braking command at its limit",
    ]
    assert watched(accel_command=0.9 * wave) == []
    assert watched(accel_command=np.repeat((0.0, 4.0), 20)) == ["0.21 acceleration command at its limit"]


def test_the_steering_limits_are_those_of_angle_and_rate():
    ramp = np.clip(0.008 * np.arange(-50, 50), 0.0, 1.0)
    assert watched(steer=ramp) == ["0.52 steering rate at its limit"]
    assert watched(steer=0.9 * ramp) == []
    assert watched(steer_command=np.repeat((0.0, -0.6), 20)) == ["0.21 steering angle at its limit"]


def test_a_force_that_acts_from_the_start_and_a_wave_of_friction_are_told_sensibly():
    assert watched(force_external_lat=np.full(50, 800.0)) == ["0.01 side force begins, to the left"]
    assert watched(friction=1.0 + 0.2 * np.sin(np.arange(300) / 100.0)) == []


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (-0.07, 0.07, 2), (-0.035, 0.03, 1), (0.0, 7.0, 2), (19.0, 20.1, 2), (-3600.0, 1200.0, 1), (0.0, 0.0, 2),
        (5.0, 5.0, 2), (-4.1, 3.6, 1), (-0.9, 2.0, 4), (-6.0, 9.0, 2),
    ],
)  # fmt: skip
def test_an_axis_holds_its_curve_and_two_labels_unless_they_would_leave_much_of_it_empty(low, high, labels):
    bottom, top = plots.ticked(low, high)
    assert bottom <= low
    assert high <= top
    assert high == low or (high - low) / (top - bottom) > 0.53
    decades = 10.0 ** np.arange(-9, 6)
    counts = [np.floor(top / d + 1e-9) - np.ceil(bottom / d - 1e-9) + 1 for d in decades]
    assert max(count for count in counts if count <= 4) == labels


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (-0.0616, 0.0702, "−0.062…0.070"), (18.93, 20.02, "18.9…20.0"), (-3604.0, 1203.5, "−3604…1204"),
        (0.0, 0.0, "0"), (0.8, 0.8, "0.80"), (-0.0004, 13.9, "0…13.9"), (2e-9, 1e-8, "0"),
        (9.9947, 10.0094, "9.99…10.01"), (9.9999999, 10.0, "10.000"),
    ],
)  # fmt: skip
def test_a_range_is_told_in_two_digits_of_its_larger_end(low, high, words):
    assert plots.between(low, high) == words


def test_a_heading_tells_as_much_as_it_has_room_for():
    plot = plots.Plot("Offset", "m", (), "left is up")
    assert plots.heading(plot, None, 40) == "Offset [m]; left is up"
    assert plots.heading(plot, (-0.31, 1.24), 40) == "Offset −0.3…1.2 m; left is up"
    assert plots.heading(plot, (-0.31, 1.24), 18) == "Offset −0.3…1.2 m"
    assert plots.heading(plot, (-0.31, 1.24), 15) == "Offset 0…1 m"
    assert plots.heading(plot, (-0.31, 1.24), 11) == "Offset [m]"
    assert plots.heading(plot._replace(steps=True), (0.0, 7.0), 40) == "Offset 0…7 m; left is up"


def test_the_summary_and_the_properties_of_the_run_are_in_the_file(recorded):
    assert static_text(recorded)[-1] == SUMMARY
    properties = RrdReader(str(recorded)).stream().filter(content="/__properties/run")
    batch = next(iter(properties)).to_record_batch()
    values = {name.split(":")[-1]: batch.column(name).to_pylist()[0] for name in batch.schema.names}
    assert values["controller"] == ["pid-stanley"]
    assert values["seed"] == [4]
    assert values["rms"] == [0.047]


def test_an_exception_closes_the_file_and_names_itself_in_the_summary(tmp_path):
    file = tmp_path / "a.rrd"

    def leave_the_road():
        with open_recorder(file) as recorder:
            drive(recorder, ego_trace(1.0), 5)
            raise ValueError("off the road")

    with pytest.raises(ValueError, match="off the road"):
        leave_the_road()
    assert rerun("verify", file) == 0
    assert "stopped early by ValueError off the road" in static_text(file)[-1]
    assert len(rows_of(file, "/world/ego", "Transform3D:translation")[0]) == 21


def test_closing_twice_is_harmless_and_writing_afterwards_is_refused(tmp_path):
    with open_recorder(tmp_path / "a.rrd") as recorder:
        recorder.close("done")
        recorder.close("done again")
        with pytest.raises(RuntimeError, match="the recording is closed"):
            recorder.write(ego_trace(0.05), traffic_at(0.0, 1), no_path)
    assert static_text(tmp_path / "a.rrd")[-1] == "done"


def test_a_missing_trace_column_is_named_before_anything_is_written(tmp_path):
    with pytest.raises(KeyError, match="the trace has no column 'yaw_rate'"):
        open_recorder(tmp_path / "a.rrd", columns=[c for c in COLUMNS if c != "yaw_rate"])
    assert not (tmp_path / "a.rrd").exists()


def test_an_unknown_event_level_is_named(tmp_path):
    with open_recorder(tmp_path / "a.rrd") as recorder, pytest.raises(ValueError, match="'LOUD' is none of"):
        recorder.event(0.0, "LOUD", "?")


def arranged(file: Path) -> tuple[list[str], dict[str, list]]:
    """Names of all views and tabs of the one layout of a file, and its vertical axes by view in the order sent."""
    (layout,) = RrdReader(str(file)).blueprints()
    names, axes = [], {}
    for chunk in RrdReader(str(file)).stream(store=layout):
        batch = chunk.to_record_batch()
        for component in ("ViewBlueprint:display_name", "ContainerBlueprint:display_name"):
            if component in batch.schema.names:
                names += [name for (name,) in batch.column(component).to_pylist()]
        if "ScalarAxis:range" in batch.schema.names:
            axes.setdefault(str(chunk.entity_path), []).extend(batch.column("ScalarAxis:range").to_pylist())
    return names, axes


DRAWN = plots.PLOTS | plots.INSIGHTS
SHOWN = [(name, LETTERS[len(row)]) for rows in TABS.values() for row in rows for name in row if name in DRAWN]
TITLES = sorted(plots.heading(DRAWN[name], None, room) for name, room in SHOWN)  # while nothing is known of the run


def test_a_finished_file_has_one_layout_whose_axes_and_headings_were_set_when_the_run_ended(recorded, trace):
    names, axes = arranged(recorded)
    assert {*TABS, "Chase camera", "Map", "Events", "Summary"} <= set(names)
    assert sorted(name for name in names if name in set(TITLES)) == TITLES, "each view is sent once at the begin"
    error = trace[1::2, COLUMNS.index("cross_track_error")]
    told = f"Cross-track error {plots.between(error.min(), error.max())} m; positive: path to the left"
    assert names.count(told) == 2
    assert len(axes) > 25, "the plots of the trace have ranges now"
    assert {len(ranges) for ranges in axes.values()} == {1, 2}, "those that the drive has widened are sent again"


def test_all_headings_and_tabs_have_room_in_a_window_of_1366_pixels():
    assert max(len(title) / room for title, room in ((plots.heading(DRAWN[n], None, r), r) for n, r in SHOWN)) <= 1.0
    assert len("".join(TABS)) <= 56, "594 pixels, 34 of each tab for its icon, 6 to 7 per letter"
    assert max(len(rows) for rows in TABS.values()) <= 4


def test_two_equal_drives_have_equal_layouts(tmp_path):
    found = []
    for name in ("a.rrd", "b.rrd"):
        with open_recorder(tmp_path / name) as recorder:
            drive(recorder, ego_trace(1.0), 3)
        reader = RrdReader(str(tmp_path / name))
        (layout,) = reader.blueprints()
        columns = [chunk.to_record_batch().to_pydict() for chunk in reader.stream(store=layout)]
        found.append([{key: value for key, value in row.items() if "RowId" not in key} for row in columns])
    assert found[0] == found[1]


def test_runs_that_are_killed_or_terminated_leave_their_data(tmp_path):
    script = (
        "import signal, sys, time\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import test_recording as t\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))\n"
        "with t.open_recorder(t.Path(sys.argv[1])) as recorder:\n"
        "    t.drive(recorder, t.ego_trace(25.0), 20)\n"
        "    print('driven', flush=True)\n"
        "    time.sleep(60)\n"
    )
    files = {signal.SIGKILL: tmp_path / "killed.rrd", signal.SIGTERM: tmp_path / "terminated.rrd"}
    runs = {
        number: subprocess.Popen(
            [sys.executable, "-c", script, file], stdout=subprocess.PIPE, cwd=Path(__file__).parents[1]
        )
        for number, file in files.items()
    }
    for number, run in runs.items():
        with run:
            assert run.stdout is not None
            assert run.stdout.readline() == b"driven\n"
            if number == signal.SIGKILL:
                time.sleep(0.5)  # the chunks sent reach the file on a thread of their own
            run.send_signal(number)
            assert run.wait(20) == (143 if number == signal.SIGTERM else -number)

    with pytest.warns(RerunWarning, match="no footer"):
        killed, _ = rows_of(files[signal.SIGKILL], "/plots/ego", "trace:speed_long")
    with pytest.warns(RerunWarning, match="no footer"):
        summary = static_text(files[signal.SIGKILL])
    assert killed[-1] == 24_000_000_000, "only what was held since the last chunk may be lost"
    with pytest.warns(RerunWarning, match="no footer"):
        looks, _ = rows_of(files[signal.SIGKILL], "/plots/steering_network", "trace:weights")
    assert looks[-1] == 24_000_000_000, "the networks too"
    assert "not finished" in summary[-1]
    with pytest.warns(RerunWarning, match="no footer"):
        names, _ = arranged(files[signal.SIGKILL])
    assert set(TABS) | set(TITLES) <= set(names), "all tabs and plots"

    assert rerun("verify", files[signal.SIGTERM]) == 0
    terminated, _ = rows_of(files[signal.SIGTERM], "/plots/ego", "trace:speed_long")
    assert terminated[-1] == 25_000_000_000
    assert "stopped early by SystemExit 143" in static_text(files[signal.SIGTERM])[-1]


def test_a_run_has_something_to_show_after_two_seconds(tmp_path):
    file = tmp_path / "a.rrd"
    with open_recorder(file) as recorder:
        drive(recorder, ego_trace(3.0), 5)
        recorder._stream.flush()
        time.sleep(0.5)
        with pytest.warns(RerunWarning, match="no footer"):
            times, _ = rows_of(file, "/plots/ego", "trace:speed_long")
    assert times[-1] == 2_000_000_000


def test_a_viewer_that_does_not_answer_holds_up_the_end_of_a_live_run_for_its_patience_only(tmp_path):
    script = (
        "import sys, time\n"
        f"sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import test_recording as t\n"
        "from emran_sumo.recording import stream\n"
        "stream.PATIENCE = 1.0\n"
        "with t.open_recorder(t.Path(sys.argv[1]), live=sys.argv[2]) as recorder:\n"
        "    t.drive(recorder, t.ego_trace(3.0), 5)\n"
        "print('ended', flush=True)\n"
    )
    with socket.socket() as frozen:  # takes the connection, and never says a word
        frozen.bind(("127.0.0.1", 0))
        frozen.listen()
        live = f"rerun+http://127.0.0.1:{frozen.getsockname()[1]}/proxy"
        found = subprocess.run(
            [sys.executable, "-c", script, tmp_path / "a.rrd", live],
            cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
    assert (found.returncode, found.stdout) == (0, "ended\n")
    assert "--live: the viewer has not answered" in found.stderr
    assert rerun("verify", tmp_path / "a.rrd") == 0
    times, _ = rows_of(tmp_path / "a.rrd", "/plots/ego", "trace:speed_long")
    assert times[-1] == 3_000_000_000, "the file has it all"


def test_a_simulated_minute_among_100_vehicles_stays_below_3_megabytes(recorded, tmp_path):
    with open_recorder(tmp_path / "empty.rrd"):
        pass
    start = (tmp_path / "empty.rrd").stat().st_size
    assert start < 1.2e6, "road and layout, once per file"
    assert 3 * (recorded.stat().st_size - start) < 3e6


def test_a_longer_drive_holds_no_more_memory_and_little_time(tmp_path, monkeypatch):
    monkeypatch.setattr("emran_sumo.recording.recorder.CHUNK", 8000)
    trace, held = ego_trace(72.0), []
    scene = [(traffic_at(k / 20, 100), path_ahead(trace[5 * k])) for k in range(len(trace) // 5)]
    with open_recorder(tmp_path / "a.rrd") as recorder:
        tracemalloc.start()
        for k, (traffic, ahead) in enumerate(scene):
            recorder.write(trace[5 * k : 5 * k + 5], traffic, lambda ahead=ahead: ahead)
            if (k + 1) % 80 == 0:
                held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()  # only now: Rerun's own thread frees what was sent, and tracing must not end under it
    # a chunk is 0.45 MB: two may be on their way to Rerun's thread; all that were written would be 4 MB
    assert max(held[3:]) - max(held[:3]) < 1_000_000
    with open_recorder(tmp_path / "b.rrd") as recorder:
        start = time.process_time()
        for k, (traffic, ahead) in enumerate(scene):
            recorder.write(trace[5 * k : 5 * k + 5], traffic, lambda ahead=ahead: ahead)
        spent = (time.process_time() - start) / 72.0
    assert spent < 0.02, f"{spent * 1e3:.1f} ms per simulated second"


DRIVERS = [*Path("/usr/share/vulkan/icd.d").glob("*.json"), *Path("/etc/vulkan/icd.d").glob("*.json")]
drawing = pytest.mark.skipif(
    sys.platform == "linux" and not DRIVERS, reason="no Vulkan driver: the headless viewer cannot draw"
)


@contextmanager
def viewer(file: Path, log: Path):
    """A client of a headless viewer that has loaded the file; skips where nothing can be drawn."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [
        RERUN,
        file,
        "--headless",
        "--bind",
        "127.0.0.1",
        "--port",
        str(port),
        "--window-size",
        "1440x900",
    ]
    with log.open("w") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=QUIET)
    try:
        client, end = None, time.monotonic() + 30
        while time.monotonic() < end:
            if process.poll() is not None:
                said = log.read_text()
                if "render context" in said or "adapter" in said:
                    pytest.skip("no Vulkan driver: the headless viewer cannot draw")
                pytest.fail(f"the viewer ended with {process.returncode}: {said[-500:]}")
            try:
                client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                state = client.get_state()
                if state.views and state.active_recording and not state.loading:
                    break
            except ConnectionError:
                pass
            time.sleep(0.1)
        else:
            pytest.fail("the viewer did not load the file within 30 s")
        yield client
    finally:
        process.terminate()
        process.wait(10)


def complaints(client: ViewerClient) -> list[str]:
    """What the viewer could not show, and what it warned of."""
    reports = [f"{view.name}: {view.reports}" for view in client.get_state().views if view.reports]
    # "rasterizer": the viewer's own remark on machines without a graphics card
    spoken = [log for log in client.get_logs() if log.level.upper() in ("WARN", "ERROR")]
    return reports + [log.message for log in spoken if "asterizer" not in log.message]


@drawing
def test_the_viewer_draws_every_view_without_a_complaint(recorded, tmp_path):
    with viewer(recorded, tmp_path / "viewer.log") as client:
        client.set_time("sim_time", duration=14.0, play_state="paused")
        time.sleep(2.0)
        picture = np.asarray(Image.open(BytesIO(client.take_screenshot())).convert("RGB")).astype(int)
        assert complaints(client) == []
        assert len(client.get_state().views) >= 9
    height, width, _ = picture.shape
    scene = picture[: height // 2, : width // 2]
    for name, color in (("ego", colors.PINK), ("asphalt", colors.ASPHALT), ("path", colors.TEAL)):
        near = np.abs(scene - np.array(color)).max(axis=2) < 25
        assert near.sum() > 30, f"the {name} is not in the picture"


def test_a_run_records_its_lights_its_networks_and_everything_it_measured(tmp_path):
    located = load("urban_signals", {"duration": (12.0, "")})
    result = drive_scenario(located, tmp_path, command="emran-sumo run urban_signals --duration 12")
    file = result.folder / "run.rrd"
    text = static_text(file)[-1]
    summary = json.loads((result.folder / "summary.json").read_text())
    told = summary["manifest"]
    for group, name, *values in report.rows(summary):
        # how long it took is not in it: equal runs have equal recordings
        assert (f"| {group} | {name} | {values[0]} |" in text) == (name != "real-time factor")
    for name, number in told["versions"].items():
        assert f"{name} {number}" in text
    assert text.startswith(f"**{told['scenario']['title']}.** {report.verdict(summary)}")
    assert "traffic of its files: finished" in text
    assert "`emran-sumo run urban_signals --duration 12`" in text
    assert "`emran-sumo run urban_signals --duration 12 --out" not in text, "where it lies makes no other run"
    assert rows_of(file, "/events", "TextLog:text")[0][0] == 10_000_000, "nothing stands before the first instant"
    assert f"digest {told['digest']}" in text

    # 28 links of two signals with 4 approaches each; static programs change at whole seconds of SUMO's clock
    lines = static_of(file, "/world/signals/lines", "LineStrips3D:strips")
    times, shown = rows_of(file, "/world/signals/lines", "LineStrips3D:colors")
    assert {len(c) for c in shown} == {len(lines)}
    assert times[0] == 10_000_000, "where the file opens"
    known = set(colors.packed(colors.SIGNAL_COLORS.values()).tolist())
    assert {c for row in shown for c in row} <= known
    assert all(one != following for one, following in pairwise(shown)), "only changes are sent"

    trace = read_trace(result.folder / "trace.parquet")
    times, shares = rows_of(file, "/plots/speed_network", "trace:share_learned")
    rows = np.rint(times / 1e7).astype(int) - 1
    # the network sees no samples at walking speed: the share of those it saw is no smaller than that of all
    assert (np.ravel(shares) >= 100.0 * trace["learned_speed"][rows] / (rows + 1) - 1e-4).all()
    _, weights = rows_of(file, "/plots/speed_network", "trace:weights")
    np.testing.assert_array_equal(np.count_nonzero(weights, axis=1), np.minimum(trace["neurons_speed"][rows], 16))


@drawing
@pytest.mark.parametrize(
    ("name", "seconds", "there"),
    [
        ("highway_dlc", 15.0, {"path": colors.TEAL}),
        ("urban_signals", 5.0, {"path": colors.TEAL}),
        ("bridge_gust", 17.0, {"arrow of the gust": colors.RED}),
    ],
)
def test_all_views_of_a_shipped_scenario_are_drawn_at_once_without_a_complaint(
    name, seconds, there, tmp_path, monkeypatch
):
    # a view in the back of its tabs is not drawn: all are laid side by side
    monkeypatch.setattr(rrb, "Tabs", lambda *views, name=None, active_tab=None: rrb.Grid(*views, name=name))
    result = drive_scenario(load(name, {"duration": (seconds, "")}), tmp_path)
    with viewer(result.folder / "run.rrd", tmp_path / "viewer.log") as client:
        client.set_time("sim_time", duration=seconds - 0.5, play_state="paused")
        time.sleep(3.0)
        picture = np.asarray(Image.open(BytesIO(client.take_screenshot())).convert("RGB")).astype(int)
        assert complaints(client) == []
        assert len(client.get_state().views) == 6 + sum(len(row) for rows in TABS.values() for row in rows)
    height, width, _ = picture.shape
    scene = picture[: height // 2, : width // 2]
    for what, color in {"ego": colors.PINK, "asphalt": colors.ASPHALT, **there}.items():
        near = np.abs(scene - np.array(color)).max(axis=2) < 25
        assert near.sum() > 20, f"the {what} is not in the picture"


def area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k], :2] for k in range(3))
    return float(np.sum(0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])))


def test_the_parallel_of_a_circle_is_a_circle():
    angle = np.linspace(0.0, np.pi, 400)
    circle = 50.0 * np.column_stack((np.cos(angle), np.sin(angle)))  # counter-clockwise: the center is left
    np.testing.assert_allclose(np.hypot(*road.offset(circle, 2.0).T), 48.0, atol=1e-2)
    np.testing.assert_allclose(np.hypot(*road.offset(circle, -2.0).T), 52.0, atol=1e-2)


def test_the_parallel_of_a_right_angle_keeps_its_distance():
    corner = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)])
    np.testing.assert_allclose(road.offset(corner, 1.0), [(0, 1), (9, 1), (9, 10)], atol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_a_concave_junction_is_filled_exactly(turned):
    polygon = np.array([(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)], dtype=float)
    triangles = road.triangulated(polygon[::-1] if turned else polygon)
    assert len(triangles) == 3
    assert area(polygon[::-1] if turned else polygon, triangles) == pytest.approx(16 - 6)


def test_the_road_surface_has_the_area_of_its_lanes_and_junctions():
    shapes = road.road_shapes(small_road())
    bend = 3000.0 * LANES * WIDTH  # the parallels of a bend are as long as the middle on average
    corners = np.array(small_road().junctions[0])
    x, y = corners.T
    junction = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    lanes = area(shapes.vertices, shapes.triangles) - junction - 370.0 * WIDTH
    # lanes carry shapes of their own length: outer longer, inner shorter, canceling about the middle lane
    assert lanes == pytest.approx(bend, rel=1e-4)


def test_dashes_lie_between_the_lanes_of_an_edge_and_are_3_m_long():
    shapes = road.road_shapes(small_road())
    lengths = [np.hypot(*(b - a)[:2]) for a, b in shapes.dashes]
    np.testing.assert_allclose(lengths, 3.0, atol=1e-3)
    radii = np.array([np.hypot(m[0], BEND - m[1]) for m in (d.mean(axis=0) for d in shapes.dashes)])
    between = np.array([BEND - WIDTH / 2, BEND + WIDTH / 2])
    assert np.abs(radii[:, None] - between).min(axis=1).max() < 0.02
    assert len(shapes.borders) == 4  # two of the highway, two of the street


def test_an_empty_road_can_be_recorded(tmp_path):
    with open_recorder(tmp_path / "a.rrd", road=Road((), ())) as recorder:
        drive(recorder, ego_trace(0.5), 2)
    assert rerun("verify", tmp_path / "a.rrd") == 0


def test_a_trace_table_reads_back_bit_by_bit_with_its_units(tmp_path):
    rows = np.random.default_rng(1).normal(size=(50, 3))
    rows[7, 1] = np.nan
    write_trace(tmp_path / "runs" / "a.parquet", ("time", "yaw", "x"), rows, {"time": "s", "yaw": "rad"})
    back = read_trace(tmp_path / "runs" / "a.parquet")
    assert list(back) == ["time", "yaw", "x"]
    for i, column in enumerate(back.values()):
        assert column.dtype == np.float64
        assert column.tobytes() == np.ascontiguousarray(rows[:, i]).tobytes()
    assert read_units(tmp_path / "runs" / "a.parquet") == {"time": "s", "yaw": "rad"}


def test_a_table_that_cannot_be_put_in_place_leaves_nothing_behind(tmp_path):
    (tmp_path / "a.parquet").mkdir()
    with pytest.raises(OSError, match=r"a\.parquet"):
        write_trace(tmp_path / "a.parquet", ("time",), np.zeros((2, 1)))
    assert [f.name for f in tmp_path.iterdir()] == ["a.parquet"]


def test_rows_that_do_not_fit_the_columns_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"rows of shape \(2, 3\) do not fit 2 columns"):
        write_trace(tmp_path / "a.parquet", ("time", "x"), np.zeros((2, 3)))


def test_a_track_that_is_a_double_lane_change_is_told_as_one(tmp_path):
    for name, maneuver in (("track_dlc", "double lane change"), ("track_cruise", "keep lane")):
        file = drive_scenario(load(name, {"duration": (1.0, "")}), tmp_path).folder / "run.rrd"
        assert rows_of(file, "/state/maneuver", "StateChange:state")[1] == [[maneuver]]
        _, texts = rows_of(file, "/events", "TextLog:text")
        speed = {"track_dlc": 10.0, "track_cruise": 28.0}[name]
        assert texts[0] == [f"ego taken over at {speed:.1f} m/s"]
