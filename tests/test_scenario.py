"""A scenario is read, merged and checked; every mistake is one sentence on stderr and exit code 2."""

import math
import re
import sys
from pathlib import Path

import pytest

from emran_sumo import cli, locate, scenario
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.errors import UserError

SHIPPED = locate.folder("scenarios") / "highway_dlc"
NETWORK = (locate.folder("networks") / "highway" / "highway.net.xml").read_text(encoding="utf-8")
ROUTES = (SHIPPED / "highway_dlc.rou.xml").read_text(encoding="utf-8")
TOML = """\
title = "A short one"
network = "highway"
routes = ["cars.rou.xml"]
duration = 0.5
warm_up = 0.5

[road]
speed_limit = 22.22

[traffic]
density = 5.0
"""


def write(folder: Path, toml: str | bytes = TOML, routes: str | None = ROUTES, network: str | None = None) -> Path:
    """A scenario of one's own: its TOML file."""
    folder.mkdir(exist_ok=True)
    file = folder / "scenario.toml"
    file.write_bytes(toml if isinstance(toml, bytes) else toml.encode())
    if routes is not None:
        (folder / "cars.rou.xml").write_text(routes, encoding="utf-8")
    if network is not None:
        (folder / "own.net.xml").write_text(network, encoding="utf-8")
    return file


