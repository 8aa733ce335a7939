"""What a sample of runs says, and how sure it is: bootstrap bands, paired tests, rates of rare events."""

import functools
import math
import warnings
from typing import NamedTuple

import numpy as np
from scipy import stats

from emran_sumo.study.store import Row, finite
from emran_sumo.study.worker import BAD

LEVEL = 0.95
RESAMPLES = 9999
GOOD = ("finished", "arrived")


class Estimate(NamedTuple):
    """A value with its 95 % interval, from n runs; NaN where there is none."""

    n: int
    value: float
    low: float
    high: float


class Paired(NamedTuple):
    """Second minus first over n pairs: mean with its 95 % interval, relative to the mean of the first, share of pairs
    in which the second is lower, and p of Wilcoxon's signed-rank test."""

    n: int
    value: float
    low: float
    high: float
    relative: float
    lower: float
    p: float


def mean(values: np.ndarray) -> Estimate:
    """Mean of values (n,) with its bootstrap interval (bias corrected and accelerated); NaN do not count."""
    values = values[np.isfinite(values)]
    if not values.size:
        return Estimate(0, math.nan, math.nan, math.nan)
    center = float(values.mean())
    if values.size < 2:
        return Estimate(1, center, math.nan, math.nan)
    if np.ptp(values) == 0.0:
        return Estimate(values.size, center, center, center)
    low, high = _bootstrap(values.tobytes(), "BCa")
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = _bootstrap(values.tobytes(), "percentile")
    return Estimate(values.size, center, low, high)


@functools.lru_cache(10_000)  # figures, tables and text ask for the same
def _bootstrap(sample: bytes, method: str) -> tuple[float, float]:
    values = np.frombuffer(sample)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a degenerate sample is answered with NaN
        found = stats.bootstrap(
            (values,), np.mean, n_resamples=RESAMPLES, confidence_level=LEVEL, method=method, vectorized=True,
            rng=np.random.default_rng(0),
        ).confidence_interval  # fmt: skip
    return float(found.low), float(found.high)


def rate(events: float, exposure: float) -> Estimate:
    """Events per unit of exposure with the exact Poisson interval, which says something even of no event.

    Source: Garwood, "Fiducial limits for the Poisson distribution", 1936.
    """
    if exposure <= 0.0:
        return Estimate(0, math.nan, math.nan, math.nan)
    tail = 0.5 * (1.0 - LEVEL)
    low = stats.chi2.ppf(tail, 2.0 * events) / 2.0 if events else 0.0
    high = stats.chi2.ppf(1.0 - tail, 2.0 * (events + 1.0)) / 2.0
    return Estimate(int(events), events / exposure, float(low) / exposure, float(high) / exposure)


def paired(first: np.ndarray, second: np.ndarray) -> Paired:
    """Compare two controllers over the same seeds; first, second (n,), pairs with a NaN do not count."""
    both = np.isfinite(first) & np.isfinite(second)
    first, second = first[both], second[both]
    difference = second - first
    found = mean(difference)
    base = float(first.mean()) if first.size else math.nan
    relative = found.value / base if base else math.nan
    lower = float((difference < 0.0).mean()) if difference.size else math.nan
    return Paired(found.n, found.value, found.low, found.high, relative, lower, _wilcoxon(difference))


def _wilcoxon(difference: np.ndarray) -> float:
    if difference.size < 2:
        return math.nan
    if not np.any(difference):
        return 1.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ties and zeros: the test then falls back to its approximation
        return float(stats.wilcoxon(difference).pvalue)  # type: ignore[union-attr]


def holm(p: list[float]) -> list[float]:
    """p values of one family, corrected for their number (Holm 1979); NaN stay NaN."""
    order = sorted((i for i, value in enumerate(p) if math.isfinite(value)), key=lambda i: p[i])
    found, largest = list(p), 0.0
    for rank, i in enumerate(order):
        largest = max(largest, min((len(order) - rank) * p[i], 1.0))
        found[i] = largest
    return found


def worst(rows: list[Row], n: int) -> list[Row]:
    """The n worst of the driven rows: those that ended badly, then by least time to collision, then by error."""

    def badness(row: Row) -> tuple[int, float, float, int]:
        rank = BAD.index(row.ended) if row.ended in BAD else len(BAD)
        least = finite(row.metrics.get("safety.time_to_collision_min"))
        error = finite(row.metrics.get("tracking.cross_track_error_max"))
        least, error = (math.inf if math.isnan(least) else least), (0.0 if math.isnan(error) else error)
        return rank, least, -error, row.run.place

    return sorted((row for row in rows if row.metrics), key=badness)[:n]
