"""A user's own controller drives through its door like a built-in law, and its faults are told by file and line."""

import itertools
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import emran_sumo
from emran_sumo import BuiltIn, Command, cli, compare, drive, load, run, scenario
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.errors import UserError
from emran_sumo.faults import ControllerFault
from emran_sumo.observation import Observation
from emran_sumo.study import execute, identity, plan
from emran_sumo.study.execute import Settings
from emran_sumo.study.plan import Given, Plan
from emran_sumo.study.store import Store
from emran_sumo.user_code import sources, text_of

PAGE = Path(__file__).parent.parent / "docs" / "own-controller.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
SHORT = {"duration": 2.0}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to be in, which leaves nothing importable behind."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def said_by(monkeypatch, capsys, *words):
    """Exit code and output of a command."""
    monkeypatch.setattr(sys, "argv", ["emran-sumo", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    out = capsys.readouterr()
    return ended.value.code or 0, out.out, out.err


def law(body, *, head=""):
    """Source of a controller whose step is `body`, which begins in line 7 without a head."""
    reset = "    def reset(self):\n        self.count = 0\n\n"
    return f"{head}class Law:\n{reset}    def step(self, seen):\n        self.count += 1\n{body}"


class Straight:
    """Holds the speed and steers by the errors."""

    made = 0

    def __init__(self):
        type(self).made += 1
        self.resets, self.seen = 0, []

    def reset(self):
        self.resets += 1

    def step(self, seen):
        self.seen.append(seen)
        steer = 0.2 * seen.cross_track_error + seen.heading_error - 0.05 * seen.yaw_rate
        return steer, 1.0 * (seen.speed_reference - seen.speed)


# bit for bit

NOISY = {"sensors.cross_track": 0.01, "sensors.speed": 0.02, "sensors.accel": 0.1, "rates.command_delay": 0.02}
CASES = {
    "coupled-emran, test bench": ("track_dlc", "coupled-emran", {"duration": 7.0}),
    "coupled-emran, noise and delay": ("track_dlc", "coupled-emran", {"duration": 4.0, **NOISY}),
    "pid-stanley, test bench": ("track_dlc", "pid-stanley", {"duration": 4.0}),
    "stanley-emran, conditioned path": ("track_dlc", "stanley-emran", {"duration": 4.0, "lateral.conditioning": True}),
    "lqr": ("track_dlc", "lqr", {"duration": 2.0}),
    "adrc": ("track_dlc", "adrc", {"duration": 2.0}),
    "ekf-t2fnn": ("track_dlc", "ekf-t2fnn", {"duration": 2.0}),
    "coupled-mran": ("track_dlc", "coupled-mran", {"duration": 2.0}),
    "coupled-emran, traffic": ("highway_dlc", "coupled-emran", {"duration": 8.0, "warm_up": 4.0}),
}


@pytest.mark.parametrize(("name", "controller", "given"), CASES.values(), ids=CASES)
def test_a_built_in_law_through_the_door_gives_the_same_trace_bit_for_bit(tmp_path, name, controller, given):
    located = load(name, controller=controller, **given)
    own = load(name, controller="emran_sumo:BuiltIn", **given)
    own = own._replace(values=located.values._replace(controller="emran_sumo:BuiltIn"))
    direct, through = (run(one, tmp_path, record=False) for one in (located, own))
    assert direct.folder != through.folder
    assert direct.trace.tobytes() == through.trace.tobytes()
    assert direct.ended == through.ended


def test_the_plain_own_controller_is_the_scheme_without_networks_and_without_the_guard_of_the_tires():
    own, base = (load("track_dlc", controller=name).values for name in ("emran_sumo:BuiltIn", "coupled-base"))
    lateral = own.lateral._replace(slip_limit=base.lateral.slip_limit, emran=base.lateral.emran)
    assert own.lateral.emran.authority == 0.0
    assert (own.longitudinal, lateral) == (base.longitudinal, base.lateral)


# what it sees and gives


def test_every_period_is_asked_for_once_with_what_the_trace_says_of_its_start(tmp_path):
    control = Straight()
    result = run(load("track_dlc", controller=control, **SHORT), tmp_path, record=False)
    assert (control.resets, len(control.seen)) == (1, 200)
    np.testing.assert_allclose([seen.time for seen in control.seen], np.arange(200) * 0.01, atol=1e-12)
    for name, field in (("x", "x"), ("y", "y"), ("yaw", "yaw"), ("speed_long", "speed"), ("speed_lat", "speed_lat"),
                        ("yaw_rate", "yaw_rate"), ("steer", "steer"), ("cross_track_error", "cross_track_error"),
                        ("heading_error", "heading_error"), ("reference_curvature", "curvature"),
                        ("speed_reference", "speed_reference")):  # fmt: skip
        seen = [getattr(o, field) for o in control.seen[1:]]
        np.testing.assert_allclose(seen, result.signals[name][:-1], rtol=0, atol=1e-9, err_msg=name)
    steer = [0.2 * o.cross_track_error + o.heading_error - 0.05 * o.yaw_rate for o in control.seen]
    np.testing.assert_array_equal(result.signals["steer_command"], steer)


def test_the_preview_runs_along_the_path_and_ends_with_it(tmp_path):
    control = Straight()
    run(load("track_dlc", controller=control, **SHORT), tmp_path, record=False)
    seen: Observation = control.seen[0]
    ahead = [seen.preview(d) for d in np.arange(0.0, 30.0, 0.5)]
    steps = [np.hypot(b.x - a.x, b.y - a.y) for a, b in itertools.pairwise(ahead)]
    np.testing.assert_allclose(steps, 0.5, atol=1e-3)
    assert ahead[0].position == seen.position
    last = seen.preview(1e6)
    np.testing.assert_allclose((last.x, last.y), (seen.path.x[-1], seen.path.y[-1]), atol=1e-3)


def test_the_command_is_what_acts_and_its_limits_are_those_of_the_car(tmp_path):
    class Hard(Straight):
        def step(self, seen):
            return np.array([2.0, -50.0], dtype=np.float32) if seen.time > 0.5 else (0.0, np.float64(0.0))

    result = run(load("track_dlc", controller=Hard, duration=1.0), tmp_path, record=False)
    late = result.signals[result.signals["time"] > 0.52]
    limits = load("track_dlc").values
    assert set(late["steer_law"]) == {2.0}
    assert set(late["steer_command"]) == {limits.vehicle.steer_limit}
    assert set(late["accel_command"]) == {-limits.longitudinal.decel_max}


# aided

PUSHED = {"disturbance.lateral_force": 1000.0, "disturbance.wind": 10.0}


def test_an_aided_law_learns_and_follows_better_under_a_force_from_the_side(tmp_path):
    given = {"duration": 12.0, "track.shape": "straight", "track.speed": 15.0, **PUSHED}
    alone, aided = (
        run(load("track_dlc", controller=Straight, **given, **keys), tmp_path, record=False)
        for keys in ({}, {"lateral.emran.authority": 1.0, "longitudinal.emran.authority": 1.0})
    )
    assert not alone.signals["steer_network"].any()
    assert not alone.signals["learned_steering"].any()
    assert aided.signals["learned_steering"][-1] > 0
    assert aided.signals["learned_speed"][-1] > 0
    np.testing.assert_array_equal(  # the law's part is the user's own, on whatever errors are left
        aided.signals["steer_command"], aided.signals["steer_law"] + aided.signals["steer_network"]
    )
    lasting = alone.signals["time"] > 8.0
    rms = [float(np.sqrt(np.mean(r.signals["cross_track_error"][lasting] ** 2))) for r in (alone, aided)]
    assert rms[0] > 0.02  # a P law leaves an error under a constant force
    assert rms[1] < 0.3 * rms[0]  # what the slow rates of an own controller take off in 8 s


def test_a_half_that_gives_its_parts_is_not_aided_a_second_time(tmp_path):
    class Half:
        def reset(self):
            self.rest = BuiltIn()
            self.rest.reset()

        def step(self, seen):
            turn = self.rest.steering(seen)
            return Command(turn.angle, 2.0 * (seen.speed_reference - seen.speed), turn)

    keys = {"lateral.emran.authority": 1.0, "longitudinal.emran.authority": 1.0, **PUSHED}
    signals = run(load("track_dlc", controller=Half, duration=4.0, **keys), tmp_path, record=False).signals
    assert signals["learned_speed"][-1] > 0
    assert signals["learned_steering"][-1] > 0
    for half in ("accel", "steer"):
        total = signals[f"{half}_law"] + signals[f"{half}_network"]
        np.testing.assert_array_equal(signals[f"{half}_command"], total)
    assert np.abs(signals["steer_law"] - signals["steer_command"]).max() > 0.0


# faults

FAULTS = {
    "exception": (law("        return 0.0, 1 / (self.count - 50)\n"), "mine.py, line 7: ZeroDivisionError: .* 0.49"),
    "exception in a helper": (
        law("        return helper(self.count)\n", head="def helper(n):\n    return {}[n]\n\n\n"),
        "mine.py, line 2: KeyError: 1, after 0.00 s",
    ),
    "exception below numpy": (
        law("        return np.linalg.inv(np.zeros((2, 2)))\n", head="import numpy as np\n"),
        "mine.py, line 8: LinAlgError: Singular matrix",
    ),
    "NaN": (law("        return float('nan'), 0.0\n"), r"mine.py, line 5: step returned nan for steer; .*\[rad\]"),
    "infinity": (law("        return 0.0, 1e999\n"), r"mine.py, line 5: step returned inf for accel; .*\[m/s\^2\]"),
    "wrong shape": (law("        return 0.0, 0.0, 0.0\n"), r"line 5: step returned \(0.0, 0.0, 0.0\); accepted is"),
    "array for a number": (law("        return [0.0], 0.0\n"), r"line 5: step returned \[0.0\] for steer; accepted"),
    "nothing": (law("        pass\n"), "mine.py, line 5: step returned None; accepted is Command"),
    "text": (law("        return '12'\n"), "mine.py, line 5: step returned '12'; accepted is Command"),
    "wrong parts": (
        law("        return Command(0.0, 0.0, 1.0)\n", head="from emran_sumo import Command\n"),
        "mine.py, line 6: step returned 1.0 for steer_parts; accepted is a SteeringCommand",
    ),
    "exit": (law("        raise SystemExit(0)\n"), "mine.py, line 7: SystemExit: 0"),
    "too large": (law("        return 0.0, 10**400\n"), r"mine.py, line 5: step returned 10+\.\.\. for accel; accept"),
    "too large in a Command": (
        law("        return Command(10**400, 0)\n", head="from emran_sumo import Command\n"),
        r"mine.py, line 6: step returned 10+\.\.\. for steer; accepted is a finite number \[rad\]",
    ),
    "exit at import": ("import sys\n\nsys.exit('no licence')\n", "mine.py, line 3: SystemExit: no licence"),
    "silent exit at import": ("raise SystemExit\n", r"mine.py, line 1: SystemExit\."),
    "exit in the factory": ("def Law():\n    raise SystemExit(0)\n", "mine.py, line 2: SystemExit: 0; accepted is"),
    "exit in reset": (
        "import sys\n\n\nclass Law:\n    step = print\n\n    def reset(self):\n        sys.exit(3)\n",
        r"mine.py, line 8: SystemExit: 3 in reset",
    ),
    "missing attribute": (law("        return seen.sped, 0.0\n"), "mine.py, line 7: AttributeError: .*'sped'"),
    "no step": ("class Law:\n    def reset(self):\n        pass\n", r"mine.py, line 1: Law has no step\(\); accept"),
    "no reset": ("class Law:\n    def step(self, seen):\n        pass\n", r"mine.py, line 1: Law has no reset\(\);"),
    "reset fails": ("class Law:\n    step = reset = lambda self: {}[3]\n", r"mine.py, line 2: KeyError: 3 in reset"),
    "factory fails": ("def Law():\n    raise ValueError('no gains')\n", "mine.py, line 2: ValueError: no gains"),
    "factory wants more": ("class Law:\n    def __init__(self, k):\n        pass\n", "py, line 1: TypeError: .*'k'"),
    "syntax": ("class Law:\n    def reset(self)\n", "mine.py, line 2: SyntaxError: expected ':'"),
    "import": ("\nimport nowhere_to_be_found\n", "mine.py, line 2: ModuleNotFoundError: No module named 'nowhere"),
    "no factory": ("class Laws:\n    pass\n", 'found "mine.py:Law"; mine.py has no "Law". Did you mean "Laws"?'),
}  # fmt: skip


@pytest.mark.parametrize(("source", "sentence"), FAULTS.values(), ids=FAULTS)
def test_a_fault_ends_the_run_with_a_sentence_that_names_file_and_line(here, monkeypatch, capsys, source, sentence):
    (here / "mine.py").write_text(source)
    code, _, err = said_by(monkeypatch, capsys, "run", "track_dlc", "--controller", "mine.py:Law", "--no-record",
                           "--set", "duration=1")  # fmt: skip
    assert code == 2
    first = err.splitlines()[0]
    assert first.startswith("emran-sumo: controller")
    assert re.search(sentence, first), first
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("text", "sentence"),
    {
        "gone.py:Law": r'controller: found "gone.py:Law"; no such file: gone.py\.',
        "gone:Law": r'controller: found "gone:Law"; no module "gone" here or installed\.',
        ":Law": r'controller: found ":Law"; accepted is module:factory or path/to/file.py:factory\.',
        "mine.py": r'--controller: controller: found "mine.py"\. .*or your own: module:factory',
    }.items(),
)
def test_what_cannot_be_found_is_told(here, monkeypatch, capsys, text, sentence):
    code, _, err = said_by(monkeypatch, capsys, "run", "track_dlc", "--controller", text)
    assert code == 2
    assert re.fullmatch(f"emran-sumo: {sentence}.*\n", err), err
    assert not (here / "runs").exists()


def test_what_was_driven_before_a_fault_is_kept(tmp_path):
    class Late(Straight):
        def step(self, seen):
            return (math_error() if seen.time > 0.98 else 0.0), 0.0

    def math_error():
        return 1 / 0

    with pytest.raises(ControllerFault, match=r"test_own_controller.py, line \d+: ZeroDivisionError") as caught:
        run(load("highway_dlc", controller=Late, duration=4.0, warm_up=2.0), tmp_path)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    (folder,) = (tmp_path / "highway_dlc").iterdir()
    assert str(folder) in caught.value.__notes__[0]
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["ended"] == "fault"
    assert summary["reason"] + "." == str(caught.value)
    trace = pq.read_table(folder / "trace.parquet")
    assert trace["time"].to_pylist()[-1] == pytest.approx(1.0)  # the SUMO step of the fault is driven to its end
    assert (folder / "run.rrd").stat().st_size > 10_000


# several egos, several places


def test_every_ego_has_a_controller_of_its_own(tmp_path):
    Straight.made = 0
    result = run(load("highway_dlc", controller=Straight, duration=1.0, warm_up=4.0, ego="",
                      **{"egos.penetration": 0.2, "traffic.density": 6.0}), tmp_path, record=False)  # fmt: skip
    egos = json.loads((result.folder / "summary.json").read_text())["egos"]
    assert len(egos) > 3
    assert Straight.made == len(egos)


def test_an_object_serves_the_first_ego_and_copies_of_it_the_others(tmp_path):
    control = Straight()
    run(load("highway_dlc", controller=control, duration=1.0, warm_up=4.0, ego="",
             **{"egos.penetration": 0.2, "traffic.density": 6.0}), tmp_path, record=False)  # fmt: skip
    assert (control.resets, len(control.seen)) == (1, 100)


def test_a_comparison_takes_own_and_built_in_ones(here):
    (here / "laws").mkdir()
    (here / "laws" / "mine.py").write_text(law("        return seen.heading_error, 0.0\n"))
    names = compare.chosen("pid-stanley,laws/mine.py:Law")
    found = compare.compare("track_dlc", names, {"duration": (1.0, "test")}, here / "out")
    assert list(found.results) == ["pid-stanley", "laws.mine.Law"]
    assert found.file.is_file()
    with pytest.raises(UserError, match="twice"):
        compare.chosen("laws/mine.py:Law,laws.mine:Law")


def test_a_study_drives_own_controllers_in_its_processes_and_marks_the_one_that_fails(here):
    (here / "good.py").write_text(
        law("        return gain * seen.heading_error, 0.0\n", head="from aside import gain\n")
    )
    (here / "aside.py").write_text("gain = 0.5\n")
    (here / "bad.py").write_text(law("        return 0.0, 1 / (self.count - 50)\n"))
    axes = {"controller": Given(("good.py:Law", "bad:Law", "pid-stanley"), "test")}
    of = Plan("own", "", ("track_dlc",), {"duration": Given(1.0, "test")}, axes, (1, 2))
    counts = execute.study(here / "study", of, Settings(workers=2))
    assert (counts.done, counts.failed) == (4, 2)
    with Store(here / "study") as store:
        rows = {(row.run.factors["controller"], row.run.given["seed"]): row for row in store.rows()}
    for seed in (1, 2):
        bad = rows["bad:Law", seed]
        assert re.fullmatch(
            r"controller bad:Law: bad.py, line 7: ZeroDivisionError: division by zero, after 0.49 s\.", bad.error
        )
        good = rows["good.py:Law", seed].run
        assert "--controller good.py:Law" in plan.replay(good)
    (here / "aside.py").write_text("gain = 0.6\n")
    with pytest.raises(UserError, match=r"not as this study was begun: track_dlc: aside.py has changed"):
        execute.study(here / "study", of, Settings(workers=2))


def test_a_changed_controller_is_read_anew_and_another_run(here):
    (here / "mine.py").write_text(law("        return 0.0, 0.0\n"))
    located = load("track_dlc", controller="mine.py:Law", duration=1.0)
    first = run(located, here / "a", record=False)
    before = identity.of([located])
    (here / "mine.py").write_text(law("        return 0.001, 0.0\n"))
    second = run(located, here / "a", record=False)
    assert set(first.signals["steer_law"]) == {0.0}
    assert set(second.signals["steer_law"]) == {0.001}
    assert identity.differences(before, identity.of([located])) == ["track_dlc: mine.py has changed"]


def test_the_manifest_repeats_the_run_from_the_command_line(here, monkeypatch, capsys):
    (here / "mine.py").write_text(law("        return 0.3 * seen.heading_error, 0.5\n"))
    located = load("track_dlc", controller="mine.py:Law", seed=3, duration=1.0, **{"track.speed": 12.0})
    first = run(located, here / "a", record=False)
    told = json.loads((first.folder / "summary.json").read_text())["manifest"]
    assert list(told["controller_sources"]) == ["mine.py"]
    words = told["command"].split()[1:]
    said_by(monkeypatch, capsys, *words, "--no-record", "--out", here / "b")
    (again,) = (here / "b" / "track_dlc").iterdir()
    assert pq.read_table(again / "trace.parquet").equals(pq.read_table(first.folder / "trace.parquet"))


def test_an_own_controller_is_named_by_where_it_can_be_found():
    assert text_of(BuiltIn) == "emran_sumo.observation:BuiltIn"
    assert text_of(BuiltIn()) == "emran_sumo.observation:BuiltIn"
    own = load("track_dlc", controller=BuiltIn)
    assert own.values.controller == "emran_sumo.observation:BuiltIn"
    assert "observation.py" in next(iter(sources(own)))
    assert set(CONTROLLERS).isdisjoint({own.values.controller})


def test_the_tables_and_searches_refuse_an_own_controller():
    from emran_sumo.bench import drive_track

    with pytest.raises(UserError, match="accepted here is a built-in one"):
        drive_track(load("track_dlc", controller="emran_sumo:BuiltIn").values)


# the page


def test_the_page_s_example_drives_the_double_lane_change_in_traffic(here):
    source = BLOCKS[0]
    assert len([line for line in source.splitlines() if line.strip()]) <= 20
    (here / "pursuit.py").write_text(source)
    located = load("highway_dlc", controller="pursuit.py:PurePursuit", **{"traffic.density": 10.0})
    result = run(located, here / "runs")
    assert result.ended == "finished"
    assert result.metrics["safety"]["collisions"] == 0
    assert result.metrics["tracking"]["cross_track_error_rms"] < 0.25
    assert result.metrics["tracking"]["speed_error_rms"] < 0.2
    assert np.ptp(result.signals["reference_y"]) > 3.0  # it did change lanes


def rms_of_the_example(here, name, **given):
    (here / "pursuit.py").write_text(BLOCKS[0])
    result = run(load(name, controller="pursuit.py:PurePursuit", **given), here / "runs", record=False)
    assert result.ended == "finished"
    return float(np.sqrt(np.mean(result.signals["cross_track_error"] ** 2)))


def test_the_page_s_aid_does_the_example_no_harm_and_helps_it_against_a_force(here):
    aid = {"lateral.emran.authority": 1.0}
    lasting = {"duration": 24.0}  # both lane changes at 20 m/s
    alone, aided = (rms_of_the_example(here, "highway_dlc", **lasting, **keys) for keys in ({}, aid))
    assert aided < 1.03 * alone
    force = {"disturbance.lateral_force": 1000.0}
    alone, aided = (rms_of_the_example(here, "track_dlc", **force, **keys) for keys in ({}, aid))
    assert aided < 0.85 * alone


def test_the_aid_of_an_own_controller_is_slow_enough_for_a_law_that_swings_by_itself(here):
    swinging = re.sub(r" \+ 0\.3 \* \(.*yaw_rate\)", "", BLOCKS[0]).replace("2.0 + 0.15 *", "3.0 + 0.4 *")
    assert len(swinging) < len(BLOCKS[0]) - 30
    (here / "swing.py").write_text(swinging)
    aid = {"lateral.emran.authority": 1.0, "duration": 24.0}
    result = run(load("highway_dlc", controller="swing.py:PurePursuit", **aid), here / "runs", record=False)
    assert result.ended == "finished"  # with the rates of the built-in laws it diverges at 20 s


def test_the_other_pieces_of_the_page_run_as_they_stand(here, capsys):
    names: dict = {"__name__": "page"}
    for block in BLOCKS:
        exec(compile(block, str(PAGE), "exec"), names)
    assert 0.0 < names["worst"] < 2.0
    assert names["result"].recording.is_file()
    assert str(names["result"].recording) in capsys.readouterr().out
    half = run(load("track_dlc", controller=names["MySteering"], duration=3.0), here / "half", record=False)
    assert half.ended == "finished"


def test_the_package_is_imported_in_a_moment_and_its_names_when_they_are_asked_for():
    heavy = "{'numba', 'libsumo', 'rerun', 'numpy', 'pydantic'}"
    ask = f"import sys, emran_sumo; found = {heavy} & set(sys.modules); assert not found, found; emran_sumo.Command"
    assert subprocess.run([sys.executable, "-c", ask], capture_output=True, timeout=120).returncode == 0


def test_the_names_of_the_package_are_what_they_say():
    assert emran_sumo.run is drive.run
    with pytest.raises(AttributeError, match="no attribute 'walk'"):
        emran_sumo.walk  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]
    assert isinstance(load("track_dlc"), scenario.Located)
