"""Studies: the grid, the store, what survives a crash, and the answers."""

import csv
import json
import math
import os
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest

from emran_sumo import cli, scenario
from emran_sumo.errors import UserError
from emran_sumo.study import execute, figures, identity, plan, statistics, tables
from emran_sumo.study.display import progress, span
from emran_sumo.study.execute import Settings
from emran_sumo.study.plan import Given, Plan, Run
from emran_sumo.study.pool import LocalPool
from emran_sumo.study.report import write_report
from emran_sumo.study.store import FILE, Counts, Row, Store, is_running
from emran_sumo.study.worker import DONE, FAILED, NO_SPACE, Outcome, Task, together

ROOT = Path(__file__).parent.parent
TINY = {"duration": 1.0, "track.speed": 15.0}  # half a maneuver on the test bench, some milliseconds


def tiny(seeds=(1, 2), name="track_dlc", base=None, **axes):
    """A study on the test bench; axes by key, with `__` for a dot."""
    grid = {key.replace("__", "."): Given(tuple(values), "test") for key, values in axes.items()}
    given = {key: Given(value, "test") for key, value in {**TINY, **(base or {})}.items() if key not in grid}
    return Plan("tiny", "", (name,), given, grid, tuple(seeds))


def rows_of(folder):
    """What a study says about its runs, without what depends on the machine; as text, so that each bit counts."""
    with Store(folder) as store:
        rows = list(store.rows())
    keys = [row.run.key for row in rows]
    assert len(set(keys)) == len(keys)
    return [json.dumps([*row.run, row.state, row.ended, row.reason, row.error, row.metrics]) for row in rows]


