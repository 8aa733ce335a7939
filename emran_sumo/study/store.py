"""The one door to a study's store: an SQLite file that the coordinator alone writes, one transaction per run."""

import contextlib
import json
import math
import sqlite3
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

from emran_sumo.errors import UserError
from emran_sumo.study.plan import Run
from emran_sumo.study.worker import DONE, FAILED, Outcome

FILE = "study.sqlite"
LOCK = "lock"
_OWN = {FILE, f"{FILE}-wal", f"{FILE}-shm", f"{FILE}-journal", LOCK, f"{LOCK}-journal", "workers.log"}
_SCHEMA = """
CREATE TABLE IF NOT EXISTS manifest (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS runs (
    key TEXT PRIMARY KEY,       -- digest of the resolved scenario: a run cannot be in here twice
    place INTEGER NOT NULL,     -- in the order of the grid
    scenario TEXT NOT NULL, label TEXT NOT NULL, factors TEXT NOT NULL, given TEXT NOT NULL,
    state TEXT,                 -- NULL while missing, then done or failed
    ended TEXT, reason TEXT, error TEXT, metrics TEXT,
    wall REAL, simulation REAL, finished REAL, attempts INTEGER NOT NULL DEFAULT 0, recording TEXT
) WITHOUT ROWID;
"""
_BLANK = "state = NULL, ended = NULL, reason = NULL, error = NULL, metrics = NULL, wall = NULL, finished = NULL"


class Row(NamedTuple):
    """A run with what became of it; state None while it is missing, times in seconds, recording within the folder."""

    run: Run
    state: str | None
    ended: str
    reason: str
    error: str
    metrics: dict[str, Any]
    wall: float
    simulation: float
    finished: float
    attempts: int
    recording: str


class Counts(NamedTuple):
    """Runs by state: in all, done, failed."""

    total: int
    done: int
    failed: int


