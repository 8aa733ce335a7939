"""A user's .sumocfg as options of our own: files found, outputs kept in the run's folder, GUI settings left out."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from emran_sumo.errors import UserError

# options whose values are files to read, alone or as lists
INPUTS = {
    "net-file", "route-files", "additional-files", "weight-files", "lane-weight-files", "load-state", "phemlight-path",
    "persontrip.walk-opposite-factor", "thresholds",
}  # fmt: skip
# what only sumo-gui knows
GUI_ONLY = {
    "gui-settings-file", "start", "quit-on-end", "delay", "breakpoints", "osg-view", "window-size", "window-pos",
    "tracker-interval", "registry-viewport", "gui-testing", "gui-testing-debug", "gui-testing.setting-output",
    "edgedata-files", "alternative-net-file", "demo", "disable-textures", "game", "game.mode", "selection-file",
    "S", "Q", "G", "d",
}  # fmt: skip
# what a run decides itself: the steps, the connection, the seed, and what is done with collisions and teleports
OURS = {
    "step-length", "remote-port", "num-clients", "seed", "random", "save-configuration", "save-template", "save-schema",
    "configuration-file", "step-method.ballistic", "collision.action", "collision.mingap-factor",
    "collision.check-junctions", "time-to-teleport", "end", "no-step-log", "no-warnings", "duration-log.disable",
    "xml-validation", "verbose", "log", "message-log", "error-log", "output-prefix", "threads", "lateral-resolution",
    "lanechange.duration", "scale", "duration-log.statistics", "print-options", "human-readable-time",
}  # fmt: skip
SHORT = {"n": "net-file", "r": "route-files", "a": "additional-files", "b": "begin", "e": "end"}


# elements of additional files that write to what their `file` or `dest` names; every other `file` is read
WRITERS = {
    "inductionLoop", "e1Detector", "laneAreaDetector", "e2Detector", "entryExitDetector", "e3Detector", "edgeData",
    "instantInductionLoop", "laneData", "vTypeProbe", "routeProbe", "timedEvent", "edgedata", "lanedata",
}  # fmt: skip


class SumoConfig(NamedTuple):
    """options: name -> value for SUMO; begin [s]; step: the file's own step [s] or None; notes: what was left out."""

    options: dict[str, str]
    begin: float
    step: float | None
    notes: tuple[str, ...]


def read_config(file: Path) -> SumoConfig:
    """Read a SUMO configuration, with either root element.

    Paths are made absolute; lists may be separated by commas or spaces; back-slashes are read as slashes.

    Raises:
        UserError: the file is missing, no XML, no SUMO configuration, or names no network.
    """
    try:
        root = ET.parse(file).getroot()
    except ET.ParseError as error:
        raise UserError(f"{file}: not valid XML: {error}.") from None
    except OSError as error:
        raise UserError(f"{file}: cannot be read: {error.strerror}.") from None
    if root.tag not in ("configuration", "sumoConfiguration"):
        raise UserError(f"{file}: found <{root.tag}>; accepted is a SUMO configuration (<configuration>).")
    options: dict[str, str] = {}
    dropped: list[str] = []
    given = {SHORT.get(leaf.tag, leaf.tag): leaf for leaf in root.iter() if _value(leaf) is not None}
    for name, leaf in given.items():
        value = _value(leaf) or ""
        if name in GUI_ONLY:
            dropped.append(name)
        elif name not in OURS:
            options[name] = _files(value, file.parent) if name in INPUTS else value
    if "net-file" not in options:
        raise UserError(f"{file}: net-file is missing; it names the network.")
    notes = [f"left out, as only sumo-gui knows it: {', '.join(dropped)}"] if dropped else []
    step = given.get("step-length")
    return SumoConfig(
        options,
        seconds(options.get("begin", "0"), file),
        None if step is None else seconds(_value(step) or "1", file),
        tuple(notes),
    )


def _value(leaf: ET.Element) -> str | None:
    return leaf.get("value", leaf.get("v"))


def _files(value: str, folder: Path) -> str:
    """Absolute paths of a list of files.

    A space separates only where the parts are files: names with spaces stay whole.
    """
    names = [name.strip().replace("\\", "/") for name in value.split(",")]
    found: list[str] = []
    for name in names:
        whole = folder / name
        parts = [name] if whole.exists() else re.split(r"\s+", name)
        found += [str((folder / part).resolve()) for part in parts if part]
    return ",".join(found)


def seconds(text: str, file: Path) -> float:
    """Seconds of a SUMO time: a number, h:m:s or d:h:m:s."""
    try:
        parts = [float(part) for part in text.split(":")]
    except ValueError:
        raise UserError(f'{file}: found the time "{text}"; accepted are seconds or h:m:s.') from None
    scale = (1.0, 60.0, 3600.0, 86_400.0)
    return sum(part * unit for part, unit in zip(reversed(parts), scale, strict=False))


def redirected(config: SumoConfig, folder: Path) -> dict[str, str]:
    """The options with every output in `folder`, so that the user's own folder stays as it is.

    Additional files that write something are copied there first: SUMO puts what they write beside them.
    """
    options = dict(config.options)
    for name, value in options.items():
        if name.endswith("-output") or name in ("netstate-dump", "save-state.prefix"):
            options[name] = str(folder.resolve() / Path(value.replace("\\", "/")).name)
    if "additional-files" in options:
        files = [Path(name) for name in options["additional-files"].split(",")]
        options["additional-files"] = ",".join(str(_redirected_file(file, folder)) for file in files)
    return options


def _redirected_file(file: Path, folder: Path) -> Path:
    try:
        tree = ET.parse(file)
    except (ET.ParseError, OSError):
        return file  # compressed, or something SUMO will complain about itself
    writers = [element for element in tree.iter() if element.tag in WRITERS]
    if not any(element.get("file") or element.get("dest") for element in writers):
        return file
    for element in tree.iter():
        for key in ("file", "dest", "href", "imgFile", "output"):
            value = element.get(key)
            if not value or value == "NUL":
                continue
            out = key in ("dest", "output") or (key == "file" and element.tag in WRITERS)
            element.set(key, Path(value.replace("\\", "/")).name if out else str((file.parent / value).resolve()))
    copy = folder.resolve() / f"{folder.name}.{file.name}"
    tree.write(copy, encoding="utf-8", xml_declaration=True)
    return copy
