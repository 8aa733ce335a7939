"""Values for the paper's own scheme: differential evolution on training cases only. Run as a module; writes TOML.

    python -m emran_sumo.paper.search lateral > lateral.toml

The cost of a run is half of (rms + 0.3 max) of the tracking error over that of the law alone, plus a charge for a
command that varies more than 1.5 times as much; a lost car costs 1000.
"""

import sys
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from emran_sumo.bench import drive_track, scores
from emran_sumo.scenario import build

SEED, GENERATIONS, POPULATION = 3, 30, 30
LOST = 1000.0
VARIATION = 1.5


class Gene(NamedTuple):
    """One dotted key below "<half>." with its range; log: searched on a logarithmic scale."""

    key: str
    low: float
    high: float
    log: bool = True


COMMON = (
    Gene("emran.eps_max", 0.5, 60.0),
    Gene("emran.eps_min", 0.1, 1.0),  # share of eps_max
    Gene("emran.overlap", 0.2, 2.0),
    Gene("emran.growth_gain", 0.0, 1.0, False),
    Gene("emran.rate_initial", 0.1, 40.0),
    Gene("emran.rate_steady", 0.05, 20.0),
    Gene("emran.shape_gain", 1e-4, 1.0),
    Gene("emran.bias_rate", 0.01, 5.0),
    Gene("emran.prune_share", 0.001, 0.2),
    Gene("emran.prune_samples", 9, 150),
)
GENES = {
    "lateral": (
        *COMMON,
        Gene("emran.error_delete", 1e-4, 0.02),
        Gene("emran.error_grow", 1e-3, 0.1),
        Gene("emran.rms_grow", 1e-4, 0.05),
        Gene("K_2", 0.0, 0.4, False),
        Gene("K_3", -1.0, 0.3, False),
    ),
    "longitudinal": (
        *COMMON,
        Gene("emran.error_delete", 1e-3, 0.3),
        Gene("emran.error_grow", 1e-2, 1.0),
        Gene("emran.rms_grow", 1e-2, 0.5),
        Gene("paper_gain", 0.0, 3.0, False),
    ),
}
DLC: dict[str, Any] = {"world": "track", "track.shape": "double_lane_change"}
CRUISE: dict[str, Any] = {"world": "track", "duration": 60.0, "track.speed": 15.0}
TRAINING: dict[str, tuple[dict[str, Any], ...]] = {
    "lateral": (
        {**DLC, "track.speed": 10.0, "duration": 14.0},
        {**DLC, "track.speed": 15.0, "duration": 9.0},
        {**DLC, "track.speed": 10.0, "duration": 14.0, "disturbance.lateral_force": 800.0},
    ),
    "longitudinal": (
        {**CRUISE, "track.speed_times": (10.0, 12.0, 25.0, 26.0), "track.speed_values": (15.0, 16.0, 16.0, 15.0)},
        {**CRUISE, "disturbance.grade_pulse": 0.0873, "disturbance.grade_return": -0.0873},
    ),
}
ERRORS = {"lateral": ("cross_track_error", "heading_error"), "longitudinal": ("speed_error",)}
EFFORT = {"lateral": "steer_variation", "longitudinal": "accel_variation"}


def given_of(half: str, genes: np.ndarray) -> dict[str, Any]:
    """Dotted keys of a point (n,) in the search space of one half of the controller."""
    found: dict[str, Any] = {"controller": "pid-stanley", f"{half}.emran.authority": 1.0, f"{half}.emran.leak": 0.0}
    for gene, value in zip(GENES[half], genes, strict=True):
        scaled = float(f"{10.0**value if gene.log else value:.4g}")
        found[f"{half}.{gene.key}"] = round(scaled) if gene.key.endswith("samples") else scaled
    key = f"{half}.emran.eps_min"
    found[key] = float(f"{found[key] * found[f'{half}.emran.eps_max']:.4g}")
    found[f"{half}.emran.error_learn"] = found[f"{half}.emran.error_delete"]
    found[f"{half}.emran.merge_distance"] = float(f"{0.3 * found[key]:.4g}")
    return found


def cost(genes: np.ndarray, half: str, alone: list[dict[str, float]]) -> float:
    """Cost of a point (n,), over the training cases; `alone`: scores of the law without network."""
    given, total = given_of(half, genes), 0.0
    for case, law in zip(TRAINING[half], alone, strict=True):
        found = scores(drive_track(build({**case, **given})))
        if not found["ended"]:
            return LOST
        for name in ERRORS[half]:
            rms, most = (found[f"{name}_{kind}"] / law[f"{name}_{kind}"] for kind in ("rms", "max"))
            total += 0.5 * (rms + 0.3 * most)
        total += 0.5 * max(found[EFFORT[half]] / law[EFFORT[half]] - VARIATION, 0.0)
    return total / len(alone)


def main(half: str) -> None:
    """Search one half of the controller and print the values."""
    law = {"controller": "pid-stanley"}
    alone = [scores(drive_track(build({**case, **law}))) for case in TRAINING[half]]
    bounds = [(np.log10(g.low), np.log10(g.high)) if g.log else (g.low, g.high) for g in GENES[half]]
    rng = np.random.default_rng(SEED)
    low, high = np.array(bounds).T
    first = low + (high - low) * rng.random((POPULATION, len(bounds)))
    found = differential_evolution(
        cost, bounds, args=(half, alone), init=first, maxiter=GENERATIONS, rng=rng, polish=False, tol=0.0
    )
    print(f"# cost {found.fun:.4f} after {found.nfev} evaluations")
    for key, value in given_of(half, found.x).items():
        print(f'"{key}" = {value!r}' if not isinstance(value, str) else f'"{key}" = "{value}"')


if __name__ == "__main__":
    main(sys.argv[1])
