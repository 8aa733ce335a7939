"""Signals: before the drive they break off, during it they end the run so that everything is written."""

import contextlib
import signal
from collections.abc import Iterator
from types import FrameType

from emran_sumo.errors import Interrupted


class Stop:
    """What Ctrl-C and SIGTERM do.

    Until `driving` is set there is nothing to write, and they break off at once. Then they end the run at the next
    step; a second one breaks off.
    """

    def __init__(self) -> None:
        self.signal = 0
        self.driving = False
        self.sumo_said = ""  # when its own window ended the run
        self.failed = False  # a user's own controller, of one of the egos

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        if self.signal or not self.driving:
            raise Interrupted(number)
        self.signal = number

    @property
    def words(self) -> str:
        """What stopped the run; "" when nothing did."""
        if self.sumo_said:
            return f"stopped with SUMO's window ({self.sumo_said.rstrip('.')})"
        if self.failed:
            return "stopped with the fault of another ego's controller"
        return f"stopped by {signal.Signals(self.signal).name}" if self.signal else ""


@contextlib.contextmanager
def stoppable() -> Iterator[Stop]:
    """Handle SIGINT and SIGTERM within the block; in the main thread, which alone may."""
    stop, saved = Stop(), {}
    for number in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(ValueError):
            saved[number] = signal.signal(number, stop)
    try:
        yield stop
    finally:
        for number, handler in saved.items():
            signal.signal(number, handler)
