"""Sending a layout: in full when a recording begins, and later only what has changed of it.

Rerun's own sending makes a chunk of every property and dates each with the clock on the wall; chunks cost more than
what is in them. Here what belongs together is one chunk, without a date: a fifth smaller, and equal runs have equal
layouts.
"""

import uuid
from collections.abc import Iterator, Sequence
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings as bindings

_TIMELINE = "blueprint"  # Rerun's own: the viewer puts what its user changes after what is sent
_FIRST_ID = 1 << 64


class Arrangement:
    """The layout of one recording, which goes to all of the `streams` of Rerun's."""

    def __init__(self, streams: Sequence[rr.RecordingStream], application: str) -> None:
        # one for each: what is sent is gone from it
        self._parts = [(stream, _blank(application)) for stream in streams]
        self._sent: dict[tuple[str, bool], list[bytes]] = {}
        self._times = 0

    def send(self, layout: rrb.Blueprint) -> None:
        """Send what of the layout has not been sent yet; it has the views of the one before, if there was one."""
        _number(layout)
        gathered = _Gathered()
        layout._log_to_stream(gathered)  # pyright: ignore[reportArgumentType]
        new = {}
        for place, parts in gathered.parts.items():
            content = [_content(part) for part in parts]
            if self._sent.get(place) != content:
                self._sent[place] = content
                new[place] = parts
        for stream, blueprint in self._parts:
            blueprint.set_time(_TIMELINE, sequence=self._times)
            memory = blueprint.memory_recording()
            for (path, static), parts in new.items():
                blueprint.log(path, *parts, static=static)
            bindings.send_blueprint(memory.storage, True, True, recording=stream.to_native())
        self._times += 1


def _blank(application: str) -> rr.RecordingStream:
    native = bindings.new_blueprint(application, make_default=False, make_thread_default=False)
    blueprint = rr.RecordingStream._from_native(native)
    blueprint.set_log_time_enabled(False)
    return blueprint


class _Gathered:
    """Stands in for the stream that a layout logs itself to."""

    def __init__(self) -> None:
        self.parts: dict[tuple[str, bool], list[Any]] = {}

    def log(self, path: str, part: Any, static: bool = False) -> None:
        self.parts.setdefault((path, static), []).append(part)


def _number(layout: rrb.Blueprint) -> None:
    """Ids by place in the layout, where Rerun draws them by lot."""
    for number, part in enumerate(_parts(layout.root_container)):
        part.id = uuid.UUID(int=_FIRST_ID + number)


def _parts(part: Any) -> Iterator[Any]:
    """A container or view and everything in it that has an id."""
    yield part
    if isinstance(part, rrb.Container):
        for inner in part.contents:
            yield from _parts(inner)
        return
    for given in part.visualizer_overrides.values():
        yield from (one for one in (given if isinstance(given, list) else ()) if isinstance(one, rrb.Visualizer))


def _content(part: Any) -> bytes:
    batches = part.as_component_batches() if hasattr(part, "as_component_batches") else part
    return b"".join(
        str(batch.component_descriptor()).encode() + repr(batch.as_arrow_array().to_pylist()).encode()
        for batch in batches
    )
