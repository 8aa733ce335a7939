"""Vehicle controllers in SUMO traffic: a tire-level ego under EMRAN-aided control, recorded for Rerun."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("emran-sumo")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"
