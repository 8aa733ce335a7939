"""Opening recordings in the Rerun viewer."""

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from emran_sumo.errors import UserError

FAILS_WITHIN = 1.5  # s in which a viewer that finds no display gives up
LISTENS_WITHIN = 30.0  # s in which a viewer that does listens to recordings
PORT = 9876  # Rerun's own default
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")


def open_viewer(*files: Path, asked: str = "--view") -> None:
    """Open recordings in one viewer, which outlives this process; `asked`: what the user typed for it.

    Raises:
        UserError: the viewer gives up at once; with its last words.
    """
    _start([*map(str, files)], asked, lambda: False, FAILS_WITHIN)


def listening_viewer(port: int = PORT) -> str:
    """Address of the viewer that listens on this machine; it is started where none does, and outlives this process.

    Raises:
        UserError: no viewer can be opened; with its last words.
    """
    if not _listens(port):
        _start(["--port", str(port), "--hide-welcome-screen"], "--live", lambda: _listens(port), LISTENS_WITHIN)
        time.sleep(FAILS_WITHIN)  # it may listen first and find no display then
        if not _listens(port):
            raise UserError("--live: the Rerun viewer did not open: it closed at once")
    return f"rerun+http://127.0.0.1:{port}/proxy"


def _start(words: list[str], asked: str, ready: Callable[[], bool], patience: float) -> None:
    """Start a viewer and wait until it is ready, or for `patience` [s] whether it gives up."""
    _check_display(asked)
    with tempfile.TemporaryFile() as said:
        # no pipe of ours is left open: whoever reads our output need not wait for the viewer
        viewer = subprocess.Popen(
            [sys.executable, "-m", "rerun", *words],
            stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        end = time.monotonic() + patience
        while time.monotonic() < end and not ready():
            if viewer.poll() not in (None, 0):
                said.seek(0)
                last = (said.read().decode(errors="replace").strip().splitlines() or ["it said nothing"])[-1]
                raise UserError(f"{asked}: the Rerun viewer did not open: {last}")
            time.sleep(0.05)


def _check_display(asked: str) -> None:
    """A viewer without a display gives up too, but on a busy machine only after a while."""
    if sys.platform == "linux" and not any(os.environ.get(name) for name in DISPLAYS):
        reason = "there is no display; accepted is a desktop, or DISPLAY set to one."
        raise UserError(f"{asked}: the Rerun viewer did not open: {reason}")


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex(("127.0.0.1", port)) == 0
