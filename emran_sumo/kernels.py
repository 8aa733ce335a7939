"""The one door to numba: compiled functions whose cache can never be stale.

numba's on-disk cache notices a change in the file of a function, but not in the other files that function calls.
All kernels therefore cache in a folder named by a digest of every kernel source, their place, numba and the CPU.
"""

import hashlib
import os
import tempfile
from pathlib import Path

import numba
from numba.core import config

_PACKAGE = Path(__file__).parent
ALL, OWN = "compiled", "compiled-own"


def _digest() -> str:
    digest = hashlib.sha256(f"{numba.__version__} {getattr(config, 'CPU_NAME', None)}".encode())
    for file in sorted(_PACKAGE.rglob("*.py")):
        source = file.read_bytes()
        if b"njit" in source or file.parent.name == "plant":  # plant/records.py holds constants of the kernels
            digest.update(file.name.encode())
            digest.update(source)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    candidates = (base / "emran_sumo", Path(tempfile.gettempdir()) / f"emran_sumo-{os.getuid()}")
    for root in candidates if hasattr(os, "getuid") else (base / "emran_sumo",):
        folder = root / _digest()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / ".writable").touch()
        except OSError:
            continue
        return folder
    return Path(tempfile.mkdtemp(prefix="emran_sumo-"))


CACHE_FOLDER = _cache_folder()
if "NUMBA_CACHE_DIR" not in os.environ:
    setattr(config, "CACHE_DIR", str(CACHE_FOLDER))  # noqa: B010

njit = numba.njit(cache=True)


def compiled_before(kind: str = ALL) -> bool:
    """Whether a complete set of kernels lies in the cache (see `mark_compiled`): ALL of a run, those for an OWN
    controller on top, or either under another law (`warm.kinds`)."""
    return (CACHE_FOLDER / kind).exists() or bool(getattr(config, "DISABLE_JIT", 0))


def mark_compiled(kind: str = ALL) -> None:
    """Remember that every kernel of this version and kind has been compiled."""
    (CACHE_FOLDER / kind).touch()
