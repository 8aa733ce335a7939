"""Input files of SUMO, packed or not."""

import gzip
from pathlib import Path


def content(file: Path) -> bytes:
    """Bytes of a file, unpacked where its name ends in .gz.

    Raises:
        OSError, EOFError: it cannot be read or unpacked.
    """
    data = file.read_bytes()
    return gzip.decompress(data) if file.suffix == ".gz" else data
