"""The folder of a run: what is put into it and what it says about itself."""

import contextlib
import hashlib
import json
import platform
import shlex
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from emran_sumo import __version__
from emran_sumo.controllers import label
from emran_sumo.errors import UserError
from emran_sumo.scenario import Located, to_dict
from emran_sumo.user_code import digests
from emran_sumo.world.session import version as sumo_version

STARTING = "starting.rou.xml"  # the traffic of a run that has not begun to drive
FILES = ("run.rrd", "trace.parquet", "summary.json", "traffic.rou.xml")


def prepare(out: Path, located: Located) -> Path:
    """The run's folder, made and found writable; an older run in it is left alone.

    Raises:
        UserError: the folder cannot be written.
    """
    s = located.values
    folder = out / located.name / f"{label(s.controller)}-seed{s.seed}"
    with writable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / STARTING).touch()
    return folder


def clear(folder: Path) -> None:
    """Remove an older run; the traffic of the new one takes its place."""
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
    for old in (folder / "egos").glob("*.parquet"):
        old.unlink()
    (folder / STARTING).replace(folder / "traffic.rou.xml")


@contextlib.contextmanager
def writable(folder: Path) -> Iterator[None]:
    """Turn what the system says of a folder that is not writable, or full, into a sentence."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"--out: cannot write to {folder}: {reason}; accepted is a writable folder.") from None


def manifest(located: Located, command: str) -> dict[str, Any]:
    """What is needed to repeat the run and to read it a month later."""
    resolved = to_dict(located.values)
    own = digests(located)
    digest = hashlib.sha256(json.dumps([resolved, own] if own else resolved, sort_keys=True).encode()).hexdigest()[:12]
    packages = {name: version(name) for name in ("numpy", "numba", "scipy", "pyarrow")}
    return {
        "scenario_name": located.name,
        "command": command or located.command or shlex.join(["emran-sumo", "run", located.name]),
        "digest": digest,
        **({"controller_sources": own} if own else {}),
        "seeds": {"traffic": located.values.seed, "sumo": located.values.seed},
        "versions": {
            "emran_sumo": __version__,
            "sumo": sumo_version(),
            **packages,
            "rerun": version("rerun-sdk"),
            "python": platform.python_version(),
        },
        "created": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "scenario": resolved,
    }


def properties(located: Located, ended: str) -> dict[str, Any]:
    """Properties of the recording."""
    s = located.values
    return {
        "scenario": located.name, "controller": s.controller, "seed": s.seed, "ended": ended, "version": __version__,
    }  # fmt: skip


def write_summary(file: Path, content: dict[str, Any]) -> None:
    """Write the summary; the file appears complete or not at all."""
    part = file.with_suffix(".part")
    part.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    part.replace(file)
