"""The searches behind `emran-sumo tune`: a genetic algorithm and CMA-ES on the unit cube, by ask and tell."""

from collections.abc import Generator
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from emran_sumo.errors import UserError

if TYPE_CHECKING:
    from pymoo.core.algorithm import Algorithm

METHODS = ("ga", "cma")
# the numbers of the paper, section IV; 10 generations of 20 make the budget of both methods
CROSSOVER, MUTATION, SELECTION = 0.8, 0.15, 0.08
BUDGET = {"ga": (10, 20), "cma": (20, 10)}  # generations, population
SPREAD = 0.2  # first standard deviation of CMA-ES, where 1 is the whole range of a gene


def need_packages() -> None:
    """Raises UserError where pymoo or cma is missing."""
    missing = [name for name in ("pymoo", "cma") if find_spec(name) is None]
    if missing:
        names = " and ".join(missing)
        raise UserError(f'tune: the search needs {names}, not installed here: pip install "emran-sumo[tune]".')


def ranking(n: int, q: float = SELECTION) -> np.ndarray:
    """Probability (n,) of the best to the worst of n individuals to become a parent: normalized geometric ranking.

        P(rank i) = q (1 - q)^(i - 1) / (1 - (1 - q)^n)

    Source: Houck, Joines, Kay 1995 (GAOT, normGeomSelect), whose default q = 0.08 is the paper's selection number.
    """
    return q / (1.0 - (1.0 - q) ** n) * (1.0 - q) ** np.arange(n)


def search(
    method: str, start: np.ndarray, start_cost: float, seed: int, population: int
) -> Generator[np.ndarray, np.ndarray, None]:
    """Generations of points (k, n) in the unit cube; send back their costs (k,). Ends only where CMA-ES converges.

    Args:
        method: "ga" or "cma".
        start: (n,) a point to begin from: one of the first population of the GA, the first mean of CMA-ES.
        start_cost: its cost.
        seed: the same seed and costs give the same points; from 1.
        population: points per generation.
    """
    from pymoo.core.evaluator import Evaluator
    from pymoo.core.problem import Problem
    from pymoo.core.termination import NoTermination
    from pymoo.problems.static import StaticProblem

    problem = Problem(n_var=start.size, n_obj=1, xl=0.0, xu=1.0)
    algorithm = _genetic(start, seed, population) if method == "ga" else _cma(start, population)
    algorithm.setup(problem, termination=NoTermination(), seed=seed, verbose=False)
    first = method == "cma"  # whose first question is the start itself
    while algorithm.has_next():
        asked = algorithm.ask()
        if asked is None or not len(asked):
            return
        costs = np.full(1, start_cost) if first else (yield np.array(asked.get("X"), dtype=float))
        first = False
        Evaluator().eval(StaticProblem(problem, F=costs[:, None]), asked)
        algorithm.tell(infills=asked)


def _genetic(start: np.ndarray, seed: int, population: int) -> "Algorithm":
    """The GA of the paper: ranking selection, simulated binary crossover and polynomial mutation, elitist.

    Differs: the paper names no operators; those of its toolbox with counts per generation became these.
    """
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.core.selection import Selection
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM

    class Ranking(Selection):
        def _do(
            self, problem: Any, pop: Any, n_select: int, n_parents: int, *args: Any, random_state: Any = None, **kwargs
        ) -> np.ndarray:
            order = np.argsort(pop.get("F")[:, 0], kind="stable")
            return order[random_state.choice(len(order), (n_select, n_parents), p=ranking(len(order)))]

    parts: dict[str, Any] = {
        "sampling": np.vstack((start, hypercube(population - 1, start.size, seed))),
        "selection": Ranking(),
        "crossover": SBX(prob=CROSSOVER, eta=15),
        "mutation": PM(prob=MUTATION, eta=20),
    }
    return GA(pop_size=population, eliminate_duplicates=True, **parts)


def _cma(start: np.ndarray, population: int) -> "Algorithm":
    from pymoo.algorithms.soo.nonconvex.cmaes import CMAES

    return CMAES(x0=start, sigma=SPREAD, pop_size=population)


def hypercube(count: int, n: int, seed: int) -> np.ndarray:
    """Latin hypercube (count, n): each of `count` equal slices of every axis holds one point."""
    rng = np.random.default_rng([seed, 3])
    slices = rng.permuted(np.tile(np.arange(count), (n, 1)), axis=1).T
    return (slices + rng.random((count, n))) / max(count, 1)