@contextlib.contextmanager
def _told(folder: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.Error as error:
        raise UserError(f"{folder}: the study's store cannot be used: {error}.") from None
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {error.strerror}; accepted is a writable folder.") from None


class Store:
    """The store of the study in `folder`; use as a context manager.

    Args:
        folder: of the study.
        write: be its one coordinator; without, only look, also while another process writes.

    Raises:
        UserError: not a study's folder, not writable, or another coordinator is at work.
    """

    def __init__(self, folder: Path, write: bool = False) -> None:
        self.folder = folder
        self._lock: sqlite3.Connection | None = None
        file = folder / FILE
        with _told(folder):
            if not write:
                if not file.is_file():
                    raise UserError(f"{folder}: no study here; accepted is the folder of one, which holds {FILE}.")
                self._connection = _reader(file)
                return
            if folder.is_dir() and not file.is_file() and {f.name for f in folder.iterdir()} - _OWN:
                raise UserError(f"{folder}: holds other files but no study; accepted is a new or an empty folder.")
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = _locked(folder)
            self._connection = sqlite3.connect(file, isolation_level=None)
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")  # a row survives a power cut
            self._connection.executescript(_SCHEMA)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_) -> None:
        self._connection.close()
        if self._lock is not None:
            self._lock.close()

    def note(self, **values: Any) -> None:
        """Write entries of the manifest."""
        with _told(self.folder), self._transaction():
            rows = [(name, json.dumps(value)) for name, value in values.items()]
            self._connection.executemany("INSERT OR REPLACE INTO manifest VALUES (?, ?)", rows)

    def manifest(self) -> dict[str, Any]:
        """All entries of the manifest."""
        with _told(self.folder):
            return {name: json.loads(value) for name, value in self._connection.execute("SELECT * FROM manifest")}

    def enroll(self, runs: Iterable[Run]) -> None:
        """Enter the runs of the grid that are not in yet; rows that are in keep what became of them."""
        rows = [(r.key, r.place, r.scenario, r.label, json.dumps(r.factors), json.dumps(r.given)) for r in runs]
        with _told(self.folder), self._transaction():
            self._connection.executemany(
                "INSERT INTO runs (key, place, scenario, label, factors, given) VALUES (?, ?, ?, ?, ?, ?) "
                "ON CONFLICT (key) DO UPDATE SET place = excluded.place, scenario = excluded.scenario",
                rows,
            )

    def write(self, outcome: Outcome, attempts: int) -> None:
        """Enter what became of a run."""
        assert outcome.state in (DONE, FAILED)
        metrics = None if outcome.metrics is None else json.dumps(outcome.metrics)
        with _told(self.folder), self._transaction():
            self._connection.execute(
                "UPDATE runs SET state = ?, ended = ?, reason = ?, error = ?, metrics = ?, wall = ?, simulation = ?, "
                "finished = ?, attempts = attempts + ? WHERE key = ?",
                (outcome.state, outcome.ended, outcome.reason, outcome.error, metrics, outcome.wall,
                 outcome.simulation, time.time(), attempts, outcome.key),
            )  # fmt: skip

    def keep(self, key: str, recording: str) -> None:
        """Enter where the recording of a run lies."""
        with _told(self.folder), self._transaction():
            self._connection.execute("UPDATE runs SET recording = ? WHERE key = ?", (recording, key))

    def forget_failed(self) -> None:
        """Make failed runs missing again."""
        with _told(self.folder), self._transaction():
            self._connection.execute(f"UPDATE runs SET {_BLANK} WHERE state = ?", (FAILED,))

    def keys(self, missing: bool = False) -> set[str]:
        """Keys of all runs, or of those that are missing."""
        with _told(self.folder):
            where = " WHERE state IS NULL" if missing else ""
            return {key for (key,) in self._connection.execute(f"SELECT key FROM runs{where}")}

    def counts(self) -> Counts:
        """How many runs there are, by state."""
        with _told(self.folder):
            query = "SELECT count(*), sum(state = 'done'), sum(state = 'failed') FROM runs"
            total, done, failed = self._connection.execute(query).fetchone()
            return Counts(total, done or 0, failed or 0)

    def finished_since(self, moment: float) -> int:
        """Runs that ended after `moment` [s since 1970]."""
        with _told(self.folder):
            query = "SELECT count(*) FROM runs WHERE finished >= ?"
            return self._connection.execute(query, (moment,)).fetchone()[0]

    def errors(self) -> list[tuple[str, int]]:
        """Each error with how often it happened, most frequent first."""
        with _told(self.folder):
            query = "SELECT error, count(*) FROM runs WHERE state = 'failed' GROUP BY error ORDER BY 2 DESC, 1"
            return self._connection.execute(query).fetchall()

    def rows(self) -> Iterator[Row]:
        """Every run in the order of the grid."""
        with _told(self.folder):
            query = (
                "SELECT key, place, scenario, label, factors, given, state, ended, reason, error, metrics, wall, "
                "simulation, finished, attempts, recording FROM runs ORDER BY place, key"
            )
            for (
                key,
                place,
                scenario,
                label,
                factors,
                given,
                state,
                *texts,
                metrics,
                wall,
                simulation,
                finished,
                n,
                rrd,
            ) in self._connection.execute(query):
                run = Run(key, place, scenario, label, _read(factors), _read(given))
                ended, reason, error = (text or "" for text in texts)
                times = (value or 0.0 for value in (wall, simulation, finished))
                yield Row(run, state, ended, reason, error, _read(metrics or "{}"), *times, n, rrd or "")

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        self._connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._connection.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                self._connection.execute("ROLLBACK")
            raise


def _read(text: str) -> dict[str, Any]:
    """Lists become tuples, as scenarios have them."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in json.loads(text).items()}


def _reader(file: Path) -> sqlite3.Connection:
    """Open to look; where not even the log's index can be written, as the file stands."""
    for options in ("mode=ro", "immutable=1"):
        connection = sqlite3.connect(f"{file.resolve().as_uri()}?{options}", uri=True, timeout=30, isolation_level=None)
        try:
            connection.execute("SELECT count(*) FROM runs")
            return connection
        except sqlite3.OperationalError:
            connection.close()
            if options == "immutable=1":
                raise
    raise AssertionError


def _locked(folder: Path) -> sqlite3.Connection:
    """The coordinator's claim on the folder; the system drops it however the process ends."""
    lock = sqlite3.connect(folder / LOCK, timeout=2.0, isolation_level=None)
    try:
        lock.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        lock.close()
        if "locked" in str(error):
            raise UserError(
                f"{folder}: this study is running already; see `emran-sumo study status {folder}`."
            ) from None
        raise
    return lock


def is_running(folder: Path) -> bool:
    """Whether a coordinator holds the study in `folder`."""
    if not (folder / LOCK).is_file():
        return False
    connection = sqlite3.connect(f"{(folder / LOCK).resolve().as_uri()}?mode=ro", uri=True, timeout=0.0)
    try:
        connection.execute("SELECT count(*) FROM sqlite_master")
    except sqlite3.OperationalError as error:
        return "locked" in str(error)
    finally:
        connection.close()
    return False


def finite(value: Any) -> float:
    """A number of a row, NaN where there is none."""
    return float(value) if isinstance(value, int | float) else math.nan
