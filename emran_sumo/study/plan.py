"""A study's grid: scenarios x values of dotted keys x seeds, from a TOML file, the command line or both."""

import hashlib
import itertools
import json
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from emran_sumo import shipped
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.scenario import FILE, Located, find, flat, load, parse_value, to_dict, values_in

RECORD = ("none", "all", "failed", "worst")
SEEDS = 10  # where neither file nor command line says how many
LARGEST_SEED = 2**31 - 1
MOST_SEEDS = 100_000
_KEYS = ("title", "scenario", "seeds", "record", "timeout", "set", "grid")


class Given(NamedTuple):
    """A value and where it came from, for messages."""

    value: Any
    where: str


class Plan(NamedTuple):
    """What a study varies.

    name: of its folder; scenarios: names or files; base: dotted keys of every run; axes: dotted key -> values;
    seeds: of every combination; record: which runs keep a recording; timeout: of one run [s], 0 for automatic.
    """

    name: str
    title: str
    scenarios: tuple[str, ...]
    base: dict[str, Given]
    axes: dict[str, Given]
    seeds: tuple[int, ...]
    record: str = "none"
    timeout: float = 0.0


class Run(NamedTuple):
    """One cell of the grid with one seed.

    key: digest of the resolved scenario, the run's identity; place: in the order of the grid; scenario: as given;
    label: its short name; factors: axis -> value; given: dotted keys to load it with.
    """

    key: str
    place: int
    scenario: str
    label: str
    factors: dict[str, Any]
    given: dict[str, Any]


def is_study(file: Path) -> bool:
    """Whether a TOML file declares a study rather than a scenario."""
    return file.suffix == ".toml" and file.is_file() and any(k.partition(".")[0] in _KEYS[1:] for k in values_in(file))


def read(file: Path) -> Plan:
    """Plan of a study file.

    Raises:
        UserError: one sentence with file, key, what was found and what is accepted.
    """
    content = values_in(file)
    for key in content:
        if key.partition(".")[0] not in _KEYS or ("." in key and not key.startswith(("set.", "grid."))):
            raise UserError(f'{file}: unknown key "{key}". {nearest_name(key.partition(".")[0], list(_KEYS))}')
    named = content.get("scenario", ())
    scenarios = named if isinstance(named, tuple) else (named,)
    if not scenarios or not all(isinstance(name, str) and name for name in scenarios):
        raise UserError(f'{file}: scenario: found {named or "nothing"}; accepted is a name, e.g. "highway_dlc".')
    base = {key[4:]: Given(value, f"{file}: set") for key, value in content.items() if key.startswith("set.")}
    axes = {key[5:]: Given(value, f"{file}: grid") for key, value in content.items() if key.startswith("grid.")}
    for key, (value, where) in axes.items():
        if not isinstance(value, tuple):
            raise UserError(f"{where}: {key}: found {value!r}; accepted is a list of values.")
    plan = Plan(
        file.stem if file.name != "study.toml" else file.resolve().parent.name,
        str(content.get("title", "")),
        tuple(_beside(file, name) for name in scenarios),
        base,
        axes,
        seeds(content.get("seeds", SEEDS), f"{file}: seeds"),
        content.get("record", "none"),
        content.get("timeout", 0.0),
    )
    return _checked(plan, str(file))


def of_scenario(name: str) -> Plan:
    """Plan of one scenario with its own values and SEEDS seeds; the command line adds what varies."""
    file = find(name)
    short = file.parent.resolve().name if file.name == FILE else file.stem
    return Plan(short, "", (name,), {}, {}, tuple(range(1, SEEDS + 1)))


def _beside(file: Path, name: str) -> str:
    """A scenario as a study file names it: shipped, beside the file, or as seen from here."""
    beside = file.parent / name
    return str(beside) if name not in shipped.scenarios() and beside.exists() else name


def seeds(given: object, where: str) -> tuple[int, ...]:
    """Seeds from a number (1 to n), a list, "3,7" or "11-30"."""
    found: Iterable[object] = given if isinstance(given, tuple) else ()
    if isinstance(given, str):
        first, dash, last = given.partition("-")
        if dash and first.strip().isdecimal() and last.strip().isdecimal():
            found = range(int(first), int(last) + 1)
        elif given.strip().isdecimal():
            given = int(given)
        else:
            found = tuple(int(part) if part.strip().isdecimal() else part for part in given.split(",") if part.strip())
    if isinstance(given, int) and not isinstance(given, bool):
        found = range(1, given + 1)
    if isinstance(found, range) and len(found) > MOST_SEEDS:
        raise UserError(f"{where}: found {len(found)} seeds; accepted are at most {MOST_SEEDS}.")
    unique = tuple(dict.fromkeys(found))
    if not unique or not all(isinstance(s, int) and not isinstance(s, bool) and 0 <= s <= LARGEST_SEED for s in unique):
        raise UserError(
            f"{where}: found {json.dumps(given)}; accepted is how many, from 1, or a list such as 3,7 or 11-30 of "
            f"whole numbers from 0 to {LARGEST_SEED}."
        )
    return unique  # type: ignore[return-value]


