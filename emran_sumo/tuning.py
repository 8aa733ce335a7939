"""A tuning file: which keys may change within which bounds, on which cases, and what counts."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from emran_sumo import locate
from emran_sumo.bench import BenchRun, scores
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.loop import WIDTH, ControlParams, blank_networks
from emran_sumo.scenario import Scenario, checked, find, flat, to_dict, values_in

SCALES = ("linear", "log", "integer")
START = "start"  # reference: the start values themselves
DIGITS = 5  # significant, of a value: what is tried is what the result file says
_PARTS = ("low", "high", "scale", "start", "share_of")
_OWN = ("name", "weight", "terms", "scenario")  # keys of a case that are none of a scenario


class Gene(NamedTuple):
    """A key that may change between `low` and `high`; with `share_of`, a share of the value of that other gene."""

    key: str
    low: float
    high: float
    scale: str
    start: float
    share_of: str = ""


class Case(NamedTuple):
    """A run that counts with `weight`; given: dotted keys; terms: score name -> weight within the case."""

    name: str
    weight: float
    given: dict[str, Any]
    terms: dict[str, float]


class Tuning(NamedTuple):
    """What a tuning file says; reference: controller whose scores are the unit of every term, or "start"."""

    title: str
    reference: str
    genes: tuple[Gene, ...]
    cases: tuple[Case, ...]


def decode(genes: tuple[Gene, ...], unit: np.ndarray) -> dict[str, float | int]:
    """Values of the genes at `unit` (n,), each within 0 to 1."""
    own = {gene.key: _value(gene, float(u)) for gene, u in zip(genes, unit, strict=True)}
    return {
        gene.key: _rounded(own[gene.key] * own[gene.share_of]) if gene.share_of else own[gene.key] for gene in genes
    }


def encode(genes: tuple[Gene, ...]) -> np.ndarray:
    """Place (n,) of the start values, each within 0 to 1."""
    return np.array([_place(gene) for gene in genes])


def _value(gene: Gene, u: float) -> float | int:
    low, high = gene.low, gene.high
    if gene.scale == "integer":  # every whole number has the same share of 0 to 1
        return int(min(math.floor(low + u * (high - low + 1.0)), high))
    value = low * (high / low) ** u if gene.scale == "log" else low + u * (high - low)
    return min(max(_rounded(value), low), high)


def _place(gene: Gene) -> float:
    low, high = gene.low, gene.high
    if gene.scale == "integer":
        return (gene.start - low + 0.5) / (high - low + 1.0)
    if gene.scale == "log":
        return math.log(gene.start / low) / math.log(high / low)
    return (gene.start - low) / (high - low)


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def find_file(name: str) -> Path:
    """The tuning file itself, or the shipped one of that name.

    Raises:
        UserError: there is none.
    """
    if Path(name).is_file():
        return Path(name)
    shipped = locate.folder("scenarios") / "tuning"
    known = sorted(file.stem for file in shipped.glob("*.toml") if "." not in file.stem)
    if name in known:
        return shipped / f"{name}.toml"
    if Path(name).suffix == ".toml":
        raise UserError(f"{name}: no such tuning file.")
    raise UserError(f'Unknown tuning file "{name}". {nearest_name(name, known)}')


def read(file: Path) -> Tuning:
    """Read and check a tuning file.

    Raises:
        UserError: one sentence with file, key, what was found and what is accepted.
    """
    content = values_in(file)
    shared, genes, fitness = _part(content, "set"), _part(content, "genes"), _part(content, "fitness")
    known = ["title", "set", "fitness", "genes", "cases"]
    for name in (key.partition(".")[0] for key in content):
        if name not in known:
            raise UserError(f'{file}: unknown key "{name}". {nearest_name(name, known)}')
    base = _scenario(file, "set", shared, {})
    cases = _cases(file, content.get("cases"), shared, _terms(file, "fitness.terms", _part(fitness, "terms")))
    found = _genes(file, genes, base)
    for case in cases:
        for gene in found:
            if gene.key in case.given and gene.key not in shared:
                raise UserError(
                    f'{file}: case "{case.name}": sets {gene.key}, which is a gene; accepted is one of both.'
                )
    return Tuning(str(content.get("title", "")), _reference(file, fitness), found, cases)


def _part(content: dict[str, Any], name: str) -> dict[str, Any]:
    return {key.removeprefix(f"{name}."): value for key, value in content.items() if key.startswith(f"{name}.")}


def _scenario(file: Path, where: str, given: dict[str, Any], origin: dict[str, str]) -> Scenario:
    """The scenario of dotted keys, which must be on the test bench."""
    scenario = checked(given, {**dict.fromkeys(given, f"{file}: {where}"), **origin}, str(file))
    if where != "set" and scenario.world != "track":
        raise UserError(f'{file}: {where}: world: found "{scenario.world}"; accepted is "track", the test bench.')
    return scenario


def _reference(file: Path, fitness: dict[str, Any]) -> str:
    rest = [key for key in fitness if key != "reference" and not key.startswith("terms.")]
    if rest:
        raise UserError(f'{file}: unknown key "fitness.{rest[0]}". {nearest_name(rest[0], ["reference", "terms"])}')
    reference = fitness.get("reference", START)
    known = [START, *CONTROLLERS]
    if reference not in known:
        hint = nearest_name(str(reference), known)
        raise UserError(f"{file}: fitness.reference: found {reference!r}; accepted is {START} or a controller. {hint}")
    return reference


def _terms(file: Path, where: str, given: dict[str, Any]) -> dict[str, float]:
    """Weights of score names; empty where none is given."""
    blank = BenchRun("running", np.zeros((2, WIDTH)), blank_networks(ControlParams()))
    known = [name for name in scores(blank) if name not in ("ended", "driven")]
    for name, weight in given.items():
        if name not in known:
            raise UserError(f'{file}: {where}: unknown score "{name}". {nearest_name(name, known)}')
        _number(file, f"{where}.{name}", weight, 0.0)
    if given and not sum(given.values()):
        raise UserError(f"{file}: {where}: found only zeros; accepted is at least one weight above 0.")
    return {name: float(weight) for name, weight in given.items()}


def _number(file: Path, where: str, value: object, least: float = -math.inf) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value < math.inf:
        bound = f" from {least:g}" if least > -math.inf else ""
        raise UserError(f"{file}: {where}: found {value!r}; accepted is a number{bound}.")
    return value


def _cases(file: Path, given: object, shared: dict[str, Any], terms: dict[str, float]) -> tuple[Case, ...]:
    if not isinstance(given, tuple) or not given or not all(isinstance(table, dict) for table in given):
        raise UserError(f"{file}: cases: found {given or 'nothing'}; accepted are tables [[cases]].")
    found: list[Case] = []
    for i, table in enumerate(given):
        name = table.get("name")
        if not isinstance(name, str) or not name or name in [case.name for case in found]:
            shown = "nothing" if name is None else repr(name)
            raise UserError(f"{file}: cases: name of case {i + 1}: found {shown}; accepted is a text of its own.")
        found.append(_case(file, name, table, shared, terms))
    if not sum(case.weight for case in found):
        raise UserError(f"{file}: cases: found only weights of 0; accepted is at least one above 0.")
    return tuple(found)


def _case(file: Path, name: str, table: dict[str, Any], shared: dict[str, Any], terms: dict[str, float]) -> Case:
    where = f'case "{name}"'
    own = table.get("terms", {})
    if not isinstance(own, dict):
        raise UserError(f"{file}: {where}: terms: found {own!r}; accepted is a table of weights.")
    terms = _terms(file, f"{where}: terms", own) or terms
    if not terms:
        raise UserError(f"{file}: {where}: terms: found nothing, nor in fitness.terms; accepted is a table of weights.")
    weight = _number(file, f"{where}: weight", table.get("weight", 1.0), 0.0)
    base: dict[str, Any] = {}
    if "scenario" in table:
        if not isinstance(table["scenario"], str):
            raise UserError(f"{file}: {where}: scenario: found {table['scenario']!r}; accepted is a name.")
        base = values_in(find(table["scenario"]))
    changed = flat({key: value for key, value in table.items() if key not in _OWN})
    given = {**base, **shared, **changed}
    origin = {**dict.fromkeys(base, table.get("scenario", "")), **dict.fromkeys(shared, f"{file}: set")}
    _scenario(file, where, given, {key: text for key, text in origin.items() if key not in changed})
    return Case(name, float(weight), given, terms)


def _genes(file: Path, given: dict[str, Any], base: Scenario) -> tuple[Gene, ...]:
    tables: dict[str, dict[str, Any]] = {}
    for dotted, value in given.items():
        key, _, part = dotted.rpartition(".")
        if part not in _PARTS:
            raise UserError(f'{file}: genes.{dotted}: unknown part "{part}". {nearest_name(part, list(_PARTS))}')
        tables.setdefault(key, {})[part] = value
    if not tables:
        raise UserError(f"{file}: genes: found nothing; accepted are keys with low, high and scale.")
    current = flat(to_dict(base))
    for key, table in tables.items():
        _check_gene(file, key, table, tables)
    genes = tuple(_gene(file, key, table, tables, current) for key, table in tables.items())
    ends = {gene.key: gene for gene in genes}
    for gene in genes:
        for name in ("low", "high"):
            value = getattr(gene, name) * (getattr(ends[gene.share_of], name) if gene.share_of else 1)
            value = int(value) if gene.scale == "integer" else float(value)
            origin = {gene.key: f"{file}: genes.{gene.key}.{name}"}
            checked({"controller": base.controller, gene.key: value}, origin, str(file))
    return genes


def _check_gene(file: Path, key: str, table: dict[str, Any], tables: dict[str, dict[str, Any]]) -> None:
    """One gene on its own: bounds, scale and the gene that it is a share of."""
    where, scale = f"genes.{key}", table.get("scale", "linear")
    if scale not in SCALES:
        raise UserError(f"{file}: {where}.scale: found {scale!r}; accepted is {' or '.join(SCALES)}.")
    for part in ("low", "high"):
        value = _number(file, f"{where}.{part}", table.get(part, "nothing"))
        if scale == "log" and value <= 0.0:
            raise UserError(f"{file}: {where}.{part}: found {value:g}; accepted on a log scale is a number above 0.")
        if scale == "integer" and not isinstance(value, int):
            raise UserError(f"{file}: {where}.{part}: found {value:g}; accepted on this scale is a whole number.")
    if not table["low"] < table["high"]:
        raise UserError(f"{file}: {where}: found low {table['low']:g}, high {table['high']:g}; accepted is low < high.")
    other = table.get("share_of")
    if other is None:
        return
    if other not in tables or "share_of" in tables[other]:
        plain = [name for name, one in tables.items() if "share_of" not in one]
        hint = nearest_name(str(other), plain)
        raise UserError(
            f"{file}: {where}.share_of: found {other!r}; accepted is a gene that is no share itself. {hint}"
        )
    if scale == "integer":
        raise UserError(f'{file}: {where}: found scale "integer" with share_of; accepted is one of both.')


def _gene(
    file: Path, key: str, table: dict[str, Any], tables: dict[str, dict[str, Any]], current: dict[str, Any]
) -> Gene:
    """A checked gene; without a start in the file it starts at the value that the scenario has."""
    for name in (key, table.get("share_of", key)):
        if isinstance(current.get(name), bool | str | tuple):
            raise UserError(f"{file}: genes.{name}: found a key that is no number; accepted is one that is.")
        if name not in current:
            raise UserError(f'{file}: genes: unknown key "{name}". {nearest_name(name, list(current))}')
    other = table.get("share_of", "")
    usual = current[key]
    if other:
        whole = tables[other].get("start", current[other])
        usual = usual / whole if whole else math.nan
    start = _number(file, f"genes.{key}.start", table.get("start", usual))
    low, high = table["low"], table["high"]
    if not low <= start <= high:
        raise UserError(f"{file}: genes.{key}: found the start {start:g}; accepted is one from {low:g} to {high:g}.")
    return Gene(key, low, high, table.get("scale", "linear"), start, other)
