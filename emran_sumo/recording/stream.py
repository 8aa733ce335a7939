"""The open file of a recording: what never changes, and columns of what does."""

import contextlib
import sys
import threading
from collections.abc import Iterable, Mapping
from datetime import timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from emran_sumo.recording.arrangement import Arrangement

TIMELINE = "sim_time"
PATIENCE = 5.0  # s that a viewer may take to answer
FROZEN = "emran-sumo: --live: the viewer has not answered for {:g} s and is left alone; the recording is complete."
_MILLISECOND = 1_000_000  # ns


class Stream:
    """One .rrd file, and the viewer at the address `live` that sees the same.

    Each has a stream of Rerun's of its own: a viewer that is slow, frozen or gone must not hold up the file.
    """

    def __init__(self, file: Path | str, application: str, recording: str, live: str = "") -> None:
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        self._file = _opened(rr.FileSink(str(file)), application, recording)
        self._viewer = _opened(rr.GrpcSink(live), application, recording) if live else None
        self.both = (self._file,) if self._viewer is None else (self._file, self._viewer)
        self.arrangement = Arrangement(self.both, application)

    def static(self, entity: str, *shapes: rr.AsComponents) -> None:
        """Log what holds at all times."""
        batches = [batch for shape in shapes for batch in shape.as_component_batches()]
        columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
        for stream in self.both:
            stream.send_columns(entity, [], columns)

    def send(self, entity: str, milliseconds: np.ndarray, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log columns, one row per time; none for no times."""
        if not len(milliseconds):
            return
        # Whole nanoseconds: Rerun truncates times given as floating-point seconds.
        duration = (np.asarray(milliseconds).astype(np.int64) * _MILLISECOND).astype("timedelta64[ns]")
        given = list(columns)
        for stream in self.both:
            stream.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=duration)], given)

    def name(self, text: str) -> None:
        """What the viewer lists the recording as."""
        for stream in self.both:
            stream.send_recording_name(text)

    def properties(self, group: str, values: Mapping[str, object]) -> None:
        """Facts about the recording."""
        for stream in self.both:
            stream.send_property(group, rr.AnyValues(**values))  # pyright: ignore[reportArgumentType]

    def flush(self) -> None:
        """Write what is on its way to the file."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file; a viewer that has stopped answering is left alone after PATIENCE."""
        self._file.flush()
        self._file.disconnect()
        if self._viewer is None:
            return
        farewell = threading.Thread(target=_finish, args=(self._viewer,), daemon=True)
        farewell.start()
        farewell.join(PATIENCE)
        if farewell.is_alive():
            print(FROZEN.format(PATIENCE), file=sys.stderr, flush=True)
            rr.unregister_shutdown()  # it would wait for the viewer when Python ends


def _opened(sink: rr.FileSink | rr.GrpcSink, application: str, recording: str) -> rr.RecordingStream:
    """A stream without wall-clock times, which would make equal runs differ.

    Nor may the wall's clock decide what is sent together: what is logged waits for a flush.
    """
    waiting = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))
    stream = rr.RecordingStream(application, recording_id=recording, send_properties=False, batcher_config=waiting)
    stream.set_sinks(sink)
    stream.set_log_time_enabled(False)
    return stream


def _finish(viewer: rr.RecordingStream) -> None:
    """Say goodbye; a viewer that has been closed raises."""
    with contextlib.suppress(RuntimeError):
        viewer.flush()
    viewer.disconnect()


class Values(NamedTuple):
    """Plain numbers as Rerun takes them, without its guessing of types, which costs more than the sending."""

    values: np.ndarray

    def as_arrow_array(self) -> pa.Array:
        return pa.array(self.values)


def series(component: rr.ComponentDescriptor, values: np.ndarray) -> rr.ComponentColumn:
    """Scalars (n,), or k of them per row as (n, k); what is not finite is left out, which a plot shows as a gap.

    A NaN would too, but equal files would compare as different.
    """
    table = values.astype(np.float32).reshape(len(values), -1)
    finite = np.isfinite(table)
    if table.shape[1] == 1 and finite.all():
        return rr.ComponentColumn(component, Values(table.ravel()))
    return rr.ComponentColumn(component, Values(table[finite]), lengths=finite.sum(axis=1))


class Changes:
    """Finds the rows in which something differs from the row before, across chunks."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """(n,) whether each row of `values` (n, k) is new; the first of all is."""
        rows = values.reshape(len(values), -1)
        before = rows[:1] - 1 if self._last is None else self._last
        self._last = rows[-1:]
        return (np.concatenate((before, rows[:-1])) != rows).any(axis=1)


def turns(yaw: np.ndarray) -> np.ndarray:
    """(n, 4) quaternions x, y, z, w of rotations about the vertical, float32."""
    found = np.zeros((len(yaw), 4), dtype=np.float32)
    found[:, 2], found[:, 3] = np.sin(yaw / 2), np.cos(yaw / 2)
    return found