def emran_sumo(*words, **options):
    command = [sys.executable, "-c", "from emran_sumo.cli import main; main()", *map(str, words)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def said_by(monkeypatch, capsys, *words):
    """Exit code and output of a command."""
    monkeypatch.setattr(sys, "argv", ["emran-sumo", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    out = capsys.readouterr()
    return ended.value.code or 0, out.out, out.err


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A study in traffic, driven once: 2 controllers x 2 densities x 3 seeds."""
    folder = tmp_path_factory.mktemp("study") / "small"
    of = Plan(
        "small", "A small study", ("highway_dlc",),
        {"duration": Given(2.0, "test"), "warm_up": Given(1.0, "test")},
        {"controller": Given(("pid-stanley", "coupled-emran"), "test"), "traffic.density": Given((3.0, 6.0), "test")},
        (1, 2, 3), record="worst",
    )  # fmt: skip
    execute.study(folder, of, Settings(workers=2))
    return folder, of


# the grid


def test_a_grid_is_every_combination_with_every_seed_and_each_run_is_another():
    runs, _ = plan.resolve(tiny((4, 5, 6), controller=("pid-stanley", "coupled-emran"), road__friction=(0.6, 1.0)))
    assert len(runs) == 2 * 2 * 3 == len({run.key for run in runs})
    assert [run.place for run in runs] == list(range(12))
    cells = [(r.factors["controller"], r.factors["road.friction"], r.given["seed"]) for r in runs]
    assert len(set(cells)) == 12


def test_every_controller_meets_every_seed_and_all_seeds_are_done_in_turn():
    runs, _ = plan.resolve(tiny((9, 3), controller=("pid-stanley", "coupled-emran")))
    driven = plan.in_order_of_driving(runs)
    assert [run.given["seed"] for run in driven] == [9, 9, 3, 3]
    assert {run.factors["controller"] for run in driven[:2]} == {"pid-stanley", "coupled-emran"}


@pytest.mark.parametrize(
    ("given", "found"),
    [(3, (1, 2, 3)), ("3", (1, 2, 3)), ("7,2", (7, 2)), ("5-8", (5, 6, 7, 8)), ((4, 9), (4, 9)), ("6,", (6,))],
)
def test_seeds_are_a_number_a_list_or_a_range(given, found):
    assert plan.seeds(given, "--seeds") == found


@pytest.mark.parametrize("given", [0, -1, "", "a", "3-1", "1,b", (1.5,), True, (2**31,), ()])
def test_other_seeds_are_refused(given):
    with pytest.raises(UserError, match=r"^--seeds: found .*; accepted is how many"):
        plan.seeds(given, "--seeds")


def test_values_of_the_command_line_are_numbers_names_and_lists():
    assert plan.values("5,10,0.5") == (5, 10, 0.5)
    assert plan.values("pid-stanley,coupled-emran") == ("pid-stanley", "coupled-emran")
    assert plan.values("true, false") == (True, False)
    assert plan.values("[1, 2], [3]") == ((1, 2), (3,))
    assert plan.values("") == ()


def test_a_file_and_the_command_line_say_the_same(tmp_path):
    file = tmp_path / "wet.toml"
    file.write_text(
        'scenario = "track_dlc"\nseeds = [4, 5]\n[set]\nduration = 1\n'
        '[grid]\ncontroller = ["pid-stanley"]\nroad.friction = [0.5, 1]\n'
    )
    grid = {"controller": Given(("pid-stanley",), "--controllers"), "road.friction": Given((0.5, 1), "--grid")}
    words = plan.changed(plan.of_scenario("track_dlc"), {"duration": Given(1.0, "--duration")}, grid, seeds=(4, 5))
    assert plan.is_study(file)
    assert not plan.is_study(ROOT / "scenarios/track_dlc/scenario.toml")
    assert [run.key for run in plan.resolve(plan.read(file))[0]] == [run.key for run in plan.resolve(words)[0]]


def test_the_command_line_wins_over_the_file():
    of = plan.changed(
        tiny(road__friction=(0.5, 1.0)),
        {"road.friction": Given(0.7, "--set")},
        {"duration": Given((1.0, 2.0), "--grid")},
    )
    assert set(of.axes) == {"duration"}
    assert of.base["road.friction"].value == 0.7
    assert "duration" not in of.base


def test_the_shipped_study_is_no_scenario():
    from emran_sumo.shipped import scenarios

    file = ROOT / "scenarios/studies/density.toml"
    of = plan.read(file)
    assert len(plan.resolve(of)[0]) == len(of.seeds) * math.prod(len(axis.value) for axis in of.axes.values())
    assert "studies" not in scenarios()


WRONG = {
    'scenario = "highway_dlc"\ngrids.controller = ["a"]': r'unknown key "grids.controller"\. Did you mean "grid"\?',
    'scenario = "highway_dlc"\n[grid]\nroad.frction = [1]': r'grid: unknown key "road.frction". Did you mean',
    'scenario = "highway_dlc"\n[grid]\nroad.friction = []': r"grid: road.friction: found no values; .* is empty",
    'scenario = "highway_dlc"\n[grid]\nroad.friction = 1': "accepted is a list of values",
    'scenario = "highway_dlc"\n[grid]\nroad.friction = [1, 1]': "found a value twice",
    'scenario = "highway_dlc"\n[grid]\nroad.friction = [1, 1.0]': "are the same as another",
    'scenario = "highway_dlc"\n[grid]\nroad.friction = [9]': r"road.friction: found 9; accepted is a number from 0.05",
    'scenario = "highway_dlc"\n[grid]\nseed = [9]': "accepted is the seeds of the study",
    'scenario = "highway_dlc"\n[grid]\ncontroller = ["pid"]': 'controller: found "pid". Did you mean',
    'scenario = "highway_dlc"\n[set]\nduration = 1\n[grid]\nduration = [2]': "accepted is one of both",
    'scenario = "nowhere"': 'Unknown scenario "nowhere"',
    "seeds = 3": "scenario: found nothing",
    "scenario = []": "scenario: found nothing",
    'scenario = "highway_dlc"\nseeds = 0': "seeds: found 0; accepted is how many",
    'scenario = "highway_dlc"\nrecord = "some"': 'record: found "some"; accepted is none, all, failed, worst',
    'scenario = "highway_dlc"\ntimeout = -1': "timeout: found -1",
    "scenario = ": "not valid TOML",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_study_file_is_answered_with_one_sentence(tmp_path, text):
    file = tmp_path / "study.toml"
    file.write_text(text)
    with pytest.raises(UserError, match=WRONG[text]) as error:
        plan.resolve(plan.read(file))
    assert "\n" not in str(error.value)


def test_the_command_of_a_run_drives_the_same_scenario(monkeypatch, tmp_path):
    axes = {"controller": ("pid-emran",), "track__speed_times": ((0.0, 1.0),), "track__speed_values": ((9.0, 11.5),)}
    run = plan.resolve(tiny((7,), base={"vehicle.tire.tires_per_axle": 1, "lateral.feedforward": False}, **axes))[0][0]
    seen = {}

    def no_drive(located, *_, **__):
        seen["located"] = located
        raise UserError("enough")

    monkeypatch.setattr("emran_sumo.drive.run", no_drive)
    monkeypatch.setattr(sys, "argv", shlex.split(plan.replay(run)))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        cli.main()
    assert plan.run_key(seen["located"]) == run.key


# the store


@pytest.mark.parametrize(
    ("library", "door"), [("sqlite3", "store"), ("matplotlib", "figures"), ("distributed", "cluster")]
)
def test_each_foreign_library_has_one_door(library, door):
    users = {f.stem for f in (ROOT / "emran_sumo/study").glob("*.py") if f"import {library}" in f.read_text()}
    assert users == {door}


def outcome(key, value=1.0):
    return Outcome(key, DONE, "finished", "", "", {"tracking.cross_track_error_rms": value}, 0.1, 0.05)


def runs_named(*names):
    return [Run(name, i, "track_dlc", "track_dlc", {}, {"seed": i}) for i, name in enumerate(names)]


def test_a_row_is_there_as_soon_as_it_is_written_even_if_nothing_is_closed(tmp_path):
    folder = tmp_path / "s"
    script = (
        "import os, sys; sys.path.insert(0, 'tests')\n"
        "from pathlib import Path; from test_study import Store, outcome, runs_named\n"
        f"store = Store(Path({str(folder)!r}), write=True); store.enroll(runs_named('a', 'b'))\n"
        "store.write(outcome('a', 0.1), 1); os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False).returncode == -signal.SIGKILL
    assert not is_running(folder)
    with Store(folder) as store:
        assert store.counts() == Counts(2, 1, 0)
        assert next(store.rows()).metrics == {"tracking.cross_track_error_rms": 0.1}
    with Store(folder, write=True) as store:
        assert store.keys(missing=True) == {"b"}


def test_one_coordinator_at_a_time_while_others_look(tmp_path):
    with Store(tmp_path / "s", write=True) as store:
        store.enroll(runs_named("a"))
        assert is_running(tmp_path / "s")
        with Store(tmp_path / "s") as other:
            assert other.counts().total == 1
        with pytest.raises(UserError, match="is running already"):
            Store(tmp_path / "s", write=True)
    assert not is_running(tmp_path / "s")
    Store(tmp_path / "s", write=True).__exit__()


def test_a_thousand_rows_stay_small_and_are_none_twice(tmp_path, small):
    with Store(small[0]) as store:
        metrics = next(store.rows()).metrics
    runs = runs_named(*(f"{i:024x}" for i in range(1000)))
    with Store(tmp_path / "s", write=True) as store:
        store.enroll(runs)
        store.enroll(runs)
        for run in runs:
            store.write(outcome(run.key)._replace(metrics=metrics), 1)
        store.write(outcome(runs[0].key), 1)
        assert store.counts() == Counts(1000, 1000, 0)
    assert sum(file.stat().st_size for file in (tmp_path / "s").iterdir()) < 50e6 / 5


def test_a_full_disk_is_one_sentence_and_loses_nothing(tmp_path):
    folder = tmp_path / "s"
    with Store(folder, write=True) as store:
        store.enroll(runs_named("a", "b"))
        store.write(outcome("a"), 1)
        store._connection.execute("PRAGMA max_page_count = 1")  # SQLite's own way to run out of space
        with pytest.raises(UserError, match="database or disk is full"):
            store.write(outcome("b")._replace(metrics={f"m{i}": 0.1 for i in range(5000)}), 1)
    with Store(folder) as store:
        assert store.counts() == Counts(2, 1, 0)
    with pytest.raises(UserError, match=r"stopped, no run is lost: .*No space"):
        execute.refuse_to_go_on(Outcome("a", NO_SPACE, error="OSError: [Errno 28] No space left on device"), folder)


@pytest.mark.parametrize("folder", ["/proc/study", "/dev/null/study"])
def test_a_folder_that_cannot_be_written_is_refused(folder):
    with pytest.raises(UserError, match=r"cannot be written: .*; accepted is a writable folder"):
        execute.study(Path(folder), tiny(), Settings(workers=1))


def test_a_folder_with_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(UserError, match="holds other files but no study"):
        execute.study(tmp_path, tiny(), Settings(workers=1))
    with pytest.raises(UserError, match="no study here"):
        Store(tmp_path)
    (tmp_path / FILE).write_text("no database at all, but long enough to be looked at" * 30)
    with pytest.raises(UserError, match="file is not a database"):
        Store(tmp_path)


# driving, dying, going on


def test_a_study_ends_with_every_row_and_driving_it_again_drives_nothing(small, monkeypatch):
    folder, of = small
    before = rows_of(folder)
    assert len(before) == 12
    assert all('"done"' in row for row in before)
    monkeypatch.setattr(execute, "open_pool", lambda *_: pytest.fail("there was nothing to drive"))
    assert execute.study(folder, of, Settings(workers=2)) == Counts(12, 12, 0)
    assert rows_of(folder) == before


def test_paired_seeds_meet_identical_traffic(small):
    with Store(small[0]) as store:
        rows = list(store.rows())
    for density in (3.0, 6.0):
        for seed in (1, 2, 3):
            pair = [r for r in rows if r.run.factors["traffic.density"] == density and r.run.given["seed"] == seed]
            counts = {row.metrics["run.vehicles_mean"] for row in pair}
            assert len(pair) == 2
            assert len(counts) == 1  # in two seconds no controller has changed the traffic


def test_a_row_is_what_a_single_run_gives_bit_for_bit(small, tmp_path):
    from emran_sumo import drive

    with Store(small[0]) as store:
        row = list(store.rows())[7]
    located = scenario.load(row.run.scenario, {key: (value, "test") for key, value in row.run.given.items()})
    result = drive.run(located, tmp_path, record=False)
    summary = json.loads((result.folder / "summary.json").read_text())
    assert together(summary) == (row.ended, row.reason, row.metrics)


def test_the_worst_runs_keep_a_recording(small):
    folder, _ = small
    with Store(folder) as store:
        rows = list(store.rows())
    kept = {row.run.key for row in rows if row.recording}
    assert kept == {row.run.key for row in statistics.worst(rows, execute.WORST)}
    for row in rows:
        if row.recording:
            assert (folder / row.recording).read_bytes()[:4] == b"RRF2"


def test_a_recording_of_another_drive_is_refused(small):
    with Store(small[0]) as store:
        one = next(store.rows())
    again = Outcome(one.run.key, DONE, metrics=dict(one.metrics))
    execute.refuse_other_numbers(again, one, small[0])
    again.metrics["run.distance"] = float(np.nextafter(again.metrics["run.distance"], np.inf))
    with pytest.raises(UserError, match="gave other numbers when driven again"):
        execute.refuse_other_numbers(again, one, small[0])


def counts_of(folder):
    try:
        with Store(folder) as store:
            return store.counts()
    except UserError:  # not begun yet
        return Counts(0, 0, 0)


def wait_for(folder, ended):
    """Wait until so many runs of a study have ended."""
    until = time.monotonic() + 120
    while sum(counts_of(folder)[1:]) < ended:
        assert time.monotonic() < until, "the study does not go on"
        time.sleep(0.01)


def workers_of(process):
    children = psutil.Process(process.pid).children()
    return [child.pid for child in children if any("spawn_main" in word for word in child.cmdline())]


def disturbed_and_undisturbed(tmp_path, seeds, kills):
    """Drive a study in peace; and once more, killing first a worker, then the coordinator at random moments."""
    words = [
        "study", "highway_dlc", "--controllers", "pid-stanley,coupled-emran", "--density", "3,6", "--seeds", seeds,
        "--set", "warm_up=1", "--set", "duration=2", "--workers", 2,
    ]  # fmt: skip
    calm = emran_sumo(*words, "--out", tmp_path / "calm")
    errors = calm.communicate()[1]
    assert calm.returncode == 0, errors
    rng, folder, total = np.random.default_rng(seeds), tmp_path / "killed", 4 * seeds
    moments = np.sort(rng.choice(np.arange(1, total - 4), 2 * kills, replace=False))  # runs that have ended by then
    for first, second in moments.reshape(kills, 2):
        process = emran_sumo(*words, "--out", folder)
        wait_for(folder, first)
        time.sleep(float(rng.uniform(0.0, 0.1)))
        os.kill(int(rng.choice(workers_of(process))), signal.SIGKILL)
        wait_for(folder, second)
        process.kill()
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert second <= sum(counts_of(folder)[1:]) < total
    last = emran_sumo(*words, "--out", folder, "--retry-failed")
    errors = last.communicate()[1]
    assert last.returncode == 0, errors
    assert counts_of(folder) == Counts(total, total, 0)
    assert rows_of(folder) == rows_of(tmp_path / "calm")
    for name in ("results.parquet", "results.csv"):
        assert (folder / name).read_bytes() == (tmp_path / "calm" / name).read_bytes()


def test_killed_workers_and_coordinators_change_no_bit_of_a_study(tmp_path):
    disturbed_and_undisturbed(tmp_path, 3, kills=1)


@pytest.mark.slow
def test_killed_workers_and_coordinators_change_no_bit_of_a_study_of_60_runs(tmp_path):
    disturbed_and_undisturbed(tmp_path, 15, kills=4)


def test_a_killed_coordinator_leaves_no_process_behind(tmp_path):
    process = emran_sumo(
        "study", "track_dlc", "--set", "duration=5000", "--seeds", 2, "--workers", 2, "--out", tmp_path / "s"
    )
    workers: list[int] = []
    until = time.monotonic() + 60
    while len(workers) < 2 and time.monotonic() < until:
        time.sleep(0.1)
        workers = workers_of(process)
    assert len(workers) == 2
    time.sleep(2.0)  # until they watch their parent
    process.kill()
    process.communicate()
    until = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        assert time.monotonic() < until, "a worker outlives its coordinator"
        time.sleep(0.1)


def test_a_stopped_study_says_how_to_go_on_and_goes_on(tmp_path):
    folder = tmp_path / "s"
    words = ["study", "track_dlc", "--set", "duration=1", "--seeds", 60, "--workers", 1, "--out", folder]
    for number, ended in ((signal.SIGTERM, 2), (signal.SIGINT, 20)):
        process = emran_sumo(*words)
        wait_for(folder, ended)
        process.send_signal(number)
        errors = process.communicate()[1]
        assert process.returncode == 130, errors
        assert "the same command goes on" in errors
        counts = counts_of(folder)
        assert ended <= counts.done < 60
        assert counts.failed == 0
    last = emran_sumo(*words)
    last.communicate()
    assert last.returncode == 0
    assert counts_of(folder) == Counts(60, 60, 0)


def test_a_process_that_died_while_idle_costs_nothing(tmp_path):
    run = plan.resolve(tiny((1,)))[0][0]
    located = scenario.load(run.scenario, {key: (value, "test") for key, value in run.given.items()})
    task = Task(run.key, run.scenario, run.given, identity.of([located]), 60.0, False, "test")
    pool = LocalPool(1, tmp_path / "log")
    try:
        (first,) = execute.outcomes(pool, iter([task]))
        pool._free[0]._process.kill()
        pool._free[0]._process.join()
        time.sleep(0.5)  # for the executor to notice
        (second,) = execute.outcomes(pool, iter([task]))
    finally:
        pool.close()
    assert first[0].state == second[0].state == DONE
    assert first[0].metrics == second[0].metrics


def test_a_crash_costs_only_its_run_and_is_tried_once_more(tmp_path):
    pool = LocalPool(2, tmp_path / "log")
    tasks = [Task(str(i), "", {}, {}, 60.0, False, "test") for i in range(5)]
    try:
        found = {}

        def submit(task):
            slot = pool._free.pop(0)
            job = os.abort if task.key == "2" else None
            future = slot._executor.submit(job) if job else slot._executor.submit(outcome, task.key)
            pool._busy[future] = slot
            return future

        pool.submit = submit
        for result, tries in execute.outcomes(pool, iter(tasks)):
            found[result.key] = (result.state, tries, result.error)
    finally:
        pool.close()
    assert found.pop("2") == (FAILED, 2, "the process that drove it died, 2 times")
    assert set(found.values()) == {(DONE, 1, "")}
    assert len(found) == 4


def test_a_hanging_run_is_given_up_and_the_others_are_driven(tmp_path):
    of = tiny((1,), duration=(1.0, 20_000.0, 2.0))._replace(timeout=6.0)
    assert execute.study(tmp_path / "s", of, Settings(workers=1)) == Counts(3, 2, 1)
    with Store(tmp_path / "s") as store:
        assert store.errors() == [("timed out after 6 s", 1)]
    assert execute.study(tmp_path / "s", of, Settings(workers=1)) == Counts(3, 2, 1)  # a failed run is a row


def test_failed_runs_are_rows_with_their_error_and_are_retried_only_when_asked(tmp_path):
    bad = tiny(
        (1, 2), base={"traffic.type": "nonsense", "warm_up": 0.0}, name="highway_dlc", controller=("pid-stanley",)
    )
    bad = bad._replace(base={k: v for k, v in bad.base.items() if k != "track.speed"})
    folder = tmp_path / "s"
    assert execute.study(folder, bad, Settings(workers=1)) == Counts(2, 0, 2)
    with Store(folder) as store:
        rows = list(store.rows())
    assert all("nonsense" in row.error for row in rows)
    assert [row.attempts for row in rows] == [1, 1]
    execute.study(folder, bad, Settings(workers=1))
    execute.study(folder, bad, Settings(workers=1, retry_failed=True))
    with Store(folder) as store:
        assert [row.attempts for row in store.rows()] == [2, 2]
    with pytest.raises(UserError, match="nothing to report"):
        write_report(folder)


def test_a_study_may_grow_but_never_mixes_with_another(tmp_path, monkeypatch):
    folder, of = tmp_path / "s", tiny((1, 2), road__friction=(0.8, 1.0))
    execute.study(folder, of, Settings(workers=1))
    before = rows_of(folder)
    grown = of._replace(seeds=(1, 2, 3), axes={"road.friction": Given((0.8, 0.9, 1.0), "test")})
    assert execute.study(folder, grown, Settings(workers=1)) == Counts(9, 9, 0)
    kept = {json.loads(row)[0]: json.loads(row)[5:] for row in rows_of(folder)}
    assert all(kept[json.loads(row)[0]] == json.loads(row)[5:] for row in before)
    for other, said in (
        (of, "seeds is"),
        (grown._replace(scenarios=("track_cruise",)), "holds another study, of track_dlc instead of track_cruise"),
        (grown._replace(base={**of.base, "duration": Given(1.5, "x")}), "track_dlc: duration was 1.0 and is now 1.5"),
    ):
        with pytest.raises(UserError, match=said):
            execute.study(folder, other, Settings(workers=1))
    now = identity.installed()
    monkeypatch.setattr(identity, "installed", lambda: {**now, "libsumo": "1.99.0"})
    with pytest.raises(UserError, match=f"libsumo was {now['libsumo']} and is now 1.99.0"):
        execute.study(folder, grown, Settings(workers=1))
    monkeypatch.setattr(identity, "installed", lambda: {**now, "source of emran_sumo": "0" * 16})
    with pytest.raises(UserError, match="source of emran_sumo has changed"):
        execute.study(folder, grown, Settings(workers=1))
    assert len(rows_of(folder)) == 9


def test_a_changed_file_is_named_also_while_the_study_runs(tmp_path):
    source = ROOT / "scenarios/highway_dlc"
    mine = tmp_path / "mine"
    shutil.copytree(source, mine)
    base = {"duration": Given(1.0, "test"), "warm_up": Given(0.0, "test"), "traffic.density": Given(1.0, "test")}
    of = Plan("mine", "", (str(mine),), base, {}, (1,))
    execute.study(tmp_path / "s", of, Settings(workers=1))
    routes = mine / "highway_dlc.rou.xml"
    routes.write_text(routes.read_text() + "<!-- another one -->")
    with pytest.raises(UserError, match=r"mine: highway_dlc.rou.xml has changed"):
        execute.study(tmp_path / "s", of, Settings(workers=1))
    (mine / "scenario.toml").write_text(
        (mine / "scenario.toml").read_text().replace("friction = 1.0", "friction = 0.9")
    )
    with pytest.raises(UserError, match=r"mine: road.friction was 1.0 and is now 0.9"):
        execute.study(tmp_path / "s", of, Settings(workers=1))

    def meddle(_what, counts):
        if counts.done == 1:
            routes.write_text(routes.read_text() + "<!-- now -->")

    with pytest.raises(UserError, match=r"highway_dlc.rou.xml has changed while the study ran"):
        execute.study(tmp_path / "t", of._replace(seeds=(1, 2, 3, 4)), Settings(workers=1), meddle)
    assert sum('"done"' in row for row in rows_of(tmp_path / "t")) >= 1


def test_the_same_study_through_a_dask_cluster_gives_the_same_rows(small, tmp_path):
    distributed = pytest.importorskip("distributed", reason='needs the extra "cluster"')
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=2, processes=True, dashboard_address=None, silence_logs=50
        ) as cluster:
            counts = execute.study(tmp_path / "s", small[1], Settings(dask=cluster.scheduler_address))
    assert counts == Counts(12, 12, 0)
    assert rows_of(tmp_path / "s") == rows_of(small[0])


def test_an_unreachable_cluster_is_one_sentence(tmp_path, monkeypatch, capsys):
    pytest.importorskip("distributed", reason='needs the extra "cluster"')
    monkeypatch.setattr("emran_sumo.study.cluster.PATIENCE", 0.5)
    for address, told in (
        ("tcp://127.0.0.1:1", "no cluster answers there"),
        ("nonsense://x", "accepted is the address"),
    ):
        words = ["study", "track_dlc", "--seeds", 1, "--dask", address, "--out", tmp_path / "s"]
        code, _, errors = said_by(monkeypatch, capsys, *words)
        assert code == 2
        assert errors.startswith("emran-sumo: --dask: found ")
        assert address in errors
        assert told in errors
        assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["highway_dlc", "--grid", "road.frction=1"], 'unknown key "road.frction"'),
        (["highway_dlc", "--density", ""], "the grid is empty"),
        (["highway_dlc", "--seeds", "none"], "--seeds: found"),
        (["highway_dlc", "--controllers", "pid"], 'controller: found "pid"'),
        (["highway_dlc", "--set", "friction"], "--set: found"),
        (["highway_dlc", "--record", "some"], "record: found"),
        (["nowhere"], "Unknown scenario"),
        (["nowhere.toml"], "no such scenario file"),
        (["status", "nowhere"], "no study here"),
        (["report", "nowhere"], "no study here"),
        (["highway_dlc", "--workers", "-1"], "--workers"),
    ],
)
def test_bad_words_are_one_sentence_and_exit_code_2(monkeypatch, capsys, tmp_path, words, said):
    monkeypatch.chdir(tmp_path)
    code, out, errors = said_by(monkeypatch, capsys, "study", *words)
    assert code == 2
    assert said in errors
    assert errors.count("\n") == 1
    assert not out
    assert not list(tmp_path.iterdir())


def test_a_dry_run_tells_size_time_and_disk_and_leaves_nothing(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = [
        "study",
        "track_dlc",
        "--controllers",
        "pid-stanley,coupled-emran",
        "--seeds",
        500,
        "--workers",
        2,
        "--dry-run",
    ]
    code, out, _ = said_by(monkeypatch, capsys, *words)
    assert code == 0
    assert "1000 runs: 2 combinations x 500 seeds" in out
    assert "on 2 workers" in out
    assert "disk: about" in out
    assert not list(tmp_path.iterdir())


def test_status_tells_how_far_a_study_is(monkeypatch, capsys, small):
    code, out, _ = said_by(monkeypatch, capsys, "study", "status", small[0])
    assert code == 0
    assert "complete: 12 of 12 runs, 0 failed" in out.replace("\n", " ")


def test_progress_tells_rate_and_time_left():
    assert progress(Counts(100, 38, 2), 20, 60.0) == "40 of 100 runs, 2 failed, 20 per minute, 3 min left"
    assert progress(Counts(100, 0, 0), 0, 1.0) == "0 of 100 runs, 0 failed"
    assert [span(s) for s in (5.4, 600.0, 7200.0)] == ["5 s", "10 min", "2.0 h"]


# statistics


def test_the_bootstrap_band_covers_the_true_mean_as_often_as_it_says():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(300):
        band = statistics.mean(rng.normal(3.0, 1.0, 20))
        hits += band.low <= 3.0 <= band.high
    assert 0.88 < hits / 300 < 0.98  # 95 % nominal; bootstrap bands of 20 values are known to be a little short


def test_bands_of_few_and_of_equal_values_say_what_they_can():
    assert statistics.mean(np.array([])).n == 0
    assert math.isnan(statistics.mean(np.array([2.0])).low)
    assert statistics.mean(np.array([2.0, 2.0, math.nan])) == (2, 2.0, 2.0, 2.0)


def test_a_rate_has_the_exact_poisson_interval():
    assert statistics.rate(0, 2.0).high == pytest.approx(-math.log(0.025) / 2.0)  # P(no event) = 2.5 % at the upper end
    ten = statistics.rate(10, 1.0)
    assert (ten.low, ten.high) == pytest.approx((4.795, 18.39), abs=0.01)  # Garwood's table
    assert math.isnan(statistics.rate(0, 0.0).value)


def test_a_paired_comparison_finds_what_an_unpaired_one_would_miss():
    rng = np.random.default_rng(2)
    traffic = rng.normal(10.0, 5.0, 20)
    found = statistics.paired(traffic, traffic - 0.5 + rng.normal(0.0, 0.1, 20))
    assert found.p < 1e-4
    assert found.low < -0.5 < found.high
    assert found.lower == 1.0
    assert found.relative == pytest.approx(found.value / traffic.mean())
    same = statistics.paired(traffic, traffic)
    assert (same.value, same.p) == (0.0, 1.0)
    one_missing = statistics.paired(np.append(traffic, math.nan), np.append(traffic, 1.0))
    assert one_missing.n == 20


def test_wilcoxon_of_all_lower_is_its_closed_form():
    first = np.arange(8.0)
    assert statistics.paired(first, first - np.linspace(1, 2, 8)).p == pytest.approx(2 * 0.5**8)


def test_holm_corrects_step_by_step():
    assert statistics.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert statistics.holm([0.9, math.nan, 0.8])[:1] == [1.0]


def row(seed, metrics, ended="finished", controller="a", density=5.0):
    run = Run(f"{controller}{density}{seed}", seed, "x", "x", {"controller": controller, "traffic.density": density},
              {"controller": controller, "traffic.density": density, "seed": seed})  # fmt: skip
    return Row(run, "done", ended, "", "", metrics, 1.0, 1.0, 1.0, 1, "")


def test_the_worst_runs_are_crashes_then_near_misses_then_errors():
    def made(seed, ttc, error, ended="finished"):
        return row(seed, {tables.LEAST_TTC: ttc, "tracking.cross_track_error_max": error}, ended)

    rows = [
        made(1, 9.0, 0.1),
        made(2, None, 0.5),
        made(3, 2.0, 0.1),
        made(4, 5.0, 0.1, "collision"),
        made(5, None, 0.7),
    ]
    assert [r.run.given["seed"] for r in statistics.worst(rows, 4)] == [4, 3, 1, 5]


def test_metrics_count_what_never_came_close_as_the_horizon():
    ttc = next(m for m in tables.METRICS if m.key == tables.LEAST_TTC)
    values = [tables.metric_of(row(1, {tables.LEAST_TTC: v}), ttc) for v in (None, 50.0, 2.0)]
    assert values == [tables.HORIZON, tables.HORIZON, 2.0]
    assert math.isnan(tables.metric_of(row(1, {}), ttc))
    assert math.isnan(tables.metric_of(None, ttc))
    assert tables.metric_of(row(1, {"run.distance": 500.0, "run.simulated": 25.0}), tables.TRAVEL_TIME) == 50.0


def test_collisions_are_counted_per_distance_of_all_runs():
    rows = [row(s, {"run.distance": 250e3, "safety.collisions": int(s == 1)}) for s in (1, 2)]
    (cut,) = tables.slices(rows, {"controller": [], "traffic.density": []}, ["x"])
    (found,) = figures.collision_rates(cut, "a")
    assert found.value == pytest.approx(2.0)  # one in 500 km


def test_every_further_factor_makes_a_slice_of_its_own():
    rows = []
    for friction in (0.5, 1.0):
        for controller in ("a", "b"):
            for density in (30.0, 5.0):
                one = row(1, {"run.distance": 1.0}, controller=controller, density=density)
                rows.append(one._replace(run=one.run._replace(factors={**one.run.factors, "road.friction": friction})))
    cuts = tables.slices(rows, {key: [] for key in rows[0].run.factors}, ["x"])
    assert [cut.fixed for cut in cuts] == [{"road.friction": 0.5}, {"road.friction": 1.0}]
    assert all((cut.x, cut.xs, cut.names) == ("traffic.density", (5.0, 30.0), ("a", "b")) for cut in cuts)


def test_several_egos_are_one_row_of_sums_extremes_and_means():
    def ego(ended, ttc, distance, rms):
        metrics = {"safety": {"time_to_collision_min": ttc, "collisions": int(ended == "collision")},
                   "run": {"distance": distance}, "tracking": {"e_rms": rms, "e_max": rms}}  # fmt: skip
        return {"ended": ended, "reason": f"{ended} it is", "metrics": metrics}

    egos = {
        "a": ego("finished", None, 100.0, 1.0),
        "b": ego("collision", 0.1, 50.0, 2.0),
        "c": ego("lost", 4.0, 1.0, 6.0),
    }
    ended, reason, found = together({**egos["a"], "egos": egos})
    assert (ended, reason) == ("collision", "collision it is")
    assert found == {
        tables.LEAST_TTC: 0.1, "safety.collisions": 1, "run.distance": 151.0, "run.egos": 3,
        "tracking.e_rms": 3.0, "tracking.e_max": 6.0,
    }  # fmt: skip


# the report


@pytest.fixture(scope="module")
def reported(small):
    write_report(small[0])
    return small[0]


def test_the_tables_hold_every_run_with_its_metrics_and_its_command(reported):
    found = pq.read_table(reported / "results.parquet").to_pydict()
    with (reported / "results.csv").open() as stream:
        text = list(csv.DictReader(stream))
    assert len(text) == 12 == len(found["seed"])
    with Store(reported) as store:
        for i, one in enumerate(store.rows()):
            assert found["command"][i] == text[i]["command"] == plan.replay(one.run)
            for name, value in one.metrics.items():
                assert found[name][i] == value
                assert text[i][name] == ("" if value is None else repr(value) if value != "" else value)
    assert "wall" not in found


def test_the_page_is_self_contained_and_says_what_was_asked(reported):
    page = (reported / "report.html").read_text()
    assert "A small study" in page
    for text in ("Paired differences to pid-stanley", "Distribution of the least time", "per 1000 km",
                 "Fundamental diagram", "emran-sumo run highway_dlc --", "Wilcoxon"):  # fmt: skip
        assert text in page
    assert page.count("data:image/svg+xml;base64,") == 5
    for outside in ("http://", "https://", "<script", "<link"):
        assert outside not in page


def test_the_report_of_the_same_rows_is_the_same(reported, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(reported, copy)
    write_report(copy)
    for name in ("results.parquet", "results.csv", "report.html", "figures/metrics.pdf", "figures/traffic.png"):
        assert (copy / name).read_bytes() == (reported / name).read_bytes()


def test_a_report_of_a_half_done_study_and_of_one_controller_is_possible(tmp_path):
    of = tiny((1, 2), road__friction=(0.8, 1.0))
    execute.study(tmp_path / "s", of, Settings(workers=1))
    connection = sqlite3.connect(tmp_path / "s" / FILE)
    connection.execute("UPDATE runs SET state = NULL, metrics = NULL WHERE place = 3")
    connection.execute("UPDATE runs SET state = 'failed', error = 'it <broke>', metrics = NULL WHERE place = 2")
    connection.commit()
    connection.close()
    *_, page = write_report(tmp_path / "s")
    text = page.read_text()
    assert "2 of 4 done, 1 failed" in text
    assert "it &lt;broke&gt;" in text
    assert "Paired differences" not in text


CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
PROBE = """<script>addEventListener("load", () => {
  const images = [...document.images];
  document.body.dataset.probe = JSON.stringify({
    images: images.length, drawn: images.filter(i => i.complete && i.naturalWidth > 300 && i.offsetWidth > 300).length,
    alt: images.filter(i => i.alt).length, wide: document.documentElement.scrollWidth - innerWidth,
    tables: document.querySelectorAll("table").length, rows: document.querySelectorAll(".worst tbody tr").length,
  });
});</script></body>"""


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize("width", [1280, 700])
def test_a_browser_shows_the_page_with_all_figures_and_nothing_sticks_out(reported, tmp_path, width):
    page = tmp_path / "page.html"
    page.write_text((reported / "report.html").read_text().replace("</body>", PROBE))
    options = ["--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
               f"--window-size={width},900", "--virtual-time-budget=5000"]  # fmt: skip
    run = subprocess.run(
        [CHROMIUM, *options, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    probe = run.stdout.partition('data-probe="')[2].partition('"')[0].replace("&quot;", '"')
    seen = json.loads(probe)
    assert seen["images"] == seen["drawn"] == seen["alt"] == 5
    assert seen["wide"] <= 0
    assert seen["tables"] == 3
    assert seen["rows"] == 10
    pdf = tmp_path / "page.pdf"
    subprocess.run([CHROMIUM, *options, f"--print-to-pdf={pdf}", (reported / "report.html").as_uri()],
                   capture_output=True, timeout=120, check=True)  # fmt: skip
    assert pdf.read_bytes().startswith(b"%PDF")
    assert 2 <= pdf.read_bytes().count(b"/Type /Page\n") <= 8
