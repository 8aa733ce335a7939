"""The open file of a recording: what never changes, and columns of what does."""

import contextlib
from collections.abc import Iterable
from datetime import timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

TIMELINE = "sim_time"
_MILLISECOND = 1_000_000  # ns


class Stream:
    """One .rrd file; `raw` is Rerun's own stream. live: address of a viewer that sees the same."""

    def __init__(self, file: Path | str, application: str, recording: str, live: str = "") -> None:
        Path(file).parent.mkdir(parents=True, exist_ok=True)
        # No wall-clock time anywhere: it would make equal runs differ.
        # Nor may the wall's clock decide what is sent together: what is logged waits for a flush.
        waiting = rr.ChunkBatcherConfig(flush_tick=timedelta(days=1))
        self.raw = rr.RecordingStream(
            application, recording_id=recording, send_properties=False, batcher_config=waiting
        )
        self.raw.set_sinks(*[rr.FileSink(str(file))] + ([rr.GrpcSink(live)] if live else []))
        self._live = bool(live)
        self.raw.set_log_time_enabled(False)

    def static(self, entity: str, *shapes: rr.AsComponents) -> None:
        """Log what holds at all times."""
        batches = [batch for shape in shapes for batch in shape.as_component_batches()]
        self.raw.send_columns(entity, [], [batch.partition([len(batch.as_arrow_array())]) for batch in batches])

    def send(self, entity: str, milliseconds: np.ndarray, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log columns, one row per time; none for no times."""
        if not len(milliseconds):
            return
        # Whole nanoseconds: Rerun truncates times given as floating-point seconds.
        duration = (np.asarray(milliseconds).astype(np.int64) * _MILLISECOND).astype("timedelta64[ns]")
        self.raw.send_columns(entity, [rr.TimeColumn(TIMELINE, duration=duration)], columns)

    def close(self) -> None:
        """Finish the file."""
        self.flush()
        self.raw.disconnect()

    def flush(self) -> None:
        """Write what is on its way; a viewer that has been closed raises, and the file is finished all the same."""
        with contextlib.suppress(RuntimeError) if self._live else contextlib.nullcontext():
            self.raw.flush()


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
