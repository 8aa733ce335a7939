"""The command line answers at once, shows what there is, and tells mistakes in one sentence."""

import json
import os
import re
import resource
import shutil
import subprocess
import sys

import pytest

from emran_sumo import cli
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.shipped import scenarios

HEAVY = ("numba", "rerun", "libsumo", "scipy", "numpy", "pyarrow")
PLAIN = {key: value for key, value in os.environ.items() if key not in ("FORCE_COLOR", "DISPLAY", "WAYLAND_DISPLAY")}
WIDE = PLAIN | {"COLUMNS": "200", "CI": "1"}


def emran_sumo(*words: str, display: str = "", **more) -> subprocess.CompletedProcess:
    command = [sys.executable, "-c", "from emran_sumo.cli import main; main()", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, env=WIDE | {"DISPLAY": display}, **more)


def test_help_answers_at_once():
    emran_sumo("--help")  # the files are in the cache of the system then
    took = []
    for _ in range(3):
        began = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert emran_sumo("--help").returncode == 0
        ended = resource.getrusage(resource.RUSAGE_CHILDREN)
        took.append(ended.ru_utime - began.ru_utime + ended.ru_stime - began.ru_stime)
    assert min(took) < 1.0  # s of the processor; 0.35 s on a machine that does nothing else


@pytest.mark.parametrize(
    "words",
    [("--help",), ("run", "--help"), ("list",), ("compare", "--help"), ("view", "--help"), ("export", "--help")],
)
def test_nothing_heavy_is_imported_for_it(words):
    told = emran_sumo_modules(*words)
    assert not [name for name in HEAVY if name in told]


def test_importing_the_command_line_imports_no_pydantic_either():
    code = "import sys, emran_sumo.cli; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert "emran_sumo.cli" in done.stdout
    assert not [name for name in (*HEAVY, "pydantic") if name in done.stdout.split()]


def emran_sumo_modules(*words: str) -> set[str]:
    code = (
        "import sys\nfrom emran_sumo.cli import main\n"
        f"sys.argv = ['emran-sumo', *{words!r}]\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code, end.code\n"
        "print('\\nmodules:', *sys.modules, file=sys.stderr)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, env=WIDE)
    assert done.returncode == 0, done.stderr
    return set(done.stderr.rpartition("modules:")[2].split())


def test_list_shows_every_scenario_and_controller_with_its_line():
    done = emran_sumo("list")
    assert done.returncode == 0
    for name, line in (*scenarios().items(), *((name, line) for name, (line, _) in CONTROLLERS.items())):
        assert line
        assert re.search(rf"^\s*{re.escape(name)}\s+{re.escape(line)}", done.stdout, re.MULTILINE), name


def test_run_help_names_every_option():
    told = emran_sumo("run", "--help").stdout
    options = ("controller", "seed", "density", "duration", "set", "out", "sumo-gui", "view", "no-record")
    assert not [option for option in options if f"--{option}" not in told]


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("compare", ("--controllers", "--seed", "--density", "--set", "--set-file", "--out", "--view", "compare.rrd")),
        ("view", ("RUN...", "newest")),
        ("export", ("--format", "csv, parquet, png or mp4", "--out")),
        ("run", ("--live",)),
    ],
)
def test_the_help_of_commands_for_recordings_names_what_they_take(command, said):
    told = " ".join(emran_sumo(command, "--help").stdout.split())
    assert not [words for words in said if words not in told]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("run", "highway_dcl"), r'emran-sumo: Unknown scenario "highway_dcl"\. Did you mean "highway_dlc"\?\n'),
        (("run", "highway_dlc", "--density", "-1"), r"emran-sumo: --density: .*vehicles/km/lane\.\n"),
        (("run", "highway_dlc", "--set", "network=moon"), r'emran-sumo: network: found "moon"; .*\n'),
        (("run", "highway_dlc", "--sumo-gui"), r"emran-sumo: --sumo-gui: there is no display; .*\n"),
        (("run", "highway_dlc", "--live", "--no-record"), r"emran-sumo: --live: found with --no-record; .*\.\n"),
        (("compare", "highway_dlc"), r"emran-sumo: Missing option '--controllers'\. Try `emran-sumo --help`\.\n"),
        (
            ("compare", "highway_dlc", "--controllers", "pid-stanly,coupled-emran"),
            r'emran-sumo: --controllers: found "pid-stanly"\. Did you mean "pid-stanley"\?\n',
        ),
        (
            ("compare", "highway_dcl", "--controllers", "pid-stanley,coupled-emran"),
            r'emran-sumo: Unknown scenario "highway_dcl"\. Did you mean "highway_dlc"\?\n',
        ),
        (
            ("compare", "highway_dlc", "--controllers", "pid-stanley,coupled-emran", "--out", "/dev/null"),
            r"emran-sumo: --out: cannot write to /dev/null/.*; accepted is a writable folder\.\n",
        ),
        (("view", "runs/gone"), r'emran-sumo: RUN: found "runs/gone"; no such run\. No runs lie near; .*\n'),
        (("view",), r"emran-sumo: Missing argument 'RUN\.\.\.'\. Try `emran-sumo --help`\.\n"),
        (("export", ".", "--format", "csv"), r'emran-sumo: RUN: found "\."; there is no trace\.parquet in it; .*\n'),
        (
            ("export", ".", "--format", "gif"),
            r'emran-sumo: --format: found "gif"; accepted is csv, parquet, png or mp4\.\n',
        ),
        (("drive",), r"emran-sumo: No such command 'drive'\. Try `emran-sumo --help`\.\n"),
    ],
    ids=str,
)
@pytest.mark.skipif(os.name != "posix", reason="a display is always there")
def test_a_mistake_is_one_sentence_and_exit_code_2(words, sentence, tmp_path):
    done = emran_sumo(*words, cwd=tmp_path)
    told = re.sub(r"^compiling the kernels.*\n", "", done.stderr)
    assert done.returncode == 2
    assert re.fullmatch(sentence, told), done.stderr
    assert done.stdout == ""


