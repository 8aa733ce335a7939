"""What SUMO writes for a user's configuration, kept in the run's folder: the user's own stays as it is."""

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path

from emran_sumo.world.config import SumoConfig
from emran_sumo.world.files import content

# options whose values are files to write, besides those that end in "output"
OUTPUTS = {"netstate-dump", "person-fcd", "save-state.prefix", "save-state.files", "device.ssm.file", "device.toc.file"}
# elements of additional files that write to what their `file` or `dest` names; every other `file` is read
WRITERS = {
    "inductionLoop", "e1Detector", "laneAreaDetector", "e2Detector", "entryExitDetector", "e3Detector", "edgeData",
    "instantInductionLoop", "laneData", "vTypeProbe", "routeProbe", "timedEvent", "edgedata", "lanedata",
}  # fmt: skip
# params that name a file to read
READ = ("fcd-replay.file", "input-file")
PARAM_WRITES = re.compile(r"(.*[.-])?(file|output)")
HAS_SUCH_PARAM = re.compile(rb"""key\s*=\s*["']([^"']*[.-])?(file|output)["']""")
NOWHERE = {"", "NUL", "nul", "/dev/null"}
SWITCHES = {"true", "false", "1", "0"}  # of outputs that go to files named elsewhere


class Names:
    """Names in one folder for files of several: the same for one file, and never one for two."""

    def __init__(self) -> None:
        self._sources: dict[str, str] = {}

    def of(self, source: Path | str, name: str) -> str:
        """The name for a file, `name` itself where no other has it yet."""
        source, stem, dot, ends = os.path.normpath(source), *name.partition(".")
        count = 1
        while self._sources.setdefault(name, source) != source:
            count += 1
            name = f"{stem}-{count}{dot}{ends}"
        return name


def redirected(config: SumoConfig, folder: Path) -> dict[str, str]:
    """The options with every output in `folder`, so that the user's own folder stays as it is.

    Files that say themselves what is written where are copied there first.
    """
    options, names = dict(config.options), Names()
    for name, value in options.items():
        if (name.endswith("output") or name in OUTPUTS) and value not in NOWHERE:
            options[name] = ",".join(
                str(folder.resolve() / names.of(part.strip(), _base(part))) for part in value.split(",")
            )
    if "save-state.times" in options or "save-state.period" in options:
        options.setdefault("save-state.prefix", str(folder.resolve() / "state"))
    for name in ("additional-files", "route-files", "net-file"):
        files = [Path(file) for file in options[name].split(",")] if name in options else []
        if files:
            options[name] = ",".join(str(_copied(file, folder, name == "additional-files", names)) for file in files)
    return options


def _base(name: str) -> str:
    """A file's name without its folder, whichever slash separates them."""
    return name.strip().replace("\\", "/").rpartition("/")[2]


def _copied(file: Path, folder: Path, additional: bool, names: Names) -> Path:
    """A copy that writes into `folder`; the file itself where it writes nothing.

    SUMO puts what an additional file's elements write beside it, and what params name into the present folder.
    """
    try:
        data = content(file)
        if not additional and not HAS_SUCH_PARAM.search(data):  # routes and networks can be large
            return file
        root = ET.fromstring(data)
    except (ET.ParseError, OSError, EOFError):
        return file  # something SUMO will complain about itself
    if not any(
        _param_writes(element) or any(_writes(element, key) for key in element.attrib) for element in root.iter()
    ):
        return file
    for element in root.iter():
        if _param_writes(element):
            value = element.get("value", "")
            element.set("value", str(folder.resolve() / names.of(value, _base(value))))
        for key in ("file", "dest", "href", "imgFile", "output"):
            value = element.get(key)
            if not value or value == "NUL":
                continue
            meant = file.parent / value.replace("\\", "/")
            element.set(key, names.of(meant, _base(value)) if _writes(element, key) else str(meant.resolve()))
    copy = folder.resolve() / names.of(file, f"{folder.name}.{file.name.removesuffix('.gz')}")
    ET.ElementTree(root).write(copy, encoding="utf-8", xml_declaration=True)
    return copy


def _writes(element: ET.Element, key: str) -> bool:
    """Whether the attribute names a file that SUMO writes."""
    return key == "output" or (key in ("file", "dest") and element.tag in WRITERS)


def _param_writes(element: ET.Element) -> bool:
    """Whether the element is a `<param>` that names a file that SUMO writes."""
    key, value = element.get("key", ""), element.get("value", "")
    names = element.tag == "param" and PARAM_WRITES.fullmatch(key) and not key.endswith(READ)
    return bool(names) and value not in NOWHERE | SWITCHES
