"""What SUMO has written of phantoms, taken out of its files after the run."""

import contextlib
import gzip
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, cast

from emran_sumo.world.phantom import PREFIX

PACKED = b"\x1f\x8b"  # begin of a gzip file
STATE = b"<snapshot"  # a saved state refers to its vehicles from many places
NAME = PREFIX.encode()
CHUNK = 1 << 20  # bytes
# elements that are about a phantom: the attributes that say so; SUMO begins each element on a line of its own
ABOUT = re.compile(
    rb'(\s*)<([\w.:-]+)\s(?:[^>]*\s)?(?:id|vehicle|veh|vehID|vehicleID|ego|foe|collider|victim)="[^"]*'
    + re.escape(NAME)
)
# elsewhere a phantom's name, with the number that those across a loop have, stands for its ego
NAMED = re.compile(rb'="' + re.escape(NAME) + rb'([^"]*?)(?:#\d+)?"')
COLUMN = re.compile(rb'(?:^|[,;\t])"?' + re.escape(NAME))  # of a table


@contextlib.contextmanager
def real_only(folder: Path) -> Iterator[None]:
    """Take phantoms out of what SUMO writes into `folder` during the block, when the block has closed SUMO."""
    try:
        yield
    finally:
        for file in sorted(folder.iterdir()):
            if file.is_file() and _tells_of_phantoms(file):
                _rewrite(file)


def _opened(file: Path) -> BinaryIO:
    with file.open("rb") as stream:
        packed = stream.read(2) == PACKED
    return cast(BinaryIO, gzip.open(file, "rb") if packed else file.open("rb"))


def _tells_of_phantoms(file: Path) -> bool:
    """Whether it is a text of SUMO's that names a phantom; saved states are left as they are."""
    tail = b""
    with contextlib.suppress(OSError, EOFError), _opened(file) as stream:
        while chunk := stream.read(CHUNK):
            if not tail and (STATE in chunk or not (chunk.startswith(b"<") or ".csv" in file.suffixes)):
                return False
            if NAME in tail + chunk:
                return True
            tail = chunk[-len(NAME) :]
    return False


def _rewrite(file: Path) -> None:
    part = file.with_name(f".{os.getpid()}.{file.name}")
    with contextlib.suppress(OSError, EOFError):  # no room, or cut off: it stays as SUMO has left it
        with _opened(file) as stream, (gzip.open if isinstance(stream, gzip.GzipFile) else open)(part, "wb") as kept:
            kept.writelines(_rows(stream) if ".csv" in file.suffixes else elements(stream))
        os.replace(part, file)
    with contextlib.suppress(OSError):
        part.unlink(missing_ok=True)


def elements(lines: Iterable[bytes]) -> Iterator[bytes]:
    """The lines of one of SUMO's XML files without the elements that are about a phantom.

    Where another element names one, as a leader, it names the phantom's ego.
    """
    end = b""  # of the element that is left out
    for line in lines:
        if end:
            end = b"" if line.startswith(end) else end
        elif NAME not in line:
            yield line
        elif found := ABOUT.match(line):
            closing = b"</" + found[2] + b">"
            if not line.rstrip().endswith((b"/>", closing)):
                end = found[1] + closing
        else:
            yield NAMED.sub(rb'="\1"', line)


def _rows(lines: Iterable[bytes]) -> Iterator[bytes]:
    return (line for line in lines if not COLUMN.search(line))
