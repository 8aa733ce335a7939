"""Several runs of one scenario as one Rerun file: one road, one traffic, all egos, one curve each in every plot."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader

from emran_sumo.recording.arrangement import Arrangement
from emran_sumo.recording.car import EgoShape
from emran_sumo.recording.colors import COMPARED, NIGHT, SLATE, packed
from emran_sumo.recording.comparison_layout import PLOTS, Shown, comparison_layout, curves
from emran_sumo.recording.layout import TIMELINE
from emran_sumo.recording.plots import ARCHETYPE, LINE_WIDTH, STATES, Curve
from emran_sumo.recording.recorder import CHUNK, PLOT_PERIOD
from emran_sumo.recording.stream import Values, turns

MOST = len(COMPARED)
STEP = 50  # ms between the drawings of the egos
# What the first run's file gives to the scene; its car and its plots are drawn anew.
TAKEN = ["/world/road/**", "/world/signals/**", "/world/traffic/**", "/world/map/**", "/world/reference"]
_MILLISECOND = 1_000_000  # ns


class Compared(NamedTuple):
    """One of the runs: its label, its recording, the columns of its trace, the outline of its ego."""

    label: str
    recording: Path
    trace: Mapping[str, np.ndarray]
    ego: EgoShape


def write_comparison(
    file: Path,
    runs: Sequence[Compared],
    *,
    recording: str,
    name: str,
    summary: str,
) -> None:
    """Write the merged file; it appears complete or not at all.

    Args:
        file: path of the .rrd file.
        runs: at most MOST; road, traffic and path ahead are those of the first, which the camera follows.
        recording: id of the file; name: sentence shown as its name.
        summary: Markdown.
    """
    shown = tuple(Shown(run.label, f"{i}_{run.label}", COMPARED[i - 1]) for i, run in enumerate(runs, 1))
    end = max(float(run.trace["time"][-1]) for run in runs)
    layout = comparison_layout(shown, _bounds(runs[0].recording), end, _reached(runs))
    application = f"emran_sumo {recording}"  # the viewer keeps one layout for each
    part = file.with_name(f"{file.name}.{os.getpid()}.part")
    stream = rr.RecordingStream(application, recording_id=recording, send_properties=False)
    try:
        stream.save(str(part))
        stream.set_log_time_enabled(False)
        Arrangement((stream,), application).send(layout)
        stream.send_recording_name(name)
        stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.send_chunks(RrdReader(str(runs[0].recording)).stream().filter(content=TAKEN))
        _write_frame(stream, runs[0].trace)
        _write_curves(stream, "reference", runs[0].trace, (Curve("speed_reference", "reference", SLATE),))
        for i, (run, of) in enumerate(zip(runs, shown, strict=True)):
            _write_ego(stream, run, of, i)
            _write_curves(stream, of.key, run.trace, curves(of))
            _write_maneuvers(stream, run, of)
        stream.log("/summary", rr.TextDocument(summary, media_type=rr.MediaType.MARKDOWN), static=True)
        stream.flush()
        stream.disconnect()
        os.replace(part, file)
    finally:
        stream.disconnect()
        part.unlink(missing_ok=True)


def _reached(runs: Sequence[Compared]) -> dict[str, tuple[float, float]]:
    """Smallest and largest value of each plot, in its unit."""
    found = {}
    for name, plot in PLOTS.items():
        (curve,) = plot.curves
        values = [curve.scale * run.trace[curve.column] for run in runs]
        found[name] = (min(float(v.min()) for v in values), max(float(v.max()) for v in values))
    return found


def _bounds(recording: Path) -> tuple[float, float, float, float]:
    """(x_min, y_min, x_max, y_max) [m] of the road that a recording shows."""
    for chunk in RrdReader(str(recording)).stream().filter(content="/world/road/surface"):
        column = chunk.to_record_batch().column("Mesh3D:vertex_positions")
        points = column.flatten().flatten().to_numpy().reshape(-1, 3)
        (x_min, y_min), (x_max, y_max) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)
    return -50.0, -50.0, 50.0, 50.0


def _write_ego(stream: rr.RecordingStream, run: Compared, of: Shown, place: int) -> None:
    """The first ego is solid, the others are outlines around it, each a little higher, so that none hides another."""
    ego, entity = run.ego, f"/world/ego/{of.key}"
    middle = ego.front_axle + ego.front_overhang - ego.length / 2
    color, half = packed([of.color]), 0.35 * ego.height + 0.06 * place
    body = rr.Boxes3D(
        centers=[(middle, 0, 0.25 + half)],
        half_sizes=[(ego.length / 2, ego.width / 2, half)],
        colors=color,
        radii=0.06,
        fill_mode="MajorWireframe" if place else "solid",
    )
    stream.log(f"{entity}/body", body, static=True)
    if place == 0:
        stream.log(f"{entity}/nose", _nose(ego, middle), static=True)
    stream.log(f"/world/trail/{of.key}", rr.LineStrips3D.from_fields(radii=0.07, colors=color), static=True)
    last = None
    for times, (x, y, yaw) in _chunks(run.trace, STEP, ("x", "y", "yaw"), opening=True):
        points = _points(x, y)
        _send(stream, entity, times, rr.Transform3D.columns(translation=points, quaternion=turns(yaw)))
        joined = np.concatenate((points[:1] if last is None else last, points)) + np.array(
            [0.0, 0.0, 0.05], dtype=np.float32
        )
        last = points[-1:]
        strips = np.stack((joined[:-1], joined[1:]), axis=1)
        _send(stream, f"/world/trail/{of.key}", times, rr.LineStrips3D.columns(strips=strips))


def _nose(ego: EgoShape, middle: float) -> rr.Mesh3D:
    """A triangle on the roof that points ahead."""
    level, front, side = 0.3 + 0.7 * ego.height, middle + 0.42 * ego.length, 0.34 * ego.width
    return rr.Mesh3D(
        vertex_positions=[(front, 0, level), (middle, side, level), (middle, -side, level)],
        triangle_indices=[[0, 1, 2]],
        vertex_normals=[(0, 0, 1)] * 3,
        albedo_factor=int(packed([NIGHT])[0]),
    )


def _write_frame(stream: rr.RecordingStream, trace: Mapping[str, np.ndarray]) -> None:
    """What the cameras follow, and the mark on the map: the first ego's place, turned as its road."""
    style = rr.Points3D.from_fields(radii=rr.Radius.ui_points(6), colors=packed([COMPARED[0]]))
    stream.log("/world/ego/marker", style, static=True)
    for times, (x, y, yaw) in _chunks(trace, STEP, ("x", "y", "reference_yaw"), opening=True):
        points = _points(x, y)
        _send(stream, "/world/ego_frame", times, rr.Transform3D.columns(translation=points, quaternion=turns(yaw)))
        _send(stream, "/world/ego/marker", times, rr.Points3D.columns(positions=points))


