"""A trace that goes to a file as it grows is the trace."""

import tracemalloc

import numpy as np
import pytest

from emran_sumo.frames import Frames
from emran_sumo.recording.table import read_trace, write_trace

STEPS = np.random.default_rng(1).normal(size=(40, 5, 3))


@pytest.mark.parametrize("in_memory", [1, 7, 50, 1000])
def test_all_rows_come_back_bit_by_bit_however_many_are_kept_in_memory(in_memory):
    frames = Frames(3, in_memory)
    assert frames.all().shape == frames.last.shape == (0, 3)
    for k, rows in enumerate(STEPS):
        frames.append(rows)
        assert frames.last is rows
        if k == 20:  # looked at in between
            np.testing.assert_array_equal(frames.all(), STEPS[:21].reshape(-1, 3))
    np.testing.assert_array_equal(frames.all(), STEPS.reshape(-1, 3))


def test_half_an_hour_holds_no_more_memory_than_two_minutes():
    frames, held = Frames(60), []
    tracemalloc.start()
    for minute in range(30):
        for _ in range(1200):
            frames.append(np.full((5, 60), float(minute)))
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert max(held) < 3.5e6, "bytes; all rows are 86 MB"
    assert np.array_equal(frames.all()[::6000, 7], np.arange(30.0))


def test_a_long_trace_is_written_in_parts_and_reads_back_as_one(tmp_path, monkeypatch):
    monkeypatch.setattr("emran_sumo.recording.table.AT_ONCE", 64)
    rows = STEPS.reshape(-1, 3)
    write_trace(tmp_path / "a.parquet", ("time", "x", "y"), rows)
    back = read_trace(tmp_path / "a.parquet")
    np.testing.assert_array_equal(np.column_stack(list(back.values())), rows)
    write_trace(tmp_path / "b.parquet", ("time",), rows[:0, :1])
    assert read_trace(tmp_path / "b.parquet")["time"].shape == (0,)
