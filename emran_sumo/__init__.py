"""Vehicle controllers in SUMO traffic: a tire-level ego under EMRAN-aided control, recorded for Rerun.

From Python: `load` a scenario, `run` it; a controller of your own takes an Observation and gives a Command.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from emran_sumo.drive import run
    from emran_sumo.observation import BuiltIn, Command, Observation
    from emran_sumo.python import load

try:
    __version__ = version("emran-sumo")
except PackageNotFoundError:  # run from a source tree that was never installed
    __version__ = "0+unknown"

__all__ = ["BuiltIn", "Command", "Observation", "load", "run"]
_ROOMS = {"load": "python", "run": "drive"}


def __getattr__(name: str) -> Any:
    """What is imported only when it is asked for: the command line answers before SUMO and the kernels are loaded."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_ROOMS.get(name, 'observation')}"), name)