def _write_curves(stream: rr.RecordingStream, key: str, trace: Mapping[str, np.ndarray], of: tuple[Curve, ...]) -> None:
    """All curves of one controller as components of one entity."""
    names = [rr.ComponentDescriptor(f"{ARCHETYPE}:{curve.component}") for curve in of]
    stream.log(f"/plots/{key}", rr.SeriesLines.from_fields(widths=LINE_WIDTH), static=True)
    for times, values in _chunks(trace, PLOT_PERIOD, tuple(curve.column for curve in of)):
        columns = [
            rr.ComponentColumn(name, Values((column * curve.scale).astype(np.float32)))
            for name, curve, column in zip(names, of, values, strict=True)
        ]
        _send(stream, f"/plots/{key}", times, columns)


def _write_maneuvers(stream: rr.RecordingStream, run: Compared, of: Shown) -> None:
    """The maneuvers of a run, as its own recording tells them."""
    values = STATES["maneuver"]
    entity = f"/state/{of.key}"
    stream.log(entity, rr.StateConfiguration(values=list(values), colors=packed(values.values())), static=True)
    own = RrdReader(str(run.recording)).stream().filter(content="/state/maneuver", has_timeline=TIMELINE)
    stream.send_chunks(chunk.with_entity_path(entity) for chunk in own)


def _chunks(trace: Mapping[str, np.ndarray], period: int, columns: tuple[str, ...], opening: bool = False):
    """Times [ms] and values (columns, n) of the rows at multiples of `period` [ms], a chunk at a time; with the
    `opening` also of the first row, where the file opens."""
    times = np.rint(trace["time"] * 1e3).astype(np.int64)
    due = times % period == 0
    due[0] |= opening
    chosen = np.flatnonzero(due)
    ends = np.flatnonzero(np.diff(times[chosen] // CHUNK)) + 1
    for rows in np.split(chosen, ends):
        if rows.size:
            yield times[rows], [trace[column][rows] for column in columns]


def _points(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.column_stack((x, y, np.zeros_like(x))).astype(np.float32)


def _send(stream: rr.RecordingStream, entity: str, milliseconds: np.ndarray, columns) -> None:
    duration = (milliseconds * _MILLISECOND).astype("timedelta64[ns]")
    stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=duration)], columns)