def changed(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.fixture
def refused(monkeypatch, capfd, tmp_path):
    """Run the command line and return its one sentence; SUMO writes to the descriptor, so that is what is read."""

    def run(*words: str) -> str:
        command = ["emran-sumo", *words]
        if words[:1] == ("run",):
            command += ["--out", str(tmp_path / "runs")] if "--out" not in words else []
        monkeypatch.setattr(sys, "argv", command)
        with pytest.raises(SystemExit) as end:
            cli.main()
        told = capfd.readouterr().err
        assert end.value.code == 2, told
        # what the compilation of kernels says is for a person who waits, not part of the answer
        lines = [line for line in told.splitlines() if not line.startswith("compiling the kernels")]
        assert len(lines) == 1, told
        assert lines[0].startswith("emran-sumo: ")
        assert lines[0].endswith((".", "?")), "a sentence ends"
        return lines[0].removeprefix("emran-sumo: ")

    return run


MISSPELLED = (
    ("road.fricton=1", r'--set: unknown key "road\.fricton"\. Did you mean "road\.friction"\?'),
    ("friction=1", r'--set: unknown key "friction"\. Did you mean "road\.friction"\?'),
    ("road.xyzzy=1", r'--set: unknown key "road\.xyzzy"\. Known: friction, speed_limit, curve_accel, curve_decel\.'),
    ("xyzzy=1", r'--set: unknown key "xyzzy"\. Known: title, .*\brates, road, traffic, .*disturbance\.'),
    ("road.friction.dry=1", r'--set: unknown key "road\.friction\.dry"\. Did you mean "road\.friction"\?'),
    ("road={friction=0.5, ice=2}", r'--set: unknown key "road\.ice"\. Did you mean "road\.friction"\?'),
    ("controller=pid-stanly", r'--set: controller: found "pid-stanly"\. Did you mean "pid-stanley"\?'),
    ("controller=7", r"--set: controller: found 7\. Known: adrc, .*stanley-hoffmann\."),
    ('controller=["pid-stanley"]', r'--set: controller: found \["pid-stanley"\]\. Did you mean "pid-stanley"\?'),
)
WRONG_VALUE = (
    ("road.friction=wet", r'--set: road\.friction: found "wet"; accepted is a number from 0\.05 to 2\.'),
    ("road.friction=", r'--set: road\.friction: found ""; accepted is a number from 0\.05 to 2\.'),
    ("road.friction=true", r"--set: road\.friction: found true; accepted is a number from 0\.05 to 2\."),
    ("road.friction=[1,2]", r"--set: road\.friction: found \[1, 2\]; accepted is a number from 0\.05 to 2\."),
    ("road.friction=9", r"--set: road\.friction: found 9; accepted is a number from 0\.05 to 2\."),
    ("road.friction=nan", r"--set: road\.friction: found nan; accepted is a number from 0\.05 to 2\."),
    ("road.friction=inf", r"--set: road\.friction: found inf; accepted is a number from 0\.05 to 2\."),
    ("duration=-inf", r"--set: duration: found -inf; accepted is a number above 0 to 86400 s\."),
    ("vehicle.mass=-1", r"--set: vehicle\.mass: found -1; accepted is a number .* kg\."),
    ("seed=1.5", r"--set: seed: found 1\.5; accepted is a whole number from 0 to 2147483647\."),
    ("seed=true", r"--set: seed: found true; accepted is a whole number from 0 to 2147483647\."),
    ("title=3", r"--set: title: found 3; accepted is text\."),
    ("ego=3", r"--set: ego: found 3; accepted is text\."),
    ('traffic.type=""', r'--set: traffic\.type: found ""; accepted is text that is not empty\.'),
    ("routes=a.rou.xml", r'--set: routes: found "a\.rou\.xml"; accepted is a list of texts\.'),
    ("routes=[1]", r"--set: routes: found 1; accepted is a list of texts\."),
    ("lateral.feedforward=1", r"--set: lateral\.feedforward: found 1; accepted is true or false\."),
    ("road=3", r"--set: road: found 3; accepted is a table of keys: friction, speed_limit, curve_accel, curve_decel\."),
    ("lateral=3", r"--set: lateral: found 3; accepted is a table of keys: .*\bemran\b.*\."),
    (
        "rates.sumo_step=0.033",
        r"--set: rates\.driver_step: found 0\.2 s; .* multiple of rates\.sumo_step \(0\.033 s\)\.",
    ),
    (
        "rates.control_step=0.02",
        r"--set: rates\.sumo_step: found 0\.05 s; .* multiple of rates\.control_step \(0\.02 s\)\.",
    ),
    (
        "rates.plant_step=0.0015",
        r"--set: rates\.control_step: found 0\.01 s; .* multiple of rates\.plant_step \(0\.0015 s\)\.",
    ),
    ("road.friction", r'--set: found "road\.friction"; accepted is KEY=VALUE, e\.g\. .*\.'),
    ("=3", r'--set: found "=3"; accepted is KEY=VALUE, e\.g\. .*\.'),
)


@pytest.mark.parametrize(("text", "sentence"), MISSPELLED + WRONG_VALUE, ids=lambda text: text[:24])
def test_a_wrong_set_is_refused_with_what_was_found_and_what_is_accepted(refused, text, sentence):
    assert re.fullmatch(sentence, refused("run", "highway_dlc", "--set", text))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("highway_dcl",), r'Unknown scenario "highway_dcl"\. Did you mean "highway_dlc"\?'),
        (("xyzzy",), r'Unknown scenario "xyzzy"\. Known: .*highway_dlc.*\.'),
        (("",), r'Unknown scenario ""\. Known: .*'),
        (("nowhere/own.toml",), r"nowhere/own\.toml: no such scenario file\."),
        (("/",), r"/scenario\.toml: no such scenario file\."),
        (("highway_dlc", "--controller", "x"), r'--controller: controller: found "x"\. Known: .*\.'),
        (("highway_dlc", "--seed", "-3"), r"--seed: seed: found -3; accepted is a whole number from 0 to .*"),
        (("highway_dlc", "--seed", "99999999999"), r"--seed: seed: found 99999999999; .* 0 to 2147483647\."),
        (("highway_dlc", "--density", "-1"), r"--density: .* found -1\.0; .* from 0 to 80 vehicles/km/lane\."),
        (("highway_dlc", "--density", "81"), r"--density: .* found 81\.0; .* from 0 to 80 vehicles/km/lane\."),
        (("highway_dlc", "--density", "nan"), r"--density: .* found nan; .* from 0 to 80 vehicles/km/lane\."),
        (("highway_dlc", "--duration", "0"), r"--duration: .* found 0\.0; accepted is a number above 0 to 86400 s\."),
        (("highway_dlc", "--duration", "inf"), r"--duration: .* found inf; accepted is a number above 0 to 86400 s\."),
        (("highway_dlc", "--duration", "x"), r"Invalid value for '--duration': .*\. Try `emran-sumo --help`\."),
        (("highway_dlc", "--controler", "x"), r"No such option: --controler.* Try `emran-sumo --help`\."),
        ((), r"Missing argument 'scenario'\. Try `emran-sumo --help`\."),
    ],
    ids=str,
)
def test_wrong_words_on_the_command_line_are_refused(refused, words, sentence):
    assert re.fullmatch(sentence, refused("run", *words))


