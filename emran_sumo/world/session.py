"""Starting SUMO in this process, and its own words when something is wrong."""

import contextlib
import math
import os
import re
import socket
import sys
import tempfile
from pathlib import Path

import libsumo
import numpy as np

from emran_sumo.errors import UserError

_UNKNOWN_OPTION = re.compile(r"No option with the name '([^']+)' exists")
KEEP_ROUTE, EXACT = 1, 2  # bits of moveToXY: stay on the route; take the pose as it is
VIEW = "View #0"  # SUMO's name of the first view of its window
CLOSE_UP = 200.0  # m of road across that view
SUMO_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)


def scenario_options(
    network: Path, route_files: list[Path], additional: list[Path], driver_step: float
) -> dict[str, str]:
    """SUMO's options for a scenario of ours.

    Raises:
        UserError: a file does not exist.
    """
    named = [("network", network), *(("route", f) for f in route_files), *(("additional", f) for f in additional)]
    for kind, file in named:
        if not file.is_file():
            raise UserError(f"{file}: no such {kind} file.")
    options = {
        "net-file": str(network),
        "route-files": ",".join(map(str, route_files)),
        "default.action-step-length": f"{driver_step:g}",
        "time-to-teleport": "-1",
        "xml-validation": "never",
    }
    return options | ({"additional-files": ",".join(map(str, additional))} if additional else {})


def start(options: dict[str, str], step: float, seed: int, gui: bool) -> tuple[str, ...]:
    """Start SUMO with options that every run shares; returns those of `options` that it does not know.

    Ballistic integration: the plant's speed is continuous, and so is then what SUMO expects of it.

    Raises:
        UserError: with SUMO's own reason.
    """
    if gui:
        _check_display()
    ours = {
        "step-length": f"{step:g}",
        "step-method.ballistic": "true",
        "seed": str(seed),
        "collision.action": "warn",
        "collision.mingap-factor": "0",
        "collision.check-junctions": "true",
        "no-step-log": "true",
        "no-warnings": "true",
        "duration-log.disable": "true",
    }
    unknown: list[str] = []
    while True:
        command = ["sumo-gui" if gui else "sumo"]
        for key, value in (options | ours).items():
            if key not in unknown:
                command += [f"--{key}", value]
        if gui:
            command += ["--start", "--quit-on-end"]
        with messages() as read:
            try:
                libsumo.start(command)
            except SUMO_ERRORS as error:
                reason = read() or str(error)
            else:
                return tuple(unknown)
        refused = _UNKNOWN_OPTION.search(reason)
        if refused is None or refused[1] in unknown or refused[1] not in options:
            raise UserError(f"SUMO cannot start with {options['net-file']}: {one_line(reason)}")
        unknown.append(refused[1])


def move(vehicle: str, x: float, y: float, yaw: float, keep_route: bool = True) -> None:
    """Put the front bumper of a vehicle at (x, y) [m] with `yaw` [rad], exactly, when the step ends.

    keep_route: only on the edges of its route; else on any lane there, which becomes the begin of its route.
    """
    angle = (90.0 - math.degrees(yaw)) % 360.0
    libsumo.vehicle.moveToXY(vehicle, "", -1, x, y, angle, EXACT | KEEP_ROUTE if keep_route else EXACT)


def close() -> None:
    """Close SUMO; raises what libsumo raises.

    The thread of SUMO's own window ends only with a further event of the display: a new view brings some.
    """
    if libsumo.hasGUI():
        libsumo.gui.addView("closing")
    libsumo.close()


def show(vehicle: str) -> None:
    """Let SUMO's own window, where there is one, follow a vehicle if it follows none yet."""
    if libsumo.hasGUI() and not libsumo.gui.getTrackedVehicle(VIEW):
        libsumo.gui.trackVehicle(VIEW, vehicle)
        corners = np.array(libsumo.simulation.getNetBoundary())
        libsumo.gui.setZoom(VIEW, 100.0 * float(np.ptp(corners, axis=0).max()) / CLOSE_UP)


def _check_display() -> None:
    """Refuse a window without a display: SUMO's own window library ends the whole process there."""
    display = os.environ.get("DISPLAY", "")
    if os.name != "posix" or sys.platform == "darwin":
        return
    if not display:
        raise UserError("--sumo-gui: there is no display; accepted is a session with one (DISPLAY is not set).")
    host, _, number = display.rpartition(":")
    if host in ("", "unix"):
        place = f"/tmp/.X11-unix/X{number.partition('.')[0]}"
        with socket.socket(socket.AF_UNIX) as probe:
            try:
                probe.connect(place)
            except OSError:
                raise UserError(f'--sumo-gui: no display answers at DISPLAY="{display}".') from None


def version() -> str:
    """Version of SUMO."""
    return libsumo.getVersion()[1].removeprefix("SUMO ")


def one_line(text: str) -> str:
    """SUMO's messages as one sentence."""
    lines = [line.strip().removeprefix("Error:").strip() for line in text.splitlines()]
    text = " ".join(line for line in lines if line and not line.startswith("Quitting"))
    return text if text.endswith(".") else text + "."


@contextlib.contextmanager
def messages():
    """Catch what SUMO writes to file descriptor 2, the only place where it tells why it cannot go on."""
    with tempfile.TemporaryFile() as sink:
        saved = os.dup(2)
        os.dup2(sink.fileno(), 2)

        def read() -> str:
            sink.seek(0)
            return sink.read().decode(errors="replace")

        try:
            yield read
        finally:
            os.dup2(saved, 2)
            os.close(saved)


@contextlib.contextmanager
def told():
    """Turn SUMO's exceptions, which cannot even be pickled, into a plain sentence."""
    try:
        yield
    except SUMO_ERRORS as error:
        raise UserError(f"SUMO stopped: {one_line(str(error))}") from None
