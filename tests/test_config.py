"""A user's SUMO configuration is read as SUMO reads it, and nothing of it is changed without a word."""

import gzip
import math
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from emran_sumo import locate
from emran_sumo.errors import UserError
from emran_sumo.world.config import read_config, seconds
from emran_sumo.world.outputs import redirected
from emran_sumo.world.session import start
from emran_sumo.world.sumo import SumoWorld

LINE = Path(__file__).parent / "data" / "line.net.xml"
CARS = """\
<routes>
    <route id="all" edges="fast slow"/>
    <vehicle id="one" route="all" depart="7" departLane="1"/>
</routes>
"""


def configured(folder: Path, inside: str, root: str = "configuration") -> Path:
    """A folder with a network, a route file and a configuration that names them and has `inside`."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(LINE, folder / "line.net.xml")
    (folder / "cars.rou.xml").write_text(CARS, encoding="utf-8")
    file = folder / "my.sumocfg"
    files = '<net-file value="line.net.xml"/><route-files value="cars.rou.xml"/>'
    given = "" if "net-file" in inside else f"<input>{files}</input>"
    file.write_text(f"<{root}>{given}{inside}</{root}>", encoding="utf-8")
    return file


@pytest.mark.parametrize("root", ["configuration", "sumoConfiguration"])
def test_both_root_elements_are_accepted(tmp_path, root):
    config = read_config(configured(tmp_path, "", root))
    assert config.options["net-file"] == str(tmp_path / "line.net.xml")
    assert config.notes == ()


def test_short_names_and_the_old_attribute_mean_the_same(tmp_path):
    file = configured(tmp_path, '<n v="line.net.xml"/><net-file value="line.net.xml"/><b v="12"/><e v="1:00:00"/>')
    config = read_config(file)
    assert (config.begin, config.end) == (12.0, 3600.0)


@pytest.mark.parametrize("listed", ["a.rou.xml,b.rou.xml", "a.rou.xml b.rou.xml", " a.rou.xml , b.rou.xml "])
def test_lists_are_separated_by_commas_or_spaces(tmp_path, listed):
    inside = f'<net-file value="line.net.xml"/><route-files value="{listed}"/>'
    config = read_config(configured(tmp_path, inside))
    assert config.options["route-files"] == f"{tmp_path / 'a.rou.xml'},{tmp_path / 'b.rou.xml'}"


def test_a_name_with_a_space_stays_whole_and_back_slashes_separate_folders(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "my cars.rou.xml").write_text(CARS, encoding="utf-8")
    inside = r'<net-file value="line.net.xml"/><route-files value="sub\my cars.rou.xml"/>'
    config = read_config(configured(tmp_path, inside))
    assert config.options["route-files"] == str(tmp_path / "sub" / "my cars.rou.xml")


def test_a_variable_of_the_environment_stands_for_its_value(tmp_path, monkeypatch):
    monkeypatch.setenv("ROAD_FILES", str(tmp_path / "elsewhere"))
    monkeypatch.delenv("NO_SUCH_FOLDER", raising=False)
    inside = (
        '<net-file value="${ROAD_FILES}/line.net.xml"/><route-files value="${ROAD_FILES}/a.xml,${NO_SUCH_FOLDER}/b"/>'
    )
    options = read_config(configured(tmp_path, inside)).options
    assert options["net-file"] == str(tmp_path / "elsewhere" / "line.net.xml")
    assert options["route-files"] == f"{tmp_path / 'elsewhere' / 'a.xml'},{tmp_path / '${NO_SUCH_FOLDER}' / 'b'}"


def test_what_only_the_gui_knows_is_left_out_and_said(tmp_path):
    config = read_config(configured(tmp_path, '<osg-view value="true"/><gui-settings-file value="v.xml"/>'))
    assert not {"osg-view", "gui-settings-file"} & set(config.options)
    assert config.notes == ("left out, as only sumo-gui knows it: osg-view, gui-settings-file",)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ('<lateral-resolution value="0.8"/>', "lateral-resolution 0.8"),
        ('<seed value="42"/>', "seed 42"),
        ('<collision.action value="teleport"/>', "collision.action teleport"),
    ],
)
def test_what_the_traffic_may_feel_is_said(tmp_path, option, said):
    config = read_config(configured(tmp_path, option))
    assert len(config.notes) == 1
    assert config.notes[0].startswith(said)


@pytest.mark.parametrize("option", ["scale", "time-to-teleport", "max-depart-delay", "device.rerouting.probability"])
def test_what_shapes_the_traffic_is_kept(tmp_path, option):
    config = read_config(configured(tmp_path, f'<{option} value="0.5"/>'))
    assert config.options[option] == "0.5"
    assert config.notes == ()


def test_begin_end_and_step_are_read_and_an_absent_end_is_none(tmp_path):
    config = read_config(configured(tmp_path, '<begin value="0:01:40"/><step-length value="0.5"/>'))
    assert (config.begin, config.end, config.step) == (100.0, math.inf, 0.5)


@pytest.mark.parametrize(("text", "value"), [("90", 90.0), ("1:30", 90.0), ("1:00:01", 3601.0), ("1:0:0:1", 86401.0)])
def test_times_are_seconds_or_clock_times(text, value):
    assert seconds(text, Path("x")) == value


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<configuration><input/></configuration>", "net-file is missing"),
        ("<routes/>", "found <routes>"),
        ("<configuration>", "not valid XML"),
        ('<configuration><n v="x"/><end value="soon"/></configuration>', 'found the time "soon"'),
    ],
)
def test_a_file_that_is_none_is_one_sentence(tmp_path, text, said):
    file = tmp_path / "my.sumocfg"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=said):
        read_config(file)


WRITERS = """\
<additional>
    <inductionLoop id="loop" lane="fast_1" pos="100" period="10" file="deep/loop.out.xml"/>
    <edgeData id="edges" file="edges.out.xml"/>
    <variableSpeedSign id="sign" lanes="fast_1" file="sign.xml"/>
