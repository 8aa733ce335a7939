"""A run leaves what it promises in its folder, the same for the same seed, and however it ends."""

import json
import os
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import rerun_cli

from test_recording import rows_of

from emran_sumo import drive, locate, scenario
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.drive import RunResult
from emran_sumo.ego import COLUMNS

RERUN = str(Path(rerun_cli.__file__).parent / ("rerun.exe" if os.name == "nt" else "rerun"))
QUIET = os.environ | {"CI": "1"}  # without it the first call of rerun on an account says welcome
LINE = Path(__file__).parent / "data" / "line.net.xml"
SHORT: dict[str, Any] = {"duration": 6.0, "warm_up": 4.0}
FILES = ("run.rrd", "trace.parquet", "summary.json")


def go(out: Path, record: bool = True, **given) -> RunResult:
    """Drive highway_dlc with some keys changed; `__` stands for the dot."""
    overrides = {key.replace("__", "."): (value, "test") for key, value in given.items()}
    return drive.run(scenario.load("highway_dlc", overrides), out, record=record)


def columns(folder: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(folder / "trace.parquet")
    return {name: table[name].to_numpy() for name in table.column_names}


def summary(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def rerun(*words: str | Path) -> int:
    return subprocess.run([RERUN, "rrd", *map(str, words)], env=QUIET, capture_output=True, timeout=120).returncode


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> RunResult:
    return go(tmp_path_factory.mktemp("first"), **SHORT)


def test_a_run_leaves_a_recording_a_trace_and_a_summary(first):
    assert first.folder.parts[-2:] == ("highway_dlc", "coupled-emran-seed1")
    assert set(FILES) <= {file.name for file in first.folder.iterdir()}
    assert rerun("verify", first.folder / "run.rrd") == 0
    assert not list(first.folder.glob("*.part"))


def test_the_trace_holds_every_signal_at_the_control_rate(first):
    table = columns(first.folder)
    assert list(table) == list(COLUMNS)
    np.testing.assert_allclose(table["time"], np.arange(1, 601) * 0.01, rtol=1e-12)
    for i, name in enumerate(COLUMNS):
        np.testing.assert_array_equal(table[name], first.trace[:, i], err_msg=name)
    travelled = np.hypot(np.diff(table["x"]), np.diff(table["y"])) / 0.01
    np.testing.assert_allclose(travelled, np.hypot(table["speed_long"], table["speed_lat"])[1:], atol=0.05)


def test_the_summary_says_how_to_repeat_the_run(first):
    told = summary(first.folder)
    assert (told["ended"], told["metrics"]) == ("finished", first.metrics)
    manifest = told["manifest"]
    assert manifest["seeds"] == {"traffic": 1, "sumo": 1}
    for name, package in (("numpy", "numpy"), ("numba", "numba"), ("rerun", "rerun-sdk"), ("sumo", "libsumo")):
        assert manifest["versions"][name].split(".")[:2] == version(package).split(".")[:2], name
    assert manifest["versions"]["emran_sumo"]
    resolved = manifest["scenario"]
    assert (resolved["duration"], resolved["warm_up"], resolved["road"]["friction"]) == (6.0, 4.0, 1.0)
    assert resolved == json.loads(json.dumps(scenario.to_dict(scenario.load("highway_dlc", FIRST).values)))


FIRST: dict[str, tuple[object, str]] = {key: (value, "test") for key, value in SHORT.items()}


def test_the_metrics_are_those_of_the_trace(first):
    table, told = columns(first.folder), summary(first.folder)["metrics"]
    rms = np.sqrt(np.mean(table["cross_track_error"] ** 2))
    assert told["tracking"]["cross_track_error_rms"] == pytest.approx(rms, rel=1e-9)
    assert told["tracking"]["speed_error_max"] == pytest.approx(np.abs(table["speed_error"]).max(), rel=1e-9)
    assert told["run"]["simulated"] == pytest.approx(6.0)
    gaps = table["lead_gap"][np.isfinite(table["lead_gap"])]
    assert told["safety"]["gap_min"] == (gaps.min() if gaps.size else None)
    assert told["run"]["mirror_error_max"] < 1e-3
    assert told["run"]["vehicles_mean"] > 150


def test_learning_is_told_from_the_first_learned_sample_until_a_second_without_one(first):
    trace = columns(first.folder)
    learned = trace["learned_speed"] + trace["learned_steering"]
    new = trace["time"][1:][np.diff(learned) > 0.0]
    times, states = rows_of(first.recording, "/state/learning", "StateChange:state")
    for instant in np.arange(0.5, trace["time"][-1], 0.05):
        shown = states[np.searchsorted(times / 1e9, instant + 1e-6, side="right") - 1][0]
        since = instant - new[new <= instant + 1e-6].max(initial=-np.inf)
        if abs(since - 1.0) > 0.11:  # steps of SUMO's
            assert shown == ("learning" if since < 1.0 else "settled"), instant


def test_the_same_seed_gives_the_same_run_bit_for_bit(first, tmp_path):
    again = go(tmp_path, **SHORT)
    assert again.trace.tobytes() == first.trace.tobytes()
    a, b = columns(first.folder), columns(again.folder)
    assert all(a[name].tobytes() == b[name].tobytes() for name in COLUMNS)
    assert rerun("compare", first.folder / "run.rrd", again.folder / "run.rrd") == 0
    traffic = "traffic.rou.xml"
    assert (first.folder / traffic).read_bytes() == (again.folder / traffic).read_bytes()


def test_another_seed_gives_another_run(first, tmp_path):
    other = go(tmp_path, **SHORT, seed=2)
    assert other.folder.name == "coupled-emran-seed2"
    assert other.trace.tobytes() != first.trace.tobytes()
    assert rerun("compare", first.folder / "run.rrd", other.folder / "run.rrd") == 1


def test_recording_changes_nothing_and_can_be_left_out(first, tmp_path):
    bare = go(tmp_path, record=False, **SHORT)
    assert not (bare.folder / "run.rrd").exists()
    assert bare.trace.tobytes() == first.trace.tobytes()


def test_a_second_run_into_the_same_folder_replaces_the_first(tmp_path):
    go(tmp_path, duration=2.0, warm_up=2.0)
    second = go(tmp_path, record=False, duration=1.0, warm_up=2.0)
    assert not (second.folder / "run.rrd").exists(), "a recording of another run would mislead"
    assert len(columns(second.folder)["time"]) == 100
    assert summary(second.folder)["manifest"]["scenario"]["duration"] == 1.0


def test_a_run_shorter_than_a_step_is_one_step(tmp_path):
    result = go(tmp_path, record=False, duration=0.01, warm_up=1.0)
    assert len(result.trace) == 5


def test_a_controller_that_loses_the_car_is_a_result(tmp_path):
    # plain Stanley steering on packed snow; without anybody around, the lane change begins where it is declared
    lost = go(tmp_path, controller="pid-stanley", road__friction=0.12, traffic__density=0.0, duration=30.0)
    assert lost.ended == "diverged"
    assert "lost the car" in lost.reason
    assert set(FILES) <= {file.name for file in lost.folder.iterdir()}
    assert rerun("verify", lost.folder / "run.rrd") == 0
    told = summary(lost.folder)
    assert told["ended"] == "diverged"
    assert (
        abs(lost.trace[-1, COLUMNS.index("cross_track_error")]) > 5.0
        or np.abs(lost.trace[-1, COLUMNS.index("heading_error")]) > 1.3
    )


STANDING = """\
<routes>
    <vTypeDistribution id="traffic"><vType id="car" length="5" probability="1"/></vTypeDistribution>
    <vType id="plain" length="4.7" accel="2.6" decel="4.5" sigma="0" speedFactor="1" speedDev="0"/>
    <route id="through" edges="fast slow"/>
    <vehicle id="other" type="plain" route="through" depart="0" departLane="1" departPos="400" departSpeed="0">
        <stop lane="fast_1" endPos="500" duration="40"/>
    </vehicle>
    <vehicle id="ego" type="plain" route="through" depart="0" departLane="1" departPos="100" departSpeed="20"/>
</routes>
"""


def own_scenario(folder: Path, routes: str) -> Path:
    folder.mkdir()
    (folder / "cars.rou.xml").write_text(routes, encoding="utf-8")
    file = folder / "scenario.toml"
    names = 'through = "through"\nexit = "through"\nenter = "through"\n'
    head = f'network = "{LINE}"\nroutes = ["cars.rou.xml"]\nduration = 150.0\nwarm_up = 1.0\n'
    stay = "[egos]\nlane_changes = false\n"
    file.write_text(f"{head}{stay}[traffic]\ndensity = 0.0\n{names}", encoding="utf-8")
    return file


def test_the_ego_waits_behind_a_standing_car_and_then_drives_to_the_end_of_the_road(tmp_path):
    result = drive.run(scenario.load(str(own_scenario(tmp_path / "own", STANDING))), tmp_path, record=False)
    assert result.ended == "arrived"
    table = columns(result.folder)
    standing = table["speed_long"] < 0.02
    assert standing.sum() * 0.01 > 10.0
    assert np.ptp(table["x"][standing]) < 0.2, "standing is standing, not creeping"
    gap = table["lead_gap"][standing]
    assert 1.0 < gap.min() <= gap.max() < 3.5  # minGap 2.5 m, less what the actuator's lag costs
    assert result.metrics["safety"]["collisions"] == 0
    assert table["speed_long"].max() < 30.5
    assert table["speed_long"][table["x"] > 1010.0].max() < 15.5, "the limit of the next edge"
    assert table["x"][-1] > 1960.0


def start(out: Path, *words: str) -> subprocess.Popen:
    """The command line in a process of its own, slowed down by a tenth of a plant step."""
    command = [sys.executable, "-c", "from emran_sumo.cli import main; main()", "run", "highway_dlc", "--out", str(out)]
    slow = ["--density", "5", "--set", "rates.plant_step=0.0001", "--set", "warm_up=2", "--duration", "150"]
    return subprocess.Popen(
        [*command, *slow, *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=QUIET
    )


def wait_until_it_drives(process: subprocess.Popen, folder: Path) -> None:
    end = time.monotonic() + 120.0
    file = folder / "run.rrd"
    while not (file.exists() and file.stat().st_size > 200_000):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run_writes_everything_it_has(tmp_path, number, code):
    folder = tmp_path / "highway_dlc" / "coupled-emran-seed1"
    process = start(tmp_path)
    wait_until_it_drives(process, folder)
    process.send_signal(number)
    told = process.communicate(timeout=60)
    assert process.returncode == code, told
    assert "Traceback" not in told[1]
    assert summary(folder)["ended"] == "interrupted"
    assert signal.Signals(number).name in summary(folder)["reason"]
    rows = len(columns(folder)["time"])
    assert 0 < rows < 15_000
    assert rows == round(summary(folder)["metrics"]["run"]["simulated"] * 100)
    assert rerun("verify", folder / "run.rrd") == 0


def test_an_interruption_before_the_drive_is_one_sentence(tmp_path):
    process = start(tmp_path, "--set", "warm_up=3600", "--density", "60")
    folder = tmp_path / "highway_dlc" / "coupled-emran-seed1"
    end = time.monotonic() + 120.0
    while not ((file := folder / "starting.rou.xml").exists() and file.stat().st_size > 1000):
        assert time.monotonic() < end
        time.sleep(0.02)
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    told = process.communicate(timeout=60)[1]
    lines = [line for line in told.splitlines() if not line.startswith("compiling the kernels")]
    assert (process.returncode, lines) == (
        130,
        ["emran-sumo: interrupted before the drive began; nothing was recorded."],
    )


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL")
def test_a_killed_run_leaves_a_recording_that_can_be_read(tmp_path):
    folder = tmp_path / "highway_dlc" / "coupled-emran-seed1"
    process = start(tmp_path)
    wait_until_it_drives(process, folder)
    process.kill()
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
    read = subprocess.run([RERUN, "rrd", "stats", folder / "run.rrd"], env=QUIET, capture_output=True, text=True)
    assert read.returncode == 0, read.stderr
    assert "/world" in read.stdout + read.stderr
    assert not (folder / "summary.json").exists(), "nothing says that it ended"


def compare(out: Path, seed: int, force: float = 0.0) -> dict[str, dict[str, float]]:
    """Tracking of the controllers on the same road in the same traffic."""
    names = ("coupled-emran", "coupled-base") if force else ("coupled-emran", "pid-stanley")
    pushed = {"disturbance__lateral_force": force} if force else {}
    return {
        name: go(out, record=False, controller=name, seed=seed, duration=45.0, **pushed).metrics["tracking"]
        for name in names
    }


def seeds(quick: int, slow: int) -> list:
    return [*range(1, quick + 1), *(pytest.param(k, marks=pytest.mark.slow) for k in range(quick + 1, slow + 1))]


@pytest.mark.parametrize("seed", seeds(2, 10))
def test_the_full_scheme_halves_the_cross_track_error_of_the_baseline(tmp_path, seed):
    found = compare(tmp_path, seed)
    ours, baseline = found["coupled-emran"], found["pid-stanley"]
    assert ours["cross_track_error_rms"] <= 0.5 * baseline["cross_track_error_rms"]
    assert ours["speed_error_rms"] < baseline["speed_error_rms"]


@pytest.mark.parametrize("seed", seeds(2, 10))
def test_the_networks_help_against_a_push_from_the_side(tmp_path, seed):
    found = compare(tmp_path, seed, force=1000.0)
    ours, base = found["coupled-emran"], found["coupled-base"]
    assert ours["cross_track_error_rms"] < base["cross_track_error_rms"]


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_controller_drives(tmp_path, name):
    result = go(tmp_path, record=False, controller=name, duration=3.0, warm_up=2.0, traffic__density=5.0)
    assert result.ended == "finished"
    aided = {"steering": "lateral", "speed": "longitudinal"}
    for net, half in aided.items():
        authority = CONTROLLERS[name][1].get(f"{half}.emran.authority", 1.0)
        if authority == 0.0:
            assert result.metrics["networks"][f"neurons_{net}_max"] == 0


def test_the_shipped_route_file_declares_the_lane_change_of_the_paper():
    root = ET.parse(locate.folder("scenarios") / "highway_dlc" / "highway_dlc.rou.xml").getroot()
    params = {p.get("key"): p.get("value") for p in root.iter("param")}
    assert params["double_lane_change.length_out"] == "25"
    assert params["double_lane_change.length_back"] == "21.95"
