"""What the options of the command line mean for a scenario: dotted keys, each with the place it came from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from emran_sumo.errors import UserError


def overrides(
    flags: Mapping[str, tuple[str, Any]],
    set_: list[str] | None,
    set_file: list[Path] | None,
    chosen: Mapping[str, tuple[Any, str]] | None = None,
    vehicle: str | None = None,
) -> dict[str, tuple[Any, str]]:
    """Dotted key -> (value, where it came from), the winner of each key.

    Args:
        flags: dotted key -> (flag, value), None where it was not given; they win over files.
        set_: texts KEY=VALUE; they win over flags.
        set_file: TOML files of keys; the last one wins.
        chosen: further keys, as strong as flags.
        vehicle: name or file of a vehicle, whose keys all others win over.

    Raises:
        UserError: a text is not KEY=VALUE, a file cannot be read.
    """
    from emran_sumo.scenario import parse_value, values_in
    from emran_sumo.vehicles import vehicle_overrides

    found: dict[str, tuple[Any, str]] = vehicle_overrides(vehicle) if vehicle is not None else {}
    for file in set_file or []:
        found |= {key: (value, str(file)) for key, value in values_in(file).items()}
    for key, (flag, value) in flags.items():
        if value is not None:
            found[key] = (float(value) if isinstance(value, int) and key != "seed" else value, flag)
    found |= chosen or {}
    for text in set_ or []:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise UserError(f'--set: found "{text}"; accepted is KEY=VALUE, e.g. road.friction=0.6.')
        found[key.strip()] = (parse_value(value.strip()), "--set")
    return found
