"""Events that a trace itself tells: limits hit, disturbances that begin and end."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

FREE = 0.5  # s without touching a limit before it can be hit anew
NEAR = 0.999  # of a limit counts as the limit
JUMP = 0.05  # change of friction from one row to the next that is a border between surfaces
FORCE_LEAST = 1.0  # N
STATES = ("none", "side force", "low friction", "side force on low friction")
COLUMNS = ("time", "steer", "steer_command", "accel_command", "force_external_lat", "friction")


class Limits(NamedTuple):
    """What the car and its controller cannot exceed: steering angle [rad] and rate [rad/s], acceleration and
    deceleration command [m/s2], both positive."""

    steer: float
    steer_rate: float
    accel: float
    decel: float


class Note(NamedTuple):
    """A line for the list of events: time [s], level, text."""

    time: float
    level: str
    text: str


class Watch:
    """Reads rows of one ego as they come; `index` gives the place of a trace column."""

    def __init__(self, limits: Limits | None, index: Callable[[str], int]) -> None:
        self._limits = limits
        self._columns = [index(name) for name in COLUMNS]
        self._last: np.ndarray | None = None
        self._hit: dict[str, float] = {}  # limit -> when it was last touched [s]
        self._most = 0.0  # N, the largest side force of the one that acts
        self._nominal = 1.0  # friction of the road itself

    def look(self, rows: np.ndarray) -> tuple[list[Note], list[tuple[float, str]]]:
        """What the rows (n, columns) that follow those of the last call tell: events, and states of "disturbance" with
        the time [s] from which they hold."""
        seen = rows[:, self._columns]
        if self._last is None:
            self._nominal = float(seen[0, -1])
            self._last = seen[:1] * (1.0, 1.0, 1.0, 1.0, 0.0, 1.0)  # a force that acts from the start begins there
        joined = np.concatenate((self._last, seen))
        self._last = seen[-1:]
        notes = self._forces(joined) + _frictions(joined)
        if self._limits is not None:
            notes += self._hits(joined, self._limits)
        return sorted(notes), self._states(joined)

    def _states(self, seen: np.ndarray) -> list[tuple[float, str]]:
        """Nothing before the first disturbance: most runs have none."""
        time, *_, force, friction = seen.T
        codes = (np.abs(force) > FORCE_LEAST) + 2 * (friction < self._nominal - JUMP)
        changed = np.flatnonzero(codes[1:] != codes[:-1]) + 1
        return [(float(time[k]), STATES[codes[k]]) for k in changed]

    def _hits(self, seen: np.ndarray, limits: Limits) -> list[Note]:
        time, steer, steer_command, accel_command, _, _ = seen.T
        rate = np.diff(steer) / np.maximum(np.diff(time), 1e-9)
        touching = {
            "steering angle at its limit": np.abs(steer_command[1:]) >= NEAR * limits.steer,
            "steering rate at its limit": np.abs(rate) >= NEAR * limits.steer_rate,
            "acceleration command at its limit": accel_command[1:] >= NEAR * limits.accel,
            "braking command at its limit": accel_command[1:] <= -NEAR * limits.decel,
        }
        notes = []
        for text, flags in touching.items():
            for now in time[1:][flags]:
                if now - self._hit.get(text, -np.inf) > FREE:
                    notes.append(Note(float(now), "WARN", text))
                self._hit[text] = float(now)
        return notes

    def _forces(self, seen: np.ndarray) -> list[Note]:
        time, *_, force, _ = seen.T
        acting = np.abs(force) > FORCE_LEAST
        if not acting.any():
            return []
        notes = []
        for k in range(1, len(seen)):
            if acting[k] and not acting[k - 1]:
                side = "left" if force[k] > 0.0 else "right"
                notes.append(Note(float(time[k]), "WARN", f"side force begins, to the {side}"))
                self._most = 0.0
            self._most = max(self._most, abs(force[k]))
            if acting[k - 1] and not acting[k]:
                notes.append(Note(float(time[k]), "INFO", f"side force over, {self._most / 1e3:.1f} kN at the most"))
        return notes


def _frictions(seen: np.ndarray) -> list[Note]:
    """Borders between surfaces."""
    time, *_, friction = seen.T
    notes = []
    for k in np.flatnonzero(np.abs(np.diff(friction)) > JUMP) + 1:
        level, word = ("WARN", "falls") if friction[k] < friction[k - 1] else ("INFO", "rises")
        notes.append(Note(float(time[k]), level, f"friction {word} to {friction[k]:.2f}"))
    return notes