</additional>
"""


@pytest.mark.parametrize("packed", [False, True])
def test_everything_that_sumo_writes_lands_in_the_folder_of_the_run(tmp_path, packed):
    user, run = tmp_path / "user", tmp_path / "run"
    run.mkdir()
    name = "add.xml.gz" if packed else "add.xml"
    file = configured(
        user,
        f'<additional-files value="{name}"/><fcd-output value="out/fcd.xml"/><tripinfo-output value="trips.xml"/>'
        '<device.ssm.file value="ssm.xml"/><save-state.times value="3"/>',
    )
    (user / "sign.xml").write_text('<vss><step time="0" speed="20"/></vss>', encoding="utf-8")
    data = WRITERS.encode()
    (user / name).write_bytes(gzip.compress(data) if packed else data)
    before = sorted(path.name for path in user.rglob("*"))
    with SumoWorld(redirected(read_config(file), run), 0.1, 1) as world:
        list(world.warm_up(20.0))
    assert sorted(path.name for path in user.rglob("*")) == before
    written = {path.name for path in run.iterdir()}
    assert {"fcd.xml", "trips.xml", "loop.out.xml", "edges.out.xml"} <= written
    assert any(name.startswith("state_") for name in written)


SIGNAL = """\
<additional>
    <tlLogic id="{id}" type="actuated" programID="own">
        <phase duration="20" minDur="5" maxDur="40" state="{green}"/>
        <phase duration="20" minDur="5" maxDur="40" state="{red}"/>
        <param key="file" value="detectors.out.xml"/><param key="freq" value="5"/>
    </tlLogic>
</additional>
"""
WATCHED = """\
<routes>
    <vType id="watched">
        <param key="has.ssm.device" value="true"/><param key="device.ssm.file" value="ssm.out.xml"/>
    </vType>
    <vehicle id="one" type="watched" depart="0"><route edges="c3.d3 d3.east3"/></vehicle>
