"""What a search has done so far, kept so that the same command continues it."""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from emran_sumo.errors import UserError

# what a cost depends on; with the version of the package it decides whether a search may continue
_SOURCES = (
    "plant/*.py", "control/*.py", "world/track.py", "kernels.py", "path.py", "loop.py", "conditioning.py",
    "metrics.py", "scenario.py", "controllers.py", "bench.py", "tuning.py", "search.py",
)  # fmt: skip


class Checkpoint:
    """The finished generations of a search, a line of JSON each, below a line that says of which search.

    Raises:
        UserError: the file belongs to another search.
    """

    def __init__(self, file: Path, search_of: dict[str, Any]) -> None:
        self.file = file
        self.generations: list[dict[str, Any]] = []
        lines = file.read_bytes().splitlines(keepends=True) if file.exists() else []
        whole = [line for line in lines if line.endswith(b"\n")]  # a kill may tear the last one
        if whole:
            self._compare(whole[0], search_of)
            self.generations = [json.loads(line) for line in whole[1:]]
        file.parent.mkdir(parents=True, exist_ok=True)
        self._stream = file.open("r+b" if whole else "wb")
        self._stream.seek(sum(map(len, whole)))
        self._stream.truncate()
        if not whole:
            self._append(search_of)

    def _compare(self, line: bytes, search_of: dict[str, Any]) -> None:
        try:
            before = json.loads(line)
            differ = [key for key in search_of if before.get(key) != search_of[key]]
        except (ValueError, AttributeError):
            raise UserError(f"{self.file}: is no checkpoint of a search; remove it or name another --out.") from None
        if differ:
            key = differ[0]
            shown = f"found {before.get(key)}, now {search_of[key]}"
            words = {
                "tuning": "the tuning file has changed since",
                "sources": "the package has changed since, within the same version",
            }
            raise UserError(
                f"{self.file}: continues another search: {words.get(key, f'{key}: {shown}')}; "
                "remove it to begin anew, or name another --out."
            )

    def add(self, record: dict[str, Any]) -> None:
        """Keep a generation; it is on the disk when this returns."""
        self._append(record)
        self.generations.append(record)

    def _append(self, record: dict[str, Any]) -> None:
        self._stream.write(json.dumps(record).encode() + b"\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Close the file; it stays."""
        self._stream.close()


def checkpoint_file(out: Path) -> Path:
    """Where the checkpoint of the result `out` lies."""
    return out.with_name(f"{out.stem}.checkpoint.jsonl")


def sources() -> str:
    """Digest of the modules that a cost depends on."""
    package, digest = Path(__file__).parent, hashlib.sha256()
    for pattern in _SOURCES:
        for file in sorted(package.glob(pattern)):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
