"""Exports say what the trace says: text bit by bit, figures and videos of the right size; live runs are whole."""

import contextlib
import csv
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from rerun.chunk import RrdReader
from test_recording import (
    QUIET,
    RERUN,
    drive,
    ego_trace,
    no_path,
    open_recorder,
    rerun,
    rows_of,
    static_text,
    traffic_at,
)

from emran_sumo import drive as driving
from emran_sumo import found
from emran_sumo import viewer as viewers
from emran_sumo.ego import UNITS
from emran_sumo.errors import UserError
from emran_sumo.export import encoder
from emran_sumo.export.command import export
from emran_sumo.export.sheet import PANELS
from emran_sumo.recording.playback import read_scene
from emran_sumo.recording.table import read_trace
from emran_sumo.scenario import load


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """Two seconds in thin traffic."""
    given = {"duration": (2.0, "--duration"), "traffic.density": (2.0, "--density"), "warm_up": (2.0, "--set")}
    return driving.run(load("highway_dlc", given), tmp_path_factory.mktemp("runs")).folder


def test_text_reads_back_as_the_same_numbers_under_names_with_units(run, tmp_path):
    file = export(run, "csv", tmp_path / "new" / "a.csv")
    trace = read_trace(run / "trace.parquet")
    with file.open(encoding="utf-8", newline="") as lines:
        header, *rows = csv.reader(lines)
    assert header == [f"{name} [{UNITS[name]}]" if name in UNITS else name for name in trace]
    assert header[0] == "time [s]"
    values = np.array(rows, dtype=float)
    for i, (name, column) in enumerate(trace.items()):
        np.testing.assert_array_equal(values[:, i], column, err_msg=name)


def test_a_copied_table_keeps_numbers_and_units(run, tmp_path):
    file = export(run, "parquet", tmp_path / "a.parquet")
    assert pq.read_table(file).equals(pq.read_table(run / "trace.parquet"), check_metadata=True)


def test_the_table_is_there_already_where_no_file_is_named(run):
    assert export(run, "parquet") == run / "trace.parquet"


def test_the_sheet_is_a_picture_of_200_dots_per_inch_and_equal_for_equal_runs(run, tmp_path):
    first, second = (export(run, "png", tmp_path / name).read_bytes() for name in ("a.png", "b.png"))
    width, height = struct.unpack(">II", first[16:24])
    assert (width, height) == (1440, 1720)
    place = first.index(b"pHYs") + 4
    assert struct.unpack(">I", first[place : place + 4])[0] == round(200 / 0.0254)
    assert first == second


def test_the_sheet_shows_errors_speed_both_commands_lateral_acceleration_and_neurons():
    shown = {line.column for panel in PANELS for line in panel.lines}
    wanted = "cross_track_error heading_error speed_long speed_reference speed_error steer_law steer_network accel_lat"
    assert {*wanted.split(), "neurons_steering", "neurons_speed"} <= shown


def test_a_run_without_a_recording_exports_a_sheet_but_no_video(tmp_path, monkeypatch):
    monkeypatch.setattr(encoder, "find_encoder", lambda: "ffmpeg")
    folder = driving.run(load("track_dlc", {"duration": (1.0, "--duration")}), tmp_path, record=False).folder
    assert export(folder, "png").stat().st_size > 10_000
    with pytest.raises(UserError, match=r"run\.rrd: not there; a video needs the recording of the run"):
        export(folder, "mp4")


def test_the_scene_reads_back_as_it_was_recorded(tmp_path):
    with open_recorder(tmp_path / "run.rrd") as recorder:
        drive(recorder, ego_trace(6.0), 20)
    scene = read_scene(tmp_path / "run.rrd")
    np.testing.assert_array_equal(scene.times, np.r_[10, 50:6001:50])
    for k in (0, 1, 80, 81, 120):
        then = traffic_at(max(k, 1) / 20, 20)
        expected = np.column_stack((then.x, then.y, then.yaw, then.length, then.width))
        np.testing.assert_allclose(scene.traffic[k], expected, atol=0.01)
    assert len(scene.triangles) > 1000
    lengths = [np.hypot(*np.ptp(line, axis=0)) for line in scene.lines if len(line) == 2]
    assert sum(abs(length - 3.0) < 1e-2 for length in lengths) > 100, "the dashes are 3 m long"