</routes>
"""


def test_what_params_name_is_written_into_the_folder_of_the_run_too(tmp_path, monkeypatch):
    user, run = tmp_path / "user", tmp_path / "run"
    run.mkdir()
    network = locate.folder("networks") / "urban" / "urban.net.xml"
    file = configured(
        user,
        f'<net-file value="{network}"/><route-files value="cars.rou.xml"/><additional-files value="add.xml"/>',
    )
    (user / "cars.rou.xml").write_text(WATCHED, encoding="utf-8")
    light = next(light for light in ET.parse(network).getroot().iter("tlLogic"))
    states = len(next(light.iter("phase")).get("state", ""))
    signal = SIGNAL.format(id=light.get("id"), green="G" * states, red="r" * states)
    (user / "add.xml").write_text(signal, encoding="utf-8")
    before = sorted(path.name for path in user.iterdir())
    monkeypatch.chdir(user)
    with SumoWorld(redirected(read_config(file), run), 0.1, 1) as world:
        list(world.warm_up(20.0))
    assert sorted(path.name for path in user.iterdir()) == before
    assert {"detectors.out.xml", "ssm.out.xml"} <= {path.name for path in run.iterdir()}


def test_a_param_that_names_a_file_to_read_is_left_as_it_is(tmp_path):
    file = configured(tmp_path / "user", "")
    (tmp_path / "user" / "cars.rou.xml").write_text(WATCHED.replace("ssm.file", "fcd-replay.file"), encoding="utf-8")
    assert redirected(read_config(file), tmp_path)["route-files"] == str(tmp_path / "user" / "cars.rou.xml")


def test_an_additional_file_that_writes_nothing_is_read_where_it_is(tmp_path):
    file = configured(tmp_path / "user", '<additional-files value="add.xml"/>')
    (tmp_path / "user" / "add.xml").write_text("<additional/>", encoding="utf-8")
    options = redirected(read_config(file), tmp_path)
    assert options["additional-files"] == str(tmp_path / "user" / "add.xml")


def test_an_option_that_sumo_does_not_know_is_left_out_and_said(tmp_path):
    file = configured(tmp_path, '<no-such-option value="1"/>')
    with SumoWorld(read_config(file).options, 0.1, 1) as world:
        assert world.notes == ("left out, as SUMO does not know it: no-such-option",)


def test_any_other_refusal_is_sumos_own_sentence(tmp_path):
    file = configured(tmp_path, '<scale value="many"/>')
    with pytest.raises(UserError, match=r"SUMO cannot start with .*scale"):
        start(read_config(file).options, 0.1, 1, False)


def test_a_packed_network_and_a_late_begin_are_read(tmp_path):
    file = configured(tmp_path, '<net-file value="line.net.xml.gz"/><r value="cars.rou.xml"/><begin value="5"/>')
    (tmp_path / "line.net.xml.gz").write_bytes(gzip.compress(LINE.read_bytes()))
    with SumoWorld(read_config(file).options, 0.1, 1) as world:
        assert world.time == pytest.approx(5.0)
        list(world.warm_up(3.0))
        assert world.present() == ("one",)


def test_files_of_one_name_from_two_folders_stay_two(tmp_path):
    """Copies of additional files, and what they and options have SUMO write."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        detector = f'<inductionLoop id="{name}" lane="fast_1" pos="9" period="9" file="out.xml"/>'
        (tmp_path / name / "more.add.xml").write_text(f"<additional>{detector * 2}</additional>", encoding="utf-8")
    files = '<additional-files value="a/more.add.xml,b/more.add.xml"/>'
    outputs = '<fcd-output value="a/o.xml.gz"/><tripinfo-output value="b/o.xml.gz"/><queue-output value="a/o.xml.gz"/>'
    folder = tmp_path / "run"
    folder.mkdir()
    file = configured(tmp_path, files + outputs + '<n v="line.net.xml"/><net-file value="line.net.xml"/>')
    options = redirected(read_config(file), folder)
    copies = [Path(name) for name in options["additional-files"].split(",")]
    found = [{(e.get("id"), e.get("file")) for e in ET.parse(copy).getroot()} for copy in copies]
    assert found[0] == {("a", "out.xml")}  # both of one file write into one
    assert found[1] == {("b", "out-2.xml")}
    written = [Path(options[f"{name}-output"]).name for name in ("fcd", "tripinfo", "queue")]
    assert written == ["o.xml.gz", "o-2.xml.gz", "o.xml.gz"]
