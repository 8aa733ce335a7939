"""Exporting one run: which file is meant, which one is written."""

import contextlib
import json
import os
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from emran_sumo import found
from emran_sumo.ego import UNITS
from emran_sumo.errors import UserError
from emran_sumo.recording.table import read_trace, read_units, write_csv
from emran_sumo.report import verdict
from emran_sumo.warm import Progress

Content = TypeVar("Content")
FORMATS = ("csv", "parquet", "png", "mp4")
NAMES = {"csv": "trace.csv", "png": "figures.png", "mp4": "video.mp4"}


def export(run: Path, kind: str, out: Path | None = None, progress: Progress = lambda *_: None) -> Path:
    """Write a run in another form; returns the file, which appears complete or not at all.

    Args:
        run: as for `found.trace`.
        kind: "csv", "parquet", "png" or "mp4".
        out: file to write, with the ending of its kind or without any; beside the trace where none is given. A trace is
            Parquet already.
        progress: called with ("draw", seconds drawn, seconds in all) for a video.

    Raises:
        UserError: no such run or format, another kind's ending, the file cannot be written, there is no encoder.
    """
    if kind not in FORMATS:
        raise UserError(f'--format: found "{kind}"; accepted is {", ".join(FORMATS[:-1])} or {FORMATS[-1]}.')
    if out is not None and out.suffix.lower() not in ("", f".{kind}"):
        raise UserError(f'--out: found "{out}" for the format {kind}; accepted is a name that ends in .{kind}.')
    trace = found.trace(run)
    _read(trace, read_units)
    if kind == "parquet" and out is None:
        return trace
    file = out or trace.with_name(NAMES[kind])
    if kind == "csv":
        return _complete(file, lambda part: write_csv(trace, part, UNITS))
    if kind == "parquet":
        return _complete(file, lambda part: shutil.copyfile(trace, part))
    summary = _summary(trace.with_name("summary.json"))
    columns = _read(trace, read_trace)
    if not columns["time"].size:
        raise UserError(f"{trace}: the run ended before its first step; there is nothing to draw.")
    if kind == "png":
        from emran_sumo.export.sheet import draw_sheet

        return _complete(file, lambda part: draw_sheet(part, columns, verdict(summary)))
    from emran_sumo.export.encoder import find_encoder
    from emran_sumo.export.video import draw_video
    from emran_sumo.recording.playback import read_scene

    recording = trace.with_name("run.rrd")
    if not recording.is_file():
        raise UserError(f"{recording}: not there; a video needs the recording of the run, made without --no-record.")
    scene = _read(recording, read_scene)
    encoder = find_encoder()
    return _complete(file, lambda part: draw_video(part, encoder, columns, scene, summary, progress))


def _read(file: Path, read: Callable[[Path], Content]) -> Content:
    try:
        with warnings.catch_warnings(action="ignore"):  # a killed run's recording has no end, which Rerun tells
            return read(file)
    except (OSError, ValueError, RuntimeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0].rstrip(".")
        raise UserError(f"{file}: cannot be read: {reason}; accepted is the folder of a finished run.") from None


def _summary(file: Path) -> dict:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is no JSON"
        raise UserError(f"{file}: cannot be read: {reason}; accepted is the folder of a finished run.") from None


def _complete(file: Path, write: Callable[[Path], object]) -> Path:
    part = file.with_name(f".{os.getpid()}.{file.name}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        write(part)
        os.replace(part, file)
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"--out: cannot write {file}: {reason}; accepted is a file that can be written.") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
    return file