@pytest.mark.parametrize(
    ("toml", "sentence"),
    [
        ("a = = 3\n", r"not valid TOML: .* \(at line 1, column 5\)\."),
        (b'title = "\xff"\n', r"cannot be read: .*"),
        (changed(TOML, 'network = "highway"\n', ""), r'key "network" is missing; .*\.'),
        (changed(TOML, 'routes = ["cars.rou.xml"]\n', ""), r'key "routes" is missing; .*\.'),
        (changed(TOML, '["cars.rou.xml"]', "[]"), r'key "routes" is missing; .*\.'),
        (changed(TOML, "routes =", "rotes ="), r'unknown key "rotes"\. Did you mean "routes"\?'),
        (
            changed(TOML, "[road]\nspeed_limit = 22.22\n", "road = 3\n"),
            r"road: found 3; accepted is a table of keys: .*",
        ),
        (TOML + "denisty = 3\n", r'unknown key "traffic\.denisty"\. Did you mean "traffic\.density"\?'),
        (changed(TOML, "22.22", "80"), r"road\.speed_limit: found 80; accepted is a number from 0 to 70 m/s\."),
        (changed(TOML, "22.22", "nan"), r"road\.speed_limit: found nan; accepted is a number from 0 to 70 m/s\."),
        (changed(TOML, "22.22", '"fast"'), r'road\.speed_limit: found "fast"; accepted is a number from 0 to 70 m/s\.'),
        (
            TOML + "[rates]\nsumo_step = 0.055\n",
            r"rates\.driver_step: found 0\.2 s; .* rates\.sumo_step \(0\.055 s\)\.",
        ),
        ('controller = "none"\n' + TOML, r'controller: found "none"\. Known: .*\.'),
    ],
)
def test_a_wrong_scenario_file_is_refused_by_its_name(refused, tmp_path, toml, sentence):
    file = write(tmp_path / "own", toml)
    assert re.fullmatch(re.escape(f"{file}: ") + sentence, refused("run", str(file)))
    assert re.fullmatch(re.escape(f"{file}: ") + sentence, refused("run", str(file.parent)))


EGO = '<vehicle id="ego" type="ego_sedan" route="through" depart="0" departLane="1" departPos="700" departSpeed="20">'


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        # SUMO's own reasons, which appear on file descriptor 2 only
        (
            "merge main_mid",
            "merge main_mod",
            r"SUMO cannot start with .*The edge 'main_mod' within the route 'through' .*",
        ),
        ("diverge off_ramp", "diverge of_ramp", r"SUMO cannot .*The edge 'of_ramp' within the route 'exit' .*"),
        (
            'type="ego_sedan"',
            'type="sedan"',
            r"SUMO cannot .*The vehicle type 'sedan' for vehicle 'ego' is not known\.",
        ),
        ('departSpeed="20"', 'departSpeed="fast"', r"SUMO cannot .*Invalid departSpeed definition 'fast' .*"),
        ('departLane="1"', 'departLane="9"', r"SUMO stopped: Invalid departLane definition for vehicle 'ego'\."),
        ('departSpeed="20"', 'departSpeed="99"', r"SUMO stopped: Departure speed for vehicle 'ego' is too high .*"),
        ('departPos="700"', 'departPos="99999"', r'ego: vehicle "ego" of .* was not on the road .* SUMO said: .*ego.*'),
        ("main_in merge main_mid diverge main_out", "main_in diverge main_out", r"SUMO stopped: .*no valid route.*"),
        # ours
        ('id="ego"', 'id="eggo"', r'ego: found "ego", which is no vehicle of .*cars\.rou\.xml\. Did you mean "eggo"\?'),
        (ROUTES[ROUTES.index("<vehicle ") :], "</routes>", r'ego: found "ego", .* They declare no single vehicle\.'),
        ('depart="0"', 'depart="9999"', r'ego: vehicle "ego" of .* was not on the road .*'),
        (
            'departLane="1"',
            'departLane="left"',
            r".*cars\.rou\.xml: vehicle 'ego' needs numbers as departLane and departPos\.",
        ),
        (
            'route="through"',
            'route="trough"',
            r'traffic: found the route "trough", which no route file declares\. Did you mean "through"\?',
        ),
        ("</routes>", "", r".*cars\.rou\.xml: not valid XML: no element found: line \d+, column 0\."),
        (ROUTES, "", r".*cars\.rou\.xml: not valid XML: no element found: line 1, column 0\."),
        # the double lane change
        ('value="1250"', 'value="far"', r'vehicle "ego": param double_lane_change\.start: found "far"; .* above 0 m\.'),
        ('value="1250"', 'value="inf"', r'vehicle "ego": param double_lane_change\.start: found "inf"; .* above 0 m\.'),
        ('value="25"', 'value="0"', r'vehicle "ego": param double_lane_change\.length_out: found "0"; .* above 0 m\.'),
        ('value="21.95"', 'value="-1"', r'vehicle "ego": param double_lane_change\.length_back: found "-1"; .*'),
        ('value="left"', 'value="up"', r'vehicle "ego": .*direction: found "up"; accepted is left or right\.'),
        (
            EGO,
            EGO.replace('"1"', '"2"'),
            r'vehicle "ego": .*direction: found "left", but there is no lane on that side.*',
        ),
        (
            "double_lane_change.length_out",
            "double_lane_change.lenght_out",
            r'vehicle "ego": unknown param ".*\.lenght_out"\. Did you mean "double_lane_change\.length_out"\?',
        ),
    ],
    ids=lambda text: text[-24:] if len(text) < 200 else "cut",
)
def test_a_wrong_route_file_is_refused_with_the_reason(refused, tmp_path, old, new, sentence):
    file = write(tmp_path / "own", routes=changed(ROUTES, old, new))
    assert re.fullmatch(sentence, refused("run", str(file)))


