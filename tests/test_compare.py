"""A comparison shows what its runs did: curves, poses and traffic read back from the merged file, and a table."""

import os
import subprocess
import sys
import time
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun.chunk import RrdReader
from test_recording import rerun, rows_of, viewer

from emran_sumo import compare
from emran_sumo.drive import RunResult
from emran_sumo.errors import UserError
from emran_sumo.recording.colors import COMPARED
from emran_sumo.recording.comparison_layout import PLOTS, TABS
from emran_sumo.recording.table import read_trace

NAMES = ("pid-stanley", "coupled-emran")
GIVEN = {"duration": (2.5, "--duration"), "traffic.density": (2.0, "--density"), "warm_up": (2.0, "--set")}
SCALES = {"": 1.0, "deg": 180.0 / np.pi}


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> compare.Comparison:
    out = tmp_path_factory.mktemp("runs")
    return compare.compare("highway_dlc", NAMES, GIVEN, out, "emran-sumo compare ...")


def test_the_merged_file_is_whole_and_of_an_application_of_its_own(done):
    assert done.file.name == "compare.rrd"
    assert done.file.parent.name == "compare-seed1"
    assert rerun("verify", done.file) == 0
    (entry,) = RrdReader(str(done.file)).recordings()
    assert entry.application_id.startswith("emran_sumo highway_dlc-compare-seed1")
    assert not list(done.file.parent.glob("*.part"))


@pytest.mark.parametrize("curve", [plot.curves[0] for plot in PLOTS.values()], ids=lambda curve: curve.column)
def test_every_curve_of_every_controller_is_that_of_its_trace(done, curve):
    for i, name in enumerate(NAMES, 1):
        trace = read_trace(done.results[name].folder / "trace.parquet")
        component = f"trace:{curve.column}" + (f"_{curve.unit}" if curve.unit else "")
        times, values = rows_of(done.file, f"/plots/{i}_{name}", component)
        sampled = np.rint(trace["time"] * 100).astype(int) % 2 == 0
        np.testing.assert_array_equal(times, np.rint(trace["time"][sampled] * 1000).astype(np.int64) * 1_000_000)
        np.testing.assert_allclose(
            np.ravel(values), trace[curve.column][sampled] * SCALES[curve.unit], rtol=1e-6, atol=1e-30
        )


def test_every_plot_is_on_a_tab_and_every_tab_shows_plots_that_exist():
    assert {plot for plots in TABS.values() for plot in plots} == set(PLOTS)


def test_all_egos_stand_where_their_traces_say_and_the_camera_is_with_the_first(done):
    for i, name in enumerate(NAMES, 1):
        trace = read_trace(done.results[name].folder / "trace.parquet")
        places = np.column_stack((trace["x"], trace["y"]))[np.r_[0, 4 : len(trace["x"]) : 5]]
        for entity in (f"/world/ego/{i}_{name}", *(("/world/ego_frame",) if i == 1 else ())):
            times, shown = rows_of(done.file, entity, "Transform3D:translation")
            assert times[:2].tolist() == [10_000_000, 50_000_000], "where the file opens, and the first step"
            np.testing.assert_allclose(np.array(shown)[:, 0, :2], places, atol=1e-3)


def test_the_traffic_is_that_of_the_first_run_bit_for_bit(done):
    own = rows_of(done.results[NAMES[0]].folder / "run.rrd", "/world/traffic", "Boxes3D:centers")
    times, centers = rows_of(done.file, "/world/traffic", "Boxes3D:centers")
    np.testing.assert_array_equal(times, own[0])
    assert centers == own[1]
    assert sum(map(len, centers)) > 0


def test_both_runs_begin_in_the_same_traffic_and_keep_folders_of_their_own(done):
    first, second = (rows_of(r.folder / "run.rrd", "/world/traffic", "Boxes3D:centers") for r in done.results.values())
    assert first[1][0] == second[1][0]
    assert {r.folder.name for r in done.results.values()} == {"pid-stanley-seed1", "coupled-emran-seed1"}
    assert all((r.folder / "summary.json").is_file() for r in done.results.values())


def test_the_summary_says_whose_traffic_is_shown_and_tells_every_metric_of_every_run(done):
    (chunk,) = RrdReader(str(done.file)).stream().filter(content="/summary")
    ((text,),) = chunk.to_record_batch().column("TextDocument:text").to_pylist()
    assert text == done.file.with_suffix(".md").read_text(encoding="utf-8")
    assert "traffic shown is that of pid-stanley" in text
    rms = [f"{r.metrics['tracking']['cross_track_error_rms']:.4f}" for r in done.results.values()]
    (line,) = (line for line in text.splitlines() if line.startswith("| cross-track error, RMS"))
    assert [cell.strip(" *") for cell in line.split("|")[2:-1]] == rms