def test_a_video_lasts_as_long_as_the_run(run, tmp_path):
    try:
        program = encoder.find_encoder()
    except UserError:
        pytest.skip("no ffmpeg: pip install emran-sumo[video]")
    told = []
    file = export(run, "mp4", tmp_path / "a.mp4", lambda *words: told.append(words))
    said = subprocess.run([program, "-i", str(file)], capture_output=True, text=True, check=False, timeout=60).stderr
    assert "1280x720" in said
    assert "Duration: 00:00:02.0" in said or "Duration: 00:00:01.9" in said
    assert told[-1][0] == "draw"
    assert told[-1][1] == pytest.approx(2.0)


def test_without_an_encoder_one_sentence_says_what_to_install(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UserError, match=r'there is no ffmpeg; install it with: pip install "emran-sumo\[video\]"'):
        export(run, "mp4")


@pytest.mark.skipif(os.name != "posix", reason="the fake encoder is a script")
def test_an_encoder_that_fails_is_told_in_its_own_words_and_leaves_no_file(run, tmp_path, monkeypatch):
    fake = tmp_path / "ffmpeg"
    fake.write_text("#!/bin/sh\necho 'Unknown encoder libx264' >&2\nexit 1\n")
    fake.chmod(0o755)
    monkeypatch.setattr(encoder, "find_encoder", lambda: str(fake))
    with pytest.raises(UserError, match="ffmpeg failed: Unknown encoder libx264"):
        export(run, "mp4", tmp_path / "a.mp4")
    assert {file.name for file in tmp_path.iterdir()} == {"ffmpeg"}


@pytest.mark.parametrize("kind", ["csv", "png"])
def test_an_output_that_cannot_be_written_is_told_and_nothing_is_left(run, tmp_path, kind):
    (tmp_path / "taken").mkdir()
    with pytest.raises(UserError, match=r"--out: cannot write .*taken: .*; accepted is a file that can be written"):
        export(run, kind, tmp_path / "taken")
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="--out: cannot write"):
        export(run, kind, tmp_path / "file" / f"a.{kind}")
    assert {file.name for file in tmp_path.iterdir()} == {"taken", "file"}