def values(text: str) -> tuple[Any, ...]:
    """Values of `1,2,3` or `a,b` as on the command line; brackets keep a list together."""
    together = parse_value(f"[{text}]")
    if isinstance(together, list):
        return tuple(tuple(value) if isinstance(value, list) else value for value in together)
    return tuple(parse_value(part.strip()) for part in text.split(",") if part.strip())


def changed(plan: Plan, base: dict[str, Given], axes: dict[str, Given], **rest: Any) -> Plan:
    """The plan with values of the command line, which win: a fixed value ends an axis, and the other way round."""
    kept = {key: value for key, value in plan.base.items() if key not in axes}
    open_ = {key: value for key, value in plan.axes.items() if key not in base}
    plan = plan._replace(base={**kept, **base}, axes={**open_, **axes})
    return _checked(plan._replace(**{key: value for key, value in rest.items() if value is not None}), "study")


def _checked(plan: Plan, where: str) -> Plan:
    for key, axis in plan.axes.items():
        if not axis.value:
            raise UserError(f"{axis.where}: {key}: found no values; accepted is at least one: the grid is empty.")
        inner = tuple(tuple(value) if isinstance(value, list) else value for value in axis.value)
        if len({repr(value) for value in inner}) < len(inner):
            raise UserError(f"{axis.where}: {key}: found a value twice in {_listed(inner)}; accepted is each once.")
        if key in plan.base:
            raise UserError(f"{axis.where}: {key}: found in set and in grid; accepted is one of both.")
    for key, given in {**plan.base, **plan.axes}.items():
        if key in ("seed", "scenario"):
            accepted = "the seeds of the study" if key == "seed" else "the scenarios of the study"
            raise UserError(f"{given.where}: {key}: found {_text(given.value)}; accepted is {accepted}, not a key.")
    if plan.record not in RECORD:
        raise UserError(f'{where}: record: found "{plan.record}"; accepted is {", ".join(RECORD)}.')
    timeout = plan.timeout
    if isinstance(timeout, bool) or not isinstance(timeout, int | float) or not 0 <= timeout < 1e9:
        raise UserError(f"{where}: timeout: found {timeout!r}; accepted is a number from 0 s, where 0 is automatic.")
    axes = {
        key: Given(tuple(tuple(v) if isinstance(v, list) else v for v in axis.value), axis.where)
        for key, axis in plan.axes.items()
    }
    return plan._replace(axes=axes)


def resolve(plan: Plan) -> tuple[list[Run], list[Located]]:
    """Every run of the grid in its order, and the scenario of each combination with its first seed.

    Raises:
        UserError: a combination is not accepted.
    """
    runs: list[Run] = []
    located: list[Located] = []
    for scenario in plan.scenarios:
        for combination in itertools.product(*(axis.value for axis in plan.axes.values())):
            given = {key: value for key, (value, _) in plan.base.items()}
            given |= dict(zip(plan.axes, combination, strict=True))
            sources = {**plan.base, **plan.axes}
            overrides = {key: (value, sources[key].where) for key, value in given.items()}
            base = load(scenario, {**overrides, "seed": (plan.seeds[0], "seeds")})
            located.append(base)
            resolved = flat(to_dict(base.values))
            factors = {key: resolved[key] for key in plan.axes}
            given |= {key: resolved[key] for key in given if key in resolved}
            for seed in plan.seeds:
                key = run_key(base._replace(values=base.values._replace(seed=seed)))
                runs.append(Run(key, len(runs), scenario, base.name, factors, {**given, "seed": seed}))
    twice = len(runs) - len({run.key for run in runs})
    if twice:
        raise UserError(
            f"study: {twice} of {len(runs)} runs are the same as another; accepted is a grid without twins."
        )
    return runs, located


def run_key(located: Located) -> str:
    """Digest of a resolved scenario."""
    text = json.dumps([located.name, to_dict(located.values)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def in_order_of_driving(runs: list[Run]) -> list[Run]:
    """Seed by seed, so that what is done at any time covers the whole grid."""
    rank = {seed: i for i, seed in enumerate(dict.fromkeys(run.given["seed"] for run in runs))}
    return sorted(runs, key=lambda run: (rank[run.given["seed"]], run.place))


def replay(run: Run) -> str:
    """The command that drives this run again, with a recording."""
    return command(run.scenario, run.given)


def command(scenario: str, given: dict[str, Any]) -> str:
    """The command that drives a scenario with dotted keys."""
    words = ["emran-sumo", "run", scenario]
    for key, value in given.items():
        words += [f"--{key}", str(value)] if key in ("controller", "seed") else ["--set", f"{key}={_text(value)}"]
    return shlex.join(words)


def run_name(run: Run) -> str:
    """A name for files of this run, of its own however long its factors are."""
    parts = [run.label, *(f"{key}={_text(value)}" for key, value in run.factors.items())]
    text = "".join(c if c.isalnum() or c in ".=-_," else "_" for c in ",".join(parts))
    return f"{text[:150]},seed={run.given['seed']}" + (f",{run.key[:8]}" if len(text) > 150 else "")


def _text(value: Any) -> str:
    """A value as `scenario.parse_value` reads it back."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return f"[{', '.join(json.dumps(v) if isinstance(v, str) else _text(v) for v in value)}]"
    if isinstance(value, str):
        return value if parse_value(value) == value else json.dumps(value)
    return repr(value)


def _listed(items: tuple[Any, ...]) -> str:
    return ", ".join(map(_text, items))
