"""Collecting garbage in a process of ours: what its libraries hold stays until it ends, and is slow to walk."""

import atexit
import gc

OFTEN_ENOUGH = (50_000, 20, 50)  # new objects, collections of these, and of those, before the next one


def collect_rarely() -> None:
    """A tenth of a second per full collection, several in each run, and half a second when the process ends."""
    gc.set_threshold(*OFTEN_ENOUGH)
    atexit.unregister(gc.freeze)
    atexit.register(gc.freeze)
