"""One run as one Rerun file: the road, the traffic, the ego, its plots, events and states, on one timeline.

Rows are gathered and sent as columns after 2 s, and every 24 s of simulated time: memory stays flat, a killed run loses
at most the last chunk, and files of equal runs are equal (`rerun rrd compare`).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import rerun as rr

from emran_sumo.recording.car import EgoShape, draw_ego
from emran_sumo.recording.colors import TEAL, packed
from emran_sumo.recording.insight import Insight, send_insights, style_insights
from emran_sumo.recording.layout import Extents, layout
from emran_sumo.recording.motion import EgoMotion
from emran_sumo.recording.plots import ARCHETYPE, CURVES, EVENT_COLORS, LINE_WIDTH, STATES
from emran_sumo.recording.road import draw_road, road_shapes
from emran_sumo.recording.stream import Stream, series
from emran_sumo.recording.surroundings import Patch, PatchSender, draw_stop_lines, send_signals
from emran_sumo.recording.vehicles import Vehicles
from emran_sumo.recording.watch import Limits, Watch
from emran_sumo.world.records import Road, Traffic

# ms of simulated time per chunk: each costs as much as two seconds of what is in it, and Rerun keeps 4 kB of each
# until the file ends
CHUNK = 24_000
FIRST_CHUNK = 2000  # ms: a run that is killed soon after has something to show
LIVE_CHUNK = 2000  # ms, where somebody watches
PLOT_PERIOD = 20  # ms between the samples of a plot
REFERENCE_PERIOD = 200  # ms between the drawings of the path ahead
REFERENCE_POINTS = 24  # points of the path ahead that are drawn
REFERENCE_LEVEL = 0.06  # m above the road
_PARTS = np.arange(REFERENCE_POINTS)


class Recorder:
    """Writes one run into one file; use it as a context manager.

    Whatever ends the block (a return, an exception, SystemExit), the file is finished and readable.

    Args:
        file: path of the .rrd file; its folder is created.
        recording: id of the run; files with the same id fuse in the viewer. The viewer keeps one layout per
            application, and headings and axes tell the ranges of this run: each run is an application of its own.
        name: sentence shown as the name of the recording.
        road: drawn once.
        ego: outline of the ego.
        columns: names of the trace columns, in order.
        limits: of car and controller; hits are events.
        live: address of a viewer that is to show the run while it goes on; it may be closed at any time.

    Raises:
        KeyError: a column that a plot shows is missing.
    """

    def __init__(
        self,
        file: Path | str,
        *,
        recording: str,
        name: str,
        road: Road,
        ego: EgoShape,
        columns: Sequence[str],
        limits: Limits | None = None,
        live: str = "",
    ) -> None:
        self._column = {column: i for i, column in enumerate(columns)}
        self._curves = [rr.ComponentDescriptor(f"{ARCHETYPE}:{c.component}") for c in CURVES]
        self._sources = [self._index(c.column) for c in CURVES]
        self._scales = np.array([c.scale for c in CURVES])
        self._place = [self._index(c) for c in ("x", "y")]
        self._time = self._index("time")
        self._watch = Watch(limits, self._index)
        self._name = name
        self._live = bool(live)
        self._closed = False
        self._chunk: int | None = None
        self._begin: int | None = None  # ms, of the first row: the file opens there
        self._shown, self._lit = False, False  # whether anything of the scene, of the lights was sent
        self._described: set[str] = set()
        self._last_state: dict[str, str] = {}
        self.patched: object = None  # the lane whose patch is drawn
        self._extents = Extents()
        self._forget()

        shapes = road_shapes(road)
        self._bounds = shapes.bounds
        self._stream = Stream(file, f"emran_sumo {recording}", recording, live)
        self._stream.arrangement.send(layout(self._bounds, self._extents))
        self._stream.name(name)
        self._stream.static("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        draw_road(self._stream, shapes)
        draw_stop_lines(self._stream, road.stop_lines)
        self._patch = PatchSender(self._stream)
        draw_ego(self._stream, ego)
        self._motion = EgoMotion(self._stream, ego, self._index)
        style_insights(self._stream)
        self._stream.static("/plots/ego", rr.SeriesLines.from_fields(widths=LINE_WIDTH))
        self._vehicles = Vehicles(self._stream)
        self._stream.static("/world/reference", rr.LineStrips3D.from_fields(radii=0.12, colors=packed([TEAL])))
        for lane in ("maneuver", "learning"):
            self._describe(lane)
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

    def write(
        self,
        trace_rows: np.ndarray,
        traffic: Traffic,
        reference: Callable[[], np.ndarray],
        egos: Iterable[str] = (),
    ) -> None:
        """Record one SUMO step.

        Args:
            trace_rows: (n, columns) rows of the ego in this step; the last is its pose at the step's end.
            traffic: everybody else at the instant of the last row.
            reference: gives (m, 2) or (m, 3) points [m] of the path ahead, none where it has ended; asked when drawn.
            egos: ids of those in the traffic that are egos of the run too.
        """
        if self._closed:
            raise RuntimeError("the recording is closed")
        rows = np.array(trace_rows, dtype=np.float64)
        now = round(float(rows[-1, self._time]) * 1e3)
        opening = self._begin is None
        shown = round(float(rows[0, self._time]) * 1e3) if opening else now
        if opening:
            self._begin = shown
        self._rows.append(rows)
        self._traffic.append((traffic, frozenset(egos)))
        if opening or now % REFERENCE_PERIOD == 0:
            ahead = reference()
            self._references.append((shown, _thinned(ahead if len(ahead) else rows[-1:, self._place])))
        chunk = now // LIVE_CHUNK if self._live else now // CHUNK if now >= FIRST_CHUNK else -1
        if self._chunk is not None and chunk > self._chunk:
            self._flush()
        self._chunk = chunk

    def event(self, time: float, level: str, text: str) -> None:
        """Add a line at `time` [s] to the list of events; level is DEBUG, INFO, WARN or ERROR."""
        if level not in EVENT_COLORS:
            raise ValueError(f"event level {level!r} is none of {', '.join(EVENT_COLORS)}")
        self._events.append((round(time * 1e3), level, text))

    def state(self, time: float, name: str, value: str) -> bool:
        """Set the lane `name` of the state timeline to `value` from `time` [s] on; whether that is a change."""
        if self._last_state.get(name) == value:
            return False
        self._last_state[name] = value
        self._describe(name)
        self._states.setdefault(name, []).append((round(time * 1e3), value))
        return True

    def signals(self, time: float, states: str) -> None:
        """What the lights show from `time` [s] on: a letter of SUMO per stop line of the road that has a light."""
        first, self._lit = not self._lit, True
        self._signals.append((round(time * 1e3) if not first or self._begin is None else self._begin, states))

    def patch(self, time: float, patch: Patch | None) -> None:
        """The stretch of the road with another friction, from `time` [s] on: on another lane, or none in sight."""
        self._patch.send(round(time * 1e3), patch)

    def network(self, time: float, name: str, looked: Insight) -> None:
        """What the network `name` (steering, speed) is at `time` [s]."""
        self._insights.setdefault(name, []).append((round(time * 1e3), looked))

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
                self._stream.properties("run", properties)
            if not self._live:  # whoever watches has arranged the views by now
                self._stream.arrangement.send(layout(self._bounds, self._extents))
            self._stream.close()

    def _index(self, column: str) -> int:
        if column not in self._column:
            raise KeyError(f"the trace has no column {column!r}, which the recording shows")
        return self._column[column]

    def _forget(self) -> None:
        self._rows: list[np.ndarray] = []
        self._traffic: list[tuple[Traffic, frozenset[str]]] = []
        self._references: list[tuple[int, np.ndarray]] = []
        self._events: list[tuple[int, str, str]] = []
        self._states: dict[str, list[tuple[int, str]]] = {}
        self._signals: list[tuple[int, str]] = []
        self._insights: dict[str, list[tuple[int, Insight]]] = {}

    def _flush(self) -> None:
        if self._rows:
            rows = np.concatenate(self._rows)
            self._note(rows)
            self._send_plots(rows)
            self._send_scene()
        send_signals(self._stream, self._signals)
        self._send_insights()
        if self._events:
            times, levels, texts = zip(*self._events, strict=True)
            colors = packed(EVENT_COLORS[level] for level in levels)
            self._stream.send("/events", np.array(times), rr.TextLog.columns(text=texts, level=levels, color=colors))
        for name, changes in self._states.items():
            times, values = zip(*changes, strict=True)
            self._stream.send(f"/state/{name}", np.array(times), rr.StateChange.columns(state=values))
        self._forget()

    def _send_insights(self) -> None:
        for name, looks in self._insights.items():
            times, found = zip(*looks, strict=True)
            self._extents.include_space(name, found)
            send_insights(self._stream, name, np.array(times), list(found))

    def _note(self, rows: np.ndarray) -> None:
        """Events and states that the rows themselves tell, in their order of time with the others."""
        notes, states = self._watch.look(rows)
        for note in notes:
            self.event(*note)
        self._events.sort(key=lambda event: event[0])
        for when, value in states:
            self.state(when, "disturbance", value)

    def _send_plots(self, rows: np.ndarray) -> None:
        times = np.rint(rows[:, self._time] * 1e3).astype(np.int64)
        sampled = times % PLOT_PERIOD == 0
        if not sampled.any():
            return
        # float32: the plots need no more, and the exact trace is a table of its own.
        values = (rows[sampled][:, self._sources] * self._scales).T.astype(np.float32)
        values[~np.isfinite(values)] = np.nan  # nobody ahead, nothing to collide with
        self._extents.include(values)
        self._extents.end = float(rows[-1, self._time])
        columns = [series(name, line) for name, line in zip(self._curves, values, strict=True)]
        self._stream.send("/plots/ego", times[sampled], columns)

    def _send_scene(self) -> None:
        ends = np.array([frame[-1] for frame in self._rows])
        traffic = self._traffic
        if not self._shown:  # the file opens at its first row, the first step ends later
            self._shown = True
            if len(self._rows[0]) > 1:
                ends, traffic = np.concatenate((self._rows[0][:1], ends)), [traffic[0], *traffic]
        times = np.rint(ends[:, self._time] * 1e3).astype(np.int64)
        self._motion.send(times, ends)
        if self._references:
            whens, strips = zip(*self._references, strict=True)
            raised = np.full((len(strips), REFERENCE_POINTS, 3), REFERENCE_LEVEL, dtype=np.float32)
            raised[..., :2] = strips
            self._stream.send("/world/reference", np.array(whens), rr.LineStrips3D.columns(strips=raised))
        self._vehicles.send(times, traffic)

    def _describe(self, lane: str) -> None:
        """Colors of a lane of the state timeline; the lane appears with them."""
        if lane in STATES and lane not in self._described:
            self._described.add(lane)
            values = STATES[lane]
            configuration = rr.StateConfiguration(values=list(values), colors=packed(values.values()))
            self._stream.static(f"/state/{lane}", configuration)

    def _summary(self, text: str) -> None:
        self._stream.static("/summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def _thinned(points: np.ndarray) -> np.ndarray:
    """(REFERENCE_POINTS, 2) of the points, first and last included."""
    return points[_PARTS * (len(points) - 1) // (REFERENCE_POINTS - 1), :2]
