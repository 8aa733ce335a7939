"""The trace of one ego as it grows: the last minute in memory, what is older in a file without a name."""

import tempfile
import weakref
from typing import IO

import numpy as np

IN_MEMORY = 6000  # rows: a minute at 100 Hz, 3 MB


class Frames:
    """Rows of a trace, appended step by step; a run of any length holds the same memory.

    Args:
        columns: of a row.
        in_memory: rows after which what has come so far goes to the file.
    """

    def __init__(self, columns: int, in_memory: int = IN_MEMORY) -> None:
        self._columns, self._most = columns, in_memory
        self._held: list[np.ndarray] = []
        self._rows = 0  # held
        self._file: IO[bytes] | None = None
        self.last = np.zeros((0, columns))

    def append(self, rows: np.ndarray) -> None:
        """Add the rows (n, columns) of a step."""
        self.last = rows
        self._held.append(rows)
        self._rows += len(rows)
        if self._rows >= self._most:
            self._put_away()

    def all(self) -> np.ndarray:
        """(n, columns) all rows so far; of a long run, a view into the file, which is not to be written to."""
        if self._file is None:
            return np.concatenate(self._held) if self._held else self.last
        self._put_away()
        count = self._file.tell() // (8 * self._columns)
        return np.asarray(np.memmap(self._file, dtype=np.float64, mode="r", shape=(count, self._columns)))

    def _put_away(self) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115 it lives as long as this does
            weakref.finalize(self, self._file.close)  # views keep what they show
        for rows in self._held:
            self._file.write(np.ascontiguousarray(rows, dtype=np.float64).data)
        self._file.flush()
        self._held, self._rows = [], 0
