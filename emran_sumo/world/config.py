"""A user's .sumocfg as options of our own: files found, GUI settings left out."""

import math
import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

from emran_sumo.errors import UserError

# options whose values are files to read, alone or as lists
INPUTS = {
    "net-file", "route-files", "additional-files", "weight-files", "lane-weight-files", "load-state", "phemlight-path",
    "fcd-output.filter-edges.input-file", "device.ssm.filter-edges.input-file", "astar.all-distances",
    "astar.landmark-distances", "pedestrian.jupedsim.wkt", "device.fcd-replay.files",
}  # fmt: skip
# what only sumo-gui knows
GUI_ONLY = {
    "gui-settings-file", "start", "quit-on-end", "delay", "breakpoints", "osg-view", "window-size", "window-pos",
    "tracker-interval", "registry-viewport", "gui-testing", "gui-testing-debug", "gui-testing.setting-output",
    "edgedata-files", "alternative-net-file", "demo", "disable-textures", "game", "game.mode", "selection-file",
    "S", "Q", "G", "d", "g", "N", "data-files", "m",
}  # fmt: skip
# what a run decides itself and the traffic does not feel: the connection, messages, files of its own
OURS = {
    "remote-port", "num-clients", "save-configuration", "save-config", "save-template", "save-schema",
    "configuration-file", "configuration", "collision.mingap-factor", "no-step-log", "no-warnings",
    "duration-log.disable", "xml-validation", "xml-validation.net", "xml-validation.routes", "verbose", "log",
    "log-file", "message-log", "error-log", "output-prefix", "duration-log.statistics", "print-options",
    "human-readable-time", "help", "version", "save-template.commented", "no-duration-log", "step-log.period",
    "output-suffix",
}  # fmt: skip
# what a run decides itself and the traffic may feel: told to the user, with what holds in its place
CHANGED = {
    "step-method.ballistic": "always on",
    "seed": "--seed",
    "random": "--seed",
    "collision.action": "warn",
    "collision.check-junctions": "always on",
    "lateral-resolution": "no sublanes: the ego's own lateral motion is the plant's",
    "lanechange.duration": "0 for the others",
    "threads": "1",
}
# values that are what a run does anyway
SAME = {("step-method.ballistic", "true"), ("collision.check-junctions", "true"), ("threads", "1")}
SHORT = {
    "n": "net-file", "net": "net-file", "r": "route-files", "routes": "route-files", "a": "additional-files",
    "additional": "additional-files", "b": "begin", "e": "end", "w": "weight-files", "weights": "weight-files",
    "summary": "summary-output", "tripinfo": "tripinfo-output", "vehroutes": "vehroute-output",
    "personroutes": "personroute-output", "personinfo": "personinfo-output", "ndump": "netstate-dump",
    "netstate": "netstate-dump", "netstate-output": "netstate-dump", "ballistic": "step-method.ballistic",
    "device.fcd-replay.file": "device.fcd-replay.files",
}  # fmt: skip


class SumoConfig(NamedTuple):
    """options: name -> value for SUMO; begin, end [s], end inf where the file has none; step: the file's own step [s]
    or None; notes: what was left out or is done differently."""

    options: dict[str, str]
    begin: float
    end: float
    step: float | None
    notes: tuple[str, ...]


def read_config(file: Path) -> SumoConfig:
    """Read a SUMO configuration, with either root element.

    Paths are made absolute; lists may be separated by commas or spaces; back-slashes are read as slashes; `${NAME}`
    is what the environment has.

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
    given = {SHORT.get(leaf.tag, leaf.tag): _value(leaf) for leaf in root.iter()}
    values = {name: value for name, value in given.items() if value is not None}
    for name, value in values.items():
        if name not in GUI_ONLY | OURS | set(CHANGED) | {"end", "step-length"}:
            options[name] = _files(value, file.parent) if name in INPUTS else value
    if "net-file" not in options:
        raise UserError(f"{file}: net-file is missing; it names the network.")
    end = seconds(values.get("end", "-1"), file)
    return SumoConfig(
        options,
        seconds(options.get("begin", "0"), file),
        end if end > 0.0 else math.inf,
        seconds(values["step-length"], file) if "step-length" in values else None,
        tuple(_notes(values)),
    )


def _notes(values: dict[str, str]) -> list[str]:
    """What of a configuration is left out or done differently, in words."""
    notes = []
    gui = [name for name in values if name in GUI_ONLY]
    if gui:
        notes.append(f"left out, as only sumo-gui knows it: {', '.join(gui)}")
    for name, ours in CHANGED.items():
        if name in values and values[name] not in ("false", "0", "-1", ours) and (name, values[name]) not in SAME:
            notes.append(f"{name} {values[name]} of the configuration is not used ({ours})")
    return notes


def _value(leaf: ET.Element) -> str | None:
    """The value of an option, with `${NAME}` as the environment has it; others stay, as they are SUMO's own."""
    value = leaf.get("value", leaf.get("v"))
    return value and re.sub(r"\$\{(\w+)\}", lambda found: os.environ.get(found[1], found[0]), value)


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
