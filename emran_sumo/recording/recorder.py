"""One run as one Rerun file: the road, the traffic, the ego, its plots, events and states, on one timeline.

Rows are gathered and sent as columns every 4 s of simulated time: memory stays flat, a killed run loses
at most the last chunk, and files of equal runs are equal (`rerun rrd compare`).
"""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
import pyarrow as pa
import rerun as rr

from emran_sumo.recording.car import EgoShape, draw_ego
from emran_sumo.recording.colors import PINK, TEAL, packed, speed_colors
from emran_sumo.recording.layout import TIMELINE, layout
from emran_sumo.recording.plots import ARCHETYPE, CURVES, EVENT_COLORS, STATES
from emran_sumo.recording.road import draw_road, road_shapes
from emran_sumo.world.records import Road, Traffic

CHUNK = 4000  # ms of simulated time per chunk
PLOT_PERIOD = 20  # ms between the samples of a plot
REFERENCE_PERIOD = 100  # ms between the drawings of the path ahead
REFERENCE_POINTS = 16  # points of the path ahead that are drawn
# Positions of the traffic are rounded to 1/64 m, its turns to 1/4096: invisible, and a fifth smaller.
_GRID, _TURN = 64.0, 4096.0
_MILLISECOND = 1_000_000  # ns


class Recorder:
    """Writes one run into one file; use it as a context manager.

    Whatever ends the block (a return, an exception, SystemExit), the file is finished and readable.

    Args:
        file: path of the .rrd file; its folder is created.
        application: one id per kind of layout; the viewer keeps layouts by it.
        recording: id of the run; files with the same id fuse in the viewer.
        name: sentence shown as the name of the recording.
        road: drawn once.
        ego: outline of the ego.
        columns: names of the trace columns, in order.
        live: address of a viewer that is to show the run while it goes on; it may be closed at any time.

    Raises:
        KeyError: a column that a plot shows is missing.
    """

    def __init__(
        self,
        file: Path | str,
        *,
        application: str = "emran_sumo",
        recording: str,
        name: str,
        road: Road,
        ego: EgoShape,
        columns: Sequence[str],
        live: str = "",
    ) -> None:
        self._column = {column: i for i, column in enumerate(columns)}
        self._curves = [
            (rr.ComponentDescriptor(f"{ARCHETYPE}:{c.component}"), self._index(c.column), c.scale) for c in CURVES
        ]
        self._pose = [self._index(c) for c in ("x", "y", "yaw", "reference_yaw", "steer")]
        self._time = self._index("time")
        self._name = name
        self._live = bool(live)
        self._closed = False
        self._chunk: int | None = None
        self._last_point: np.ndarray | None = None
        self._last_state: dict[str, str] = {}
        self._forget()

        shapes = road_shapes(road)
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        # No wall-clock time anywhere: it would make equal runs differ.
        self._stream = rr.RecordingStream(application, recording_id=recording, send_properties=False)
        sinks = [rr.FileSink(str(file))] + ([rr.GrpcSink(live)] if live else [])
        self._stream.set_sinks(*sinks)
        self._stream.set_log_time_enabled(False)
        self._stream.send_blueprint(layout(shapes.bounds), make_active=True, make_default=True)
        self._stream.send_recording_name(name)
        self._static("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        draw_road(self._stream, shapes)
        draw_ego(self._stream, ego)
        self._style_moving()
        self._describe_states()
        self._summary(f"**{name}**: not finished, its run is still going on or was killed")
        self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None and not self._closed:
            self.close(f"**{self._name}**: stopped early by {kind.__name__} {error}".rstrip())
        self.close()

    def write(self, trace_rows: np.ndarray, traffic: Traffic, reference: np.ndarray) -> None:
        """Record one SUMO step.

        Args:
            trace_rows: (n, columns) rows of the ego in this step; the last is its pose at the step's end.
            traffic: everybody else at the instant of the last row.
            reference: (m, 2) or (m, 3) points [m] of the path ahead; none where it has ended.
        """
        if self._closed:
            raise RuntimeError("the recording is closed")
        rows = np.array(trace_rows, dtype=np.float64)
        now = round(rows[-1, self._time] * 1e3)
        self._rows.append(rows)
        self._traffic.append(np.array(traffic[1:], dtype=np.float64))
        if now % REFERENCE_PERIOD == 0:
            ahead = reference if len(reference) else rows[-1:, self._pose[:2]]
            self._references.append((now, _thinned(ahead)))
        if self._chunk is None:
            self._chunk = now // CHUNK
        if now // CHUNK > self._chunk:
            self._flush()
            self._chunk = now // CHUNK

    def event(self, time: float, level: str, text: str) -> None:
        """Add a line at `time` [s] to the list of events; level is DEBUG, INFO, WARN or ERROR."""
        if level not in EVENT_COLORS:
            raise ValueError(f"event level {level!r} is none of {', '.join(EVENT_COLORS)}")
        self._events.append((round(time * 1e3), level, text))

    def state(self, time: float, name: str, value: str) -> None:
        """Set the lane `name` of the state timeline to `value` from `time` [s] on; repeats are dropped."""
        if self._last_state.get(name) != value:
            self._last_state[name] = value
            self._states.setdefault(name, []).append((round(time * 1e3), value))

    def close(self, summary_markdown: str | None = None, properties: Mapping[str, object] | None = None) -> None:
        """Finish the file: rows still held, summary, properties of the run. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        try:
            self._flush()
        finally:
            self._summary(f"**{self._name}**: finished" if summary_markdown is None else summary_markdown)
            if properties:
                self._stream.send_property("run", rr.AnyValues(**properties))  # pyright: ignore[reportArgumentType]
            with contextlib.suppress(RuntimeError) if self._live else contextlib.nullcontext():
                self._stream.flush()  # raises where the viewer has been closed; the file is finished all the same
            self._stream.disconnect()

    def _index(self, column: str) -> int:
        if column not in self._column:
            raise KeyError(f"the trace has no column {column!r}, which the recording shows")
        return self._column[column]

    def _forget(self) -> None:
        self._rows: list[np.ndarray] = []
        self._traffic: list[np.ndarray] = []
        self._references: list[tuple[int, np.ndarray]] = []
        self._events: list[tuple[int, str, str]] = []
        self._states: dict[str, list[tuple[int, str]]] = {}

    def _flush(self) -> None:
        if self._rows:
            self._send_plots()
            self._send_scene()
        if self._events:
            times, levels, texts = zip(*self._events, strict=True)
            colors = packed(EVENT_COLORS[level] for level in levels)
            self._send("/events", np.array(times), rr.TextLog.columns(text=texts, level=levels, color=colors))
        for name, changes in self._states.items():
            times, values = zip(*changes, strict=True)
            self._send(f"/state/{name}", np.array(times), rr.StateChange.columns(state=values))
        self._forget()

    def _send(self, entity: str, milliseconds: np.ndarray, columns: Iterable[rr.ComponentColumn]) -> None:
        # Whole nanoseconds: Rerun truncates times given as floating-point seconds.
        duration = (milliseconds.astype(np.int64) * _MILLISECOND).astype("timedelta64[ns]")
        self._stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=duration)], columns)

    def _send_plots(self) -> None:
        rows = np.concatenate(self._rows)
        times = np.rint(rows[:, self._time] * 1e3).astype(np.int64)
        sampled = times % PLOT_PERIOD == 0
        if not sampled.any():
            return
        chosen = rows[sampled].T
        # float32: the plots need no more, and the exact trace is a table of its own.
        columns = [
            rr.ComponentColumn(name, _Values((chosen[i] * scale).astype(np.float32))) for name, i, scale in self._curves
        ]
        self._send("/plots/ego", times[sampled], columns)

    def _send_scene(self) -> None:
        ends = np.array([frame[-1] for frame in self._rows])
        times = np.rint(ends[:, self._time] * 1e3).astype(np.int64)
        x, y, yaw, road_yaw, steer = ends[:, self._pose].T
        points = np.column_stack((x, y, np.zeros_like(x))).astype(np.float32)
        for entity, angle in (("/world/ego", yaw), ("/world/ego_frame", road_yaw)):
            self._send(entity, times, rr.Transform3D.columns(translation=points, quaternion=_turns(angle)))
        columns = rr.Boxes3D.columns(quaternions=np.repeat(_turns(steer), 2, axis=0))
        self._send("/world/ego/front_wheels", times, columns.partition([2] * len(times)))
        self._send_trail(times, points)
        if self._references:
            whens, strips = zip(*self._references, strict=True)
            self._send("/world/reference", np.array(whens), rr.LineStrips3D.columns(strips=np.array(strips)))
        self._send_traffic(times)

    def _send_trail(self, times: np.ndarray, points: np.ndarray) -> None:
        """One segment per step, from where the ego was a step before."""
        start = points[:1] if self._last_point is None else self._last_point
        joined = np.concatenate((start, points)) + np.array([0.0, 0.0, 0.05], dtype=np.float32)
        self._last_point = points[-1:]
        strips = np.stack((joined[:-1], joined[1:]), axis=1)
        self._send("/world/trail", times, rr.LineStrips3D.columns(strips=strips))

    def _send_traffic(self, times: np.ndarray) -> None:
        x, y, yaw, length, width, height, speed = np.concatenate(self._traffic, axis=1)
        centers = np.column_stack((np.rint(x * _GRID) / _GRID, np.rint(y * _GRID) / _GRID, height / 2))
        columns = rr.Boxes3D.columns(
            centers=centers.astype(np.float32),
            half_sizes=(np.column_stack((length, width, height)) / 2).astype(np.float32),
            quaternions=np.rint(_turns(yaw) * _TURN) / np.float32(_TURN),
            colors=speed_colors(speed),
        )
        self._send("/world/traffic", times, columns.partition([part.shape[1] for part in self._traffic]))

    def _static(self, entity: str, *shapes: rr.AsComponents) -> None:
        self._stream.log(entity, *shapes, static=True)

    def _style_moving(self) -> None:
        """What never changes about the shapes that move."""
        self._static("/world/traffic", rr.Boxes3D.from_fields(fill_mode="solid", show_labels=False))
        self._static("/world/trail", rr.LineStrips3D.from_fields(radii=0.14, colors=packed([PINK])))
        self._static("/world/reference", rr.LineStrips3D.from_fields(radii=0.12, colors=packed([TEAL])))

    def _describe_states(self) -> None:
        for name, values in STATES.items():
            colors = packed(values.values())
            self._static(f"/state/{name}", rr.StateConfiguration(values=list(values), colors=colors))

    def _summary(self, text: str) -> None:
        self._static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


class _Values(NamedTuple):
    """Plain numbers as Rerun takes them, without its guessing of types, which costs more than the sending."""

    values: np.ndarray

    def as_arrow_array(self) -> pa.Array:
        return pa.array(self.values)


def _turns(yaw: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions x, y, z, w of rotations about the vertical, float32."""
    turns = np.zeros((len(yaw), 4), dtype=np.float32)
    turns[:, 2], turns[:, 3] = np.sin(yaw / 2), np.cos(yaw / 2)
    return turns


def _thinned(reference: np.ndarray) -> np.ndarray:
    """(REFERENCE_POINTS, 3) of the points, first and last included, slightly above the road."""
    points = np.asarray(reference, dtype=np.float64)
    chosen = np.arange(REFERENCE_POINTS) * (len(points) - 1) // (REFERENCE_POINTS - 1)
    raised = np.full((REFERENCE_POINTS, 3), 0.06, dtype=np.float32)
    raised[:, :2] = points[chosen, :2]
    return raised