def test_no_lane_on_the_right_is_told_as_well(refused, tmp_path):
    routes = changed(changed(ROUTES, 'value="left"', 'value="right"'), 'departLane="1"', 'departLane="0"')
    told = refused("run", str(write(tmp_path / "own", routes=routes)))
    assert 'found "right", but there is no lane on that side' in told


@pytest.mark.parametrize(
    ("network", "sentence"),
    [
        ("", r".*own\.net\.xml: not a network file: no element found: line 1, column 0\."),
        ("hello", r".*own\.net\.xml: not a network file: syntax error: line 1, column 0\."),
        (NETWORK[:3000], r".*own\.net\.xml: not a network file: .*: line \d+, column \d+\."),
        (
            "<routes/>",
            r'.*cars\.rou\.xml: route "through": found the edge "main_in", which is not in .*own\.net\.xml\.',
        ),
        (NETWORK.replace('"main_mid"', '"middle"'), r"SUMO cannot start with .*own\.net\.xml: The edge 'main_mid' .*"),
        (
            re.sub(r'(<lane id="main_mid_1".*?shape=)"[^"]*"', r'\1"somewhere"', NETWORK),
            r"SUMO cannot start with .*own\.net\.xml: .*(shape|lane|edge).*",
        ),
    ],
    ids=("empty", "no XML", "cut", "no network", "lacks an edge", "bad shape"),
)
def test_a_wrong_network_file_is_refused_with_the_reason(refused, tmp_path, network, sentence):
    file = write(tmp_path / "own", changed(TOML, '"highway"', '"own.net.xml"'), network=network)
    assert re.fullmatch(sentence, refused("run", str(file)))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("network=highwai", r'network: found "highwai"; no such network file: .* Did you mean "highway"\?'),
        ("network=own.net.xml", r'network: found "own\.net\.xml"; no such network file: .*'),
        ("network=.", r'network: found "\."; no such network file: .*'),
        ('network=""', r'.*scenario\.toml: key "network" is missing; .*'),
        ('routes=["none.rou.xml"]', r".*none\.rou\.xml: no such route file\."),
        ('routes=["."]', r".*: no such route file\."),
        ("ego=egoo", r'ego: found "egoo", which is no vehicle of .*\. Did you mean "ego"\?'),
        (
            "traffic.type=lorries",
            r'traffic\.type: found "lorries", which no route file declares\. Known: .*traffic.*\.',
        ),
        (
            "traffic.through=thru",
            r'traffic: found the route "thru", which no route file declares\. Did you mean "through"\?',
        ),
        (
            "traffic.exit=thru",
            r'traffic: found the route "thru", which no route file declares\. Did you mean "through"\?',
        ),
        (
            "traffic.enter=thru",
            r'traffic: found the route "thru", which no route file declares\. Did you mean "through"\?',
        ),
        ("warm_up=400", r'ego: vehicle "ego" of .* was not on the road .* not arrived\.'),
    ],
)
def test_files_and_names_that_do_not_exist_are_refused(refused, tmp_path, text, sentence):
    file = write(tmp_path / "own")
    assert re.fullmatch(sentence, refused("run", str(file), "--set", text))