def test_the_viewer_draws_every_view_without_a_complaint(done, tmp_path):
    with viewer(done.file, tmp_path / "viewer.log") as client:
        client.set_time("sim_time", duration=2.0, play_state="paused")
        time.sleep(2.0)
        picture = np.asarray(Image.open(BytesIO(client.take_screenshot())).convert("RGB")).astype(int)
        views, logs = client.get_state().views, client.get_logs()
    assert [(v.name, v.reports) for v in views if v.reports] == []
    assert not [l.message for l in logs if l.level.upper() in ("WARN", "ERROR") and "asterizer" not in l.message]
    left, right = np.split(picture, [picture.shape[1] // 2], axis=1)
    for name, color in zip(NAMES, COMPARED, strict=False):
        for half in (left, right):  # the scene and the plots
            assert (np.abs(half - np.array(color)).max(axis=2) < 25).sum() > 30, f"{name} is not in the picture"


def result(ended: str, **values) -> RunResult:
    metrics = {}
    for measure in compare.MEASURES:
        metrics.setdefault(measure.group, {})[measure.key] = values.get(measure.key, 0)
    return RunResult(Path(), ended, "", metrics, np.zeros((0, 0)), None)  # pyright: ignore[reportArgumentType]


def best(key: str, **results: RunResult) -> set[str]:
    measure = next(m for m in compare.MEASURES if m.key == key)
    (row,) = (row for row in compare.rows(results) if row.words.startswith(measure.words))
    return {list(results)[i] for i in row.best}


def test_the_best_error_is_the_least_and_the_best_gap_the_largest():
    a, b = (result("finished", cross_track_error_rms=x, gap_min=x) for x in (0.1, 0.2))
    assert best("cross_track_error_rms", a=a, b=b) == {"a"}
    assert best("gap_min", a=a, b=b) == {"b"}


def test_nobody_ahead_is_the_best_gap():
    assert best("gap_min", a=result("finished", gap_min=9.0), b=result("finished", gap_min=None)) == {"b"}


def test_a_run_that_broke_off_is_no_candidate_for_the_best():
    a, b, c = (result(e, heading_error_rms=x) for e, x in (("diverged", 0.0), ("arrived", 0.1), ("finished", 0.2)))
    assert best("heading_error_rms", a=a, b=b, c=c) == {"b"}


def test_values_that_read_alike_are_equally_good_and_where_all_do_none_is_marked():
    a, b, c = (result("finished", gap_min=x) for x in (9.01, 9.02, 8.0))
    assert best("gap_min", a=a, b=b, c=c) == {"a", "b"}
    assert best("gap_min", a=a, b=b) == set()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("pid-stanly,coupled-emran", r'--controllers: found "pid-stanly"\. Did you mean "pid-stanley"\?'),
        ("pid-stanley", r"--controllers: .*accepted is two to 7 names"),
        ("", r"--controllers: .*accepted is two to 7 names"),
        ("pid-stanley,coupled-emran,pid-stanley", r'--controllers: found "pid-stanley" twice'),
    ],
)
def test_a_wrong_list_of_controllers_is_told_before_anything_is_driven(text, sentence):
    with pytest.raises(UserError, match=sentence):
        compare.chosen(text)


def test_a_wrong_key_costs_no_run(tmp_path):
    with pytest.raises(UserError, match=r"road\.frction"):
        compare.compare("highway_dlc", NAMES, {"road.frction": (0.5, "--set")}, tmp_path)
    assert not list(tmp_path.iterdir())


def test_an_interrupted_run_ends_the_comparison_and_leaves_an_older_one(monkeypatch, tmp_path):
    monkeypatch.setattr(compare.drive, "run", lambda *_, **__: result("interrupted"))
    older = tmp_path / "highway_dlc" / "compare-seed1" / "compare.rrd"
    older.parent.mkdir(parents=True)
    older.write_bytes(b"older")
    found = compare.compare("highway_dlc", NAMES, GIVEN, tmp_path)
    assert found.interrupted
    assert list(found.results) == ["pid-stanley"]
    assert older.read_bytes() == b"older"


def test_the_terminal_shows_a_column_per_controller_and_marks_the_best(tmp_path):
    words = [
        "compare",
        "highway_dlc",
        "--controllers",
        ",".join(NAMES),
        "--duration",
        "2",
        "--density",
        "2",
        "--seed",
        "3",
    ]
    words += ["--set", "warm_up=2", "--set", "road.friction=0.9"]
    command = [sys.executable, "-c", "from emran_sumo.cli import main; main()", *words]
    environment = {**os.environ, "COLUMNS": "140", "CI": "1"}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=environment, cwd=tmp_path, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].split() == list(NAMES)
    (line,) = (line for line in done.stdout.splitlines() if "cross-track error, RMS [m]" in line)
    assert line.count(" *") == 1
    assert "open it:  emran-sumo view runs/highway_dlc/compare-seed3/compare.rrd" in done.stdout
