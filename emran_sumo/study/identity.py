"""What decides a run's numbers besides its scenario: versions, the simulation's own source, and the input files."""

import functools
import hashlib
import platform
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path

from emran_sumo import __version__, locate
from emran_sumo.errors import UserError
from emran_sumo.scenario import Located, flat, to_dict
from emran_sumo.user_code import sources

_PACKAGE = Path(__file__).resolve().parent.parent
# rooms that no number of a run passes through
_ELSEWHERE = {"study", "paper", "recording", "cli", "cli_study", "terminal", "report", "tune", "tuning", "search"}
DIGITS = 16  # of a digest
_PACKAGES = ("libsumo", "numba", "numpy")


@functools.cache
def installed() -> dict[str, str]:
    """Versions, and a digest of every module that a run's numbers depend on."""
    digest = hashlib.sha256()
    for file in sorted(_PACKAGE.rglob("*.py")):
        inside = file.relative_to(_PACKAGE)
        if inside.with_suffix("").parts[0] not in _ELSEWHERE:
            digest.update(inside.as_posix().encode() + b"\0" + file.read_bytes())
    found = {"emran_sumo": __version__, "source of emran_sumo": digest.hexdigest()[:DIGITS]}
    found |= {name: version(name) for name in _PACKAGES}
    return {**found, "python": ".".join(platform.python_version_tuple()[:2])}


def of(located: Iterable[Located]) -> dict[str, str]:
    """Everything that must not change between two runs of a study: `installed` and a digest per input file."""
    found = dict(installed())
    for one in located:
        for name, file in inputs(one).items():
            found[f"{one.name}: {name}"] = digest_of(file)
    return found


def inputs(located: Located) -> dict[str, Path]:
    """Files that a scenario names, those that a SUMO configuration among them names, and an own controller's source.

    Raises:
        UserError: a network or route file is missing.
    """
    found: dict[str, Path] = {}
    for key, value in flat(to_dict(located.values)).items():
        for text in value if isinstance(value, tuple) else (value,):
            if not isinstance(text, str) or not text or key == "title":
                continue
            file = _file(located.folder, key, text)
            if file is not None:
                found[text] = file
                found |= _configured(file) if key == "config" else {}
    return found | sources(located)


def _file(folder: Path, key: str, text: str) -> Path | None:
    file = folder / text
    if file.is_file():
        return file
    if key == "network" and not file.suffix:
        file = locate.folder("networks") / text / f"{text}.net.xml"
    if key in ("network", "routes") and not file.is_file():
        raise UserError(f'{key}: found "{text}"; no such {key.removesuffix("s")} file: {file}.')
    return file if file.is_file() else None


def _configured(file: Path) -> dict[str, Path]:
    try:
        values = [element.get("value", "") for element in ET.parse(file).iter()]
    except ET.ParseError:
        return {}
    names = [name for value in values for name in re.split(r"[,\s]+", value.replace("\\", "/")) if name]
    return {name: file.parent / name for name in names if (file.parent / name).is_file()}


def digest_of(file: Path) -> str:
    """Digest of a file's content."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:DIGITS]
    except OSError as error:
        raise UserError(f"{file}: cannot be read: {error.strerror}.") from None


def differences(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """What changed, in words."""
    said = []
    for name in {**before, **now}:
        old, new = before.get(name), now.get(name)
        if old == new:
            continue
        if old is None or new is None:
            said.append(f"{name} is {'new' if old is None else 'gone'}")
        else:
            digests = len(old) == DIGITS == len(new)
            said.append(f"{name} has changed" if digests else f"{name} was {old} and is now {new}")
    return said