def test_an_output_folder_that_cannot_be_one_is_refused(refused, tmp_path):
    (tmp_path / "taken").write_text("a file")
    told = refused("run", "highway_dlc", "--out", str(tmp_path / "taken"))
    assert re.fullmatch(r"--out: cannot write to .*taken.*: Not a directory; accepted is a writable folder\.", told)


def test_a_mistake_costs_no_older_run(refused, tmp_path):
    older = tmp_path / "runs" / "own" / "coupled-emran-seed1"
    older.mkdir(parents=True)
    (older / "run.rrd").write_text("precious")
    refused("run", str(write(tmp_path / "own")), "--set", "ego=nobody")
    assert (older / "run.rrd").read_text() == "precious"


def test_the_command_line_wins_over_the_file_and_the_file_over_the_controller(tmp_path):
    file = write(tmp_path / "own", 'controller = "pid-stanley"\n' + TOML + "[lateral]\nsoftening = 0.25\n")
    values = scenario.load(str(file)).values
    assert values.lateral.gain == CONTROLLERS["pid-stanley"][1]["lateral.gain"] != scenario.Scenario().lateral.gain
    assert values.lateral.softening == 0.25
    values = scenario.load(str(file), {"lateral.gain": (1.5, "--set"), "traffic.density": (7.0, "--density")}).values
    assert (values.lateral.gain, values.lateral.softening, values.traffic.density) == (1.5, 0.25, 7.0)
    values = scenario.load(str(file), {"controller": ("coupled-base", "--controller")}).values
    assert values.lateral.gain == scenario.Scenario().lateral.gain
    assert values.lateral.softening == 0.25
    assert values.lateral.emran.authority == 0.0


@pytest.mark.parametrize("text", ["road={friction=0.5}", "road.friction=0.5"])
def test_a_section_and_its_key_can_both_be_set(text):
    key, _, value = text.partition("=")
    values = scenario.load("highway_dlc", {key: (scenario.parse_value(value), "--set")}).values
    assert values.road.friction == 0.5
    assert values.road.speed_limit == scenario.load("highway_dlc").values.road.speed_limit > 0.0


def test_a_list_can_be_set_and_a_whole_number_is_a_number():
    given = {"routes": (scenario.parse_value('["a.xml", "b.xml"]'), "--set"), "road.friction": (1, "--set")}
    values = scenario.load("highway_dlc", given).values
    assert values.routes == ("a.xml", "b.xml")
    assert values.road.friction == 1.0


def test_a_shipped_name_is_found_although_a_folder_of_old_runs_has_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("highway_dlc").mkdir()
    assert scenario.find("highway_dlc") == SHIPPED / "scenario.toml"
    own = write(tmp_path / "highway_dlc")
    assert scenario.find("highway_dlc").resolve() == own


def test_a_scenario_is_called_after_its_folder_or_its_file(tmp_path):
    file = write(tmp_path / "own")
    assert scenario.load(str(file)).name == scenario.load(str(file.parent)).name == "own"
    other = file.rename(file.parent / "wet.toml")
    assert scenario.load(str(other)).name == "wet"
    assert scenario.load(str(other)).folder == file.parent


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_key_of_every_controller_exists(name):
    values = scenario.load("highway_dlc", {"controller": (name, "test")}).values
    for key, value in CONTROLLERS[name][1].items():
        found = values
        for part in key.split("."):
            found = getattr(found, part)
        assert found == value, key


def test_every_number_has_a_range():
    told = {key: words for key, words in scenario.keys().items() if words.startswith(("a number", "a whole number"))}
    assert len(told) > 100
    assert not [key for key, words in told.items() if not re.search(r"\b(from|above) -?[\d.]+", words)]


def test_not_a_number_is_nowhere_accepted():
    for key, words in scenario.keys().items():
        if "number" not in words:
            continue
        for value in (math.nan, math.inf, -math.inf):
            with pytest.raises(UserError, match=re.escape(key)):
                scenario.load("highway_dlc", {key: (value, "--set")})