def test_no_words_show_the_help():
    done = emran_sumo()
    assert "Usage" in done.stdout
    assert done.stderr == ""


def test_flags_set_and_file_reach_the_run_in_this_order(monkeypatch, tmp_path, capsys):
    from emran_sumo import drive

    seen = []

    def remember(located, out, **more):
        seen.append((located.values, out, more))
        raise KeyboardInterrupt

    monkeypatch.setattr(drive, "run", remember)
    words = [
        "run",
        "highway_dlc",
        "--out",
        str(tmp_path),
        "--controller",
        "pid-stanley",
        "--seed",
        "7",
        "--density",
        "9",
    ]
    more = ["--duration", "12", "--set", "road.friction=0.5", "--set", "lateral.gain = 3.5", "--no-record"]
    monkeypatch.setattr(sys, "argv", ["emran-sumo", *words, *more])
    with pytest.raises(SystemExit) as end:
        cli.main()
    assert end.value.code == 130
    values, out, options = seen[0]
    assert (values.controller, values.seed, values.traffic.density, values.duration) == ("pid-stanley", 7, 9.0, 12.0)
    assert (values.road.friction, values.lateral.gain) == (0.5, 3.5)
    assert values.road.speed_limit == 22.22, "from the file"
    assert (out, options["record"], options["gui"]) == (tmp_path, False, False)
    assert options["command"].startswith("emran-sumo run highway_dlc --out")
    assert "'lateral.gain = 3.5'" in options["command"], "can be pasted into a shell"
    assert "interrupted" in capsys.readouterr().err


def test_a_run_tells_how_it_went_and_where_its_files_are(tmp_path):
    done = emran_sumo("run", "highway_dlc", "--duration", "2", "--set", "warm_up=2", "--density", "5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    folder = "runs/highway_dlc/coupled-emran-seed1"
    assert done.stdout.startswith(
        "highway_dlc, coupled-emran, seed 1, 5 vehicles/km/lane: finished, drove 2 s as planned."
    )
    for line in ("cross-track error", "time to collision", "gap", "collisions", "jerk", "network", "real-time factor"):
        assert line in done.stdout
    assert f"{folder}/  run.rrd  trace.parquet  summary.json\n" in done.stdout
    assert f"rerun {folder}/run.rrd\n" in done.stdout
    assert (tmp_path / folder / "run.rrd").stat().st_size > 10_000
    assert "Traceback" not in done.stderr


def test_a_warm_run_says_nothing_of_compiling(tmp_path):
    short = ("run", "highway_dlc", "--duration", "0.1", "--set", "warm_up=0.1", "--no-record", "--density", "1")
    emran_sumo(*short, cwd=tmp_path)
    done = emran_sumo(*short, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_run_that_diverges_is_a_result_and_no_mistake(tmp_path):
    words = ("run", "highway_dlc", "--controller", "pid-stanley", "--set", "road.friction=0.12", "--density", "0")
    done = emran_sumo(*words, "--duration", "30", "--no-record", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert ": diverged, the controller lost the car after" in done.stdout


def test_the_viewer_that_finds_no_display_says_so_and_the_run_stays(tmp_path):
    if sys.platform != "linux":
        pytest.skip("a window needs no display variable there")
    options = ("--duration", "0.2", "--density", "1", "--view", "--out", str(tmp_path))
    done = emran_sumo("run", "highway_dlc", *options)
    assert done.returncode == 2
    assert done.stderr.startswith("emran-sumo: --view: the Rerun viewer did not open: ")
    assert (tmp_path / "highway_dlc" / "coupled-emran-seed1" / "run.rrd").stat().st_size > 0


@pytest.mark.parametrize("words", [("run", "highway_dlc", "--live"), ("view", "a.rrd")])
def test_a_viewer_that_finds_no_display_says_so_in_one_sentence(words, tmp_path):
    if sys.platform != "linux":
        pytest.skip("a window needs no display variable there")
    (tmp_path / "a.rrd").touch()
    done = emran_sumo(*words, cwd=tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(
        r"emran-sumo: (view|--live): the Rerun viewer did not open: there is no display; .*\.\n", done.stderr
    )
    assert not (tmp_path / "runs").exists(), "nothing was driven"


@pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Debian's xvfb")
def test_sumos_own_window_follows_the_ego_in_real_time_and_closes(tmp_path):
    with subprocess.Popen(["Xvfb", "-displayfd", "1"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as server:
        try:
            assert server.stdout is not None
            display = f":{int(server.stdout.readline())}"
            options = ("--duration", "2", "--density", "1", "--sumo-gui", "--no-record", "--out", str(tmp_path))
            done = emran_sumo("run", "highway_dlc", *options, display=display)
        finally:
            server.terminate()
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "highway_dlc" / "coupled-emran-seed1" / "summary.json").read_text())
    assert summary["ended"] == "finished"
    assert 0.7 < summary["metrics"]["run"]["real_time_factor"] < 1.02
