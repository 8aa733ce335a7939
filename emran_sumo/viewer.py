"""Opening recordings in the Rerun viewer."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from emran_sumo.errors import UserError

FAILS_WITHIN = 1.5  # s in which a viewer that finds no display gives up


def open_viewer(*files: Path, asked: str = "--view") -> None:
    """Open recordings in one viewer, which outlives this process; `asked`: what the user typed for it.

    Raises:
        UserError: the viewer gives up at once; with its last words.
    """
    with tempfile.TemporaryFile() as said:
        command = [sys.executable, "-m", "rerun", *map(str, files)]
        # no pipe of ours is left open: whoever reads our output need not wait for the viewer
        viewer = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
        )
        end = time.monotonic() + FAILS_WITHIN
        while time.monotonic() < end:
            if viewer.poll() not in (None, 0):
                said.seek(0)
                words = said.read().decode(errors="replace").strip().splitlines()
                raise UserError(f"{asked}: the Rerun viewer did not open: {words[-1] if words else 'it said nothing'}")
            time.sleep(0.05)
