"""What a run leaves of SUMO's own outputs tells of no phantom, and is otherwise as SUMO wrote it."""

import contextlib
import gzip
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from test_any_scenario import ego, run, vehicle, written

from emran_sumo import drive
from emran_sumo.world.phantom import PREFIX
from emran_sumo.world.written import elements, real_only

OUTPUTS = {
    "tripinfo-output": "trips.xml",
    "vehroute-output": "routes.xml.gz",
    "fcd-output": "fcd.xml",
    "emission-output": "emissions.xml",
    "collision-output": "collisions.xml",
    "lanechange-output": "changes.xml",
    "netstate-dump": "net.xml",
    "fcd-output.max-leader-distance": "100",
    "tripinfo-output.write-unfinished": "true",
    "vehroute-output.write-unfinished": "true",
}
SUBJECTS = {"id", "vehicle", "ego", "foe", "collider", "victim"}


def read(file: Path) -> ET.Element:
    data = file.read_bytes()
    return ET.fromstring(gzip.decompress(data) if file.suffix == ".gz" else data)


def told(root: ET.Element) -> list[tuple[str, dict[str, str]]]:
    """All elements but those about phantoms, in order; phantoms elsewhere under the name of their ego."""
    if any(PREFIX in root.get(key, "") for key in SUBJECTS):
        return []
    own = {key: value.replace(PREFIX, "") for key, value in root.attrib.items()}
    return [(root.tag, own), *(one for child in root for one in told(child))]


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> tuple[Path, Path]:
    """The same run twice: as SUMO has written it, and as it is left."""
    options = "".join(f'<{name} value="{value}"/>' for name, value in OUTPUTS.items())
    follower = vehicle("after", "b2.c2 c2.c3", 2, "10", 0, 0.0)
    folder = tmp_path_factory.mktemp("phantoms")
    file = written(folder / "user", [ego("b2.c2 c2.c3"), follower], options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "real_only", lambda _: contextlib.nullcontext())
        raw = shutil.copytree(run(file, 25.0, "ego").folder, folder / "raw")
    return raw, run(file, 25.0, "ego").folder


@pytest.mark.parametrize("name", [value for value in OUTPUTS.values() if ".xml" in value])
def test_a_file_of_sumos_has_all_but_its_phantoms(folders, name):
    raw, left = (read(folder / name) for folder in folders)
    if name in ("trips.xml", "routes.xml.gz", "fcd.xml", "emissions.xml", "net.xml"):
        assert PREFIX in ET.tostring(raw, "unicode")
    assert PREFIX not in ET.tostring(left, "unicode")
    assert told(left) == told(raw)
    assert (folders[1] / name).read_bytes()[:1] == (folders[0] / name).read_bytes()[:1]  # packed or not


def test_nothing_else_is_left_in_the_folder(folders):
    assert {file.name for file in folders[0].iterdir()} == {file.name for file in folders[1].iterdir()}


def test_elements_go_with_what_is_inside_them_and_leaders_have_the_egos_name():
    name = PREFIX.encode()
    lines = [
        b'<a begin="0">\n',
        b'    <vehicle id="' + name + b'x" depart="1">\n',
        b'        <vehicle id="inside"/>\n',
        b"        <route/>\n",
        b"    </vehicle>\n",
        b'    <vType id="car@' + name + b'x"/>\n',
        b'    <conflict ego="y" foe="' + name + b'x#3"><start/></conflict>\n',
        b'    <vehicle id="y" leaderID="' + name + b'x#3" gap="1"/>\n',
        b'    <vehicle id="z"/>\n',
        b"</a>\n",
    ]
    left = [lines[0], b'    <vehicle id="y" leaderID="x" gap="1"/>\n', lines[8], lines[9]]
    assert list(elements(lines)) == left


def test_tables_lose_the_rows_of_phantoms_and_saved_states_and_files_without_phantoms_stay(tmp_path):
    state = f'<?xml version="1.0"?>\n<snapshot>\n    <vehicle id="{PREFIX}x"/>\n</snapshot>\n'
    with real_only(tmp_path):
        (tmp_path / "fcd.csv").write_text(f"time;id\n1;x\n1;{PREFIX}x\n2;x\n", encoding="utf-8")
        (tmp_path / "state.xml").write_text(state, encoding="utf-8")
        (tmp_path / "other.bin").write_bytes(b"\0" + PREFIX.encode())
        (tmp_path / "cut.xml.gz").write_bytes(gzip.compress(f'<a id="{PREFIX}x"'.encode() * 99)[:-20])
        before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    after = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert after.pop("fcd.csv") == b"time;id\n1;x\n2;x\n"
    before.pop("fcd.csv")
    assert after == before
