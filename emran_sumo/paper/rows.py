"""Who drives: every row of the tables is one frozen set of dotted keys, used for all cases."""

import math
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from emran_sumo.controllers import CONTROLLERS
from emran_sumo.paper.cases import ACCURACY, MAIN, published
from emran_sumo.scenario import build

PERIOD = 0.01  # s, at which Table II is taken


class Row(NamedTuple):
    """name; given: dotted keys; unaided: row of the same law without network; aided: compared with the EMRAN row."""

    name: str
    given: dict[str, Any]
    unaided: str
    aided: bool = True


def tuned() -> dict[str, Any]:
    """Values of the paper's own scheme, found by paper/search.py."""
    return tomllib.loads(Path(__file__).with_name("own_signal.toml").read_text(encoding="utf-8"))


# The observer is the integrator of the learning signal alone, as fast as neurons and bias together at 10 m/s.
_OBSERVER = {
    "lateral.emran.neurons_max": 0, "lateral.emran.bias_rate": 3.652,
    "longitudinal.emran.neurons_max": 0, "longitudinal.emran.bias_rate": 11.2,
}  # fmt: skip
_AIDED = {"lateral.emran.authority": 1.0, "longitudinal.emran.authority": 1.0}
_CUT = {"lateral.conditioning": True}
_BASE = {"controller": "coupled-base"}
OWN = "paper's signal, tuned"
PLAIN = Row("pid-stanley", {"controller": "pid-stanley"}, "pid-stanley", False)
BASE_ACCURACY = "coupled-base, accuracy mode"


def rows(half: str) -> tuple[Row, ...]:
    """The rows of a table of one half of the controller: the paper's scheme and ours, then every other law."""
    return (*own_rows(half), *other_rows(half))


def own_rows(half: str) -> tuple[Row, ...]:
    """The paper's scheme and ours; on a straight road there is no path to condition."""
    own = Row(OWN, tuned(), PLAIN.name)
    if half == "longitudinal":
        return (
            PLAIN, own, Row("coupled-base", _BASE, "coupled-base"),
            Row("observer, no neurons", _OBSERVER, "coupled-base"), Row(MAIN, {}, "coupled-base"),
        )  # fmt: skip
    return (
        PLAIN,
        own,
        Row(BASE_ACCURACY, _BASE, BASE_ACCURACY),
        Row("observer, accuracy mode", _OBSERVER, BASE_ACCURACY),
        Row(ACCURACY, {}, BASE_ACCURACY),
        Row("coupled-base", {**_BASE, **_CUT}, "coupled-base"),
        Row("observer, no neurons", {**_OBSERVER, **_CUT}, "coupled-base"),
        Row(MAIN, _CUT, "coupled-base"),
    )


def other_rows(half: str) -> tuple[Row, ...]:
    """The controllers that drive this half in another way than all rows before them, under their own names."""
    seen = [getattr(build(row.given), half) for row in own_rows(half)]
    found: list[Row] = []
    for name in CONTROLLERS:
        drives = getattr(build({"controller": name}), half)
        if drives not in seen:
            seen.append(drives)
            found.append(Row(name, {"controller": name}, _alone(name, half)))
    return tuple(found)


def _alone(name: str, half: str) -> str:
    """The row of the same law without network."""
    base = "coupled-base" if half == "longitudinal" else BASE_ACCURACY
    law = name.removesuffix("-emran").removesuffix("-mran")
    return base if law == "coupled" else law


def pairs() -> tuple[Row, ...]:
    """Each law alone, followed by itself with the network: the paper's, ours, and every other law of `lateral.law`."""
    base, aided = (row for row in own_rows("lateral") if row.name in (BASE_ACCURACY, ACCURACY))
    found = [PLAIN, Row(OWN, tuned(), PLAIN.name), base, aided]
    for row in other_rows("lateral"):
        if row.unaided == row.name:
            found += [row, Row(f"{row.name} + EMRAN", {**row.given, **_AIDED}, row.name)]
    return tuple(found)


def literal_rows() -> tuple[Row, ...]:
    """The text of the paper word for word, once with the norm of the error (Eq. 15) and once with its sign."""
    word = _literal()
    norm = {f"{half}.emran.unsigned": True for half in ("lateral", "longitudinal")}
    return (
        PLAIN,
        Row("Table II, norm of the error", {**word, **norm}, PLAIN.name),
        Row("Table II, signed error", word, PLAIN.name),
    )


def _literal() -> dict[str, Any]:
    """Table II at 100 Hz on the raw inputs. What the paper leaves open: K = 0 (K_1 = 1), no merging, no bias."""
    given: dict[str, Any] = {"controller": "pid-stanley", "longitudinal.paper_gain": 1.0}
    for half, bound in (("longitudinal", 9.0), ("lateral", 0.61)):  # the limits of the actuators bound the output
        t = published()["table_II"][half]
        values = {
            "authority": 1.0, "eps_max": t["eps_max"], "eps_min": t["eps_min"], "gamma": t["gamma"],
            "error_delete": 0.0, "error_learn": 0.0, "error_grow": math.sqrt(t["eps_2"]), "rms_grow": t["eps_3"],
            "window": t["S_w"], "overlap": t["kappa"], "growth_gain": 1.0, "shape_gain": 1.0,
            "rate_initial": _first_rate(t["P_0"] / t["r"]), "rate_steady": _steady_rate(t["q"] / t["r"]),
            "prune_share": t["delta"], "prune_samples": t["N_w"], "bias_rate": 0.0, "leak": 0.0,
            "merge_distance": 0.0, "output_max": bound, "width_max": 100.0, "center_step": 10.0,
        }  # fmt: skip
        given |= {f"{half}.emran.{key}": value for key, value in values.items()}
    return given


def _first_rate(variance: float) -> float:
    """Rate [1/s] whose initial variance is P_0 / R: x / (1 - x) = P_0 / R with x = rate * period."""
    return variance / (1.0 + variance) / PERIOD


def _steady_rate(drift: float) -> float:
    """Rate [1/s] whose drift is q / R: x^2 / (1 - x) = q / R with x = rate * period."""
    return 0.5 * (math.sqrt(drift * drift + 4.0 * drift) - drift) / PERIOD