@pytest.mark.parametrize(
    ("kind", "name"), [("png", "x.csv"), ("mp4", "x.txt"), ("csv", "x.csv.gz"), ("parquet", "x.png")]
)
def test_no_file_gets_the_ending_of_another_kind(run, tmp_path, kind, name):
    with pytest.raises(
        UserError, match=rf'--out: found ".*{name}" for the format {kind}; accepted is .* ends in \.{kind}'
    ):
        export(run, kind, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_the_ending_of_a_file_may_be_in_capitals_or_missing(run, tmp_path):
    for name in ("X.CSV", "x"):
        assert export(run, "csv", tmp_path / name).read_bytes() == export(run, "csv", tmp_path / "y.csv").read_bytes()


def test_a_run_is_found_by_its_folder_its_files_and_the_newest_of_a_scenario(tmp_path):
    for age, name in ((30, "a-seed1"), (10, "b-seed1"), (20, "compare-seed1")):
        folder = tmp_path / "runs" / "town" / name
        folder.mkdir(parents=True)
        rrd = "compare.rrd" if "compare" in name else "run.rrd"
        for file in (folder / rrd, folder / "trace.parquet")[: 1 if "compare" in name else 2]:
            file.touch()
            os.utime(file, (1e9 - age, 1e9 - age))
    town = tmp_path / "runs" / "town"
    assert found.recording(town / "a-seed1") == town / "a-seed1" / "run.rrd"
    assert found.recording(town / "a-seed1" / "run.rrd") == town / "a-seed1" / "run.rrd"
    assert found.recording(town) == found.recording(tmp_path / "runs") == town / "b-seed1" / "run.rrd"
    assert found.recording(town / "compare-seed1") == town / "compare-seed1" / "compare.rrd"
    assert found.trace(town) == found.trace(town / "b-seed1" / "run.rrd") == town / "b-seed1" / "trace.parquet"
    with pytest.raises(UserError, match=r"town/b-sed1\"; no such run\. Did you mean \".*town/b-seed1\"\?"):
        found.recording(town / "b-sed1")
    with pytest.raises(UserError, match=r"there is no trace\.parquet in it"):
        found.trace(town / "compare-seed1")


def until(condition, seconds: float = 30.0):
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "in vain"
        time.sleep(0.1)
    return value


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # the listener is killed
def heard_rows(file) -> int:
    """Poses of the ego in a file that is being written; none while what there is of it cannot be read."""
    with contextlib.suppress(RuntimeError), warnings.catch_warnings(action="ignore"):
        return len(rows_of(file, "/world/ego", "Transform3D:translation")[0]) if file.exists() else 0
    return 0


@pytest.mark.parametrize("kind", ["csv", "parquet", "png", "mp4"])
def test_a_run_whose_files_are_broken_is_named_and_nothing_is_written(run, kind, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(run, broken)
    name = "run.rrd" if kind == "mp4" else "trace.parquet"
    (broken / name).write_bytes((broken / name).read_bytes()[:30_000])
    with pytest.raises(UserError, match=rf"{name}: cannot be read: .*; accepted is the folder of a finished run\."):
        export(broken, kind, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_with_a_recording_alone_is_told_why(run, tmp_path):
    shutil.copy(run / "run.rrd", tmp_path)
    with pytest.raises(UserError, match=r"no trace\.parquet in it; run\.rrd is: its run goes on or was killed;"):
        found.trace(tmp_path)


def blueprint_views(file: Path) -> int:
    """Views of the layouts in a file; what was cut off at its end does not count."""
    with warnings.catch_warnings(action="ignore"):
        reader = RrdReader(str(file))
        chunks = [c for entry in reader.blueprints() for c in reader.stream(store=entry)]
    return len({c.entity_path for c in chunks if re.fullmatch(r"/view/[^/]+", c.entity_path)})


def test_a_live_run_is_told_while_it_goes_on_and_its_file_survives_the_end_of_the_viewer(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    heard, file = tmp_path / "heard.rrd", tmp_path / "run.rrd"
    command = [RERUN, "--save", heard, "--bind", "127.0.0.1", "--port", str(port)]
    listener = subprocess.Popen(command, env=QUIET, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until(lambda: viewers._listens(port))
        assert viewers.listening_viewer(port) == f"rerun+http://127.0.0.1:{port}/proxy"
        trace = ego_trace(60.0)
        with open_recorder(file, live=viewers.listening_viewer(port)) as recorder:
            drive(recorder, trace[:3000], 20)
            until(lambda: heard_rows(heard) > 400)
            listener.kill()
            listener.wait()
            for end in range(3005, len(trace) + 1, 5):
                recorder.write(trace[end - 5 : end], traffic_at(end / 100, 20), no_path)
            recorder.close("done")
    finally:
        listener.kill()
        listener.wait()
    assert rerun("verify", file) == 0
    assert blueprint_views(heard) == blueprint_views(file) > 20, "the views that the viewer and the file were told of"
    times, _ = rows_of(file, "/world/ego", "Transform3D:translation")
    np.testing.assert_array_equal(times, np.r_[10, 50:60001:50] * 1_000_000)
    assert static_text(file)[-1] == "done"
