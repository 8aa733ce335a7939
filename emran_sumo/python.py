"""The way in from Python: a scenario with keys, and a controller that may be an object."""

from typing import Any

from emran_sumo import scenario
from emran_sumo.scenario import Located
from emran_sumo.study.plan import command
from emran_sumo.user_code import text_of


def load(name: str, *, controller: Any = None, **keys: Any) -> Located:
    """A scenario with some of its keys changed, for `run`.

    Args:
        name: shipped scenario, folder with a scenario.toml, .toml or .sumocfg.
        controller: name of a built-in one; "module:factory" or "file.py:factory"; or a class, a function that makes
            one, or an object with reset() and step(observation).
        keys: seed=3, duration=20.0; dotted ones as **{"traffic.density": 20.0}.

    Raises:
        UserError: one sentence with key, what was found and what is accepted.
    """
    own = None if isinstance(controller, str) else controller
    given = {key: tuple(value) if isinstance(value, list) else value for key, value in keys.items()}
    if controller is not None:
        given["controller"] = controller if own is None else text_of(own)
    located = scenario.load(name, {key: (value, "load") for key, value in given.items()})
    return located._replace(controller=own, command=command(name, given))
