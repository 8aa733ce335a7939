"""The rows of a study as columns for files and figures, and the slices in which they are compared."""

import csv
import itertools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from emran_sumo.errors import UserError
from emran_sumo.study.plan import replay
from emran_sumo.study.store import Row, finite

LEAST_TTC = "safety.time_to_collision_min"
HORIZON = 10.0  # s: a run that never comes closer to a collision counts as this
GRAVITY = 9.81  # m/s2: no car brakes harder; what would be needed just before a crash has no bound


class Metric(NamedTuple):
    """A column with its words; scale from SI to the shown unit; most: values above count as this."""

    key: str
    title: str
    unit: str
    scale: float = 1.0
    most: float = float("inf")


_DEG = 180.0 / np.pi
METRICS = (
    Metric("tracking.cross_track_error_rms", "Cross-track error, RMS", "m"),
    Metric("tracking.cross_track_error_max", "Cross-track error, largest", "m"),
    Metric("tracking.heading_error_rms", "Heading error, RMS", "deg", _DEG),
    Metric("tracking.speed_error_rms", "Speed error, RMS", "m/s"),
    Metric("comfort.jerk_lat_rms", "Lateral jerk, RMS", "m/s³"),
    Metric("comfort.jerk_long_rms", "Longitudinal jerk, RMS", "m/s³"),
    Metric("effort.steer_per_km", "Steering variation", "rad/km"),
    Metric(LEAST_TTC, "Least time to collision", "s", 1.0, HORIZON),
    Metric("safety.deceleration_to_avoid_max", "Deceleration to avoid", "m/s²", 1.0, GRAVITY),
)
TRAVEL_TIME = Metric("run.travel_time_per_km", "Travel time of the ego", "s/km")


class Slice(NamedTuple):
    """Rows that share every factor but two.

    fixed: factors they share; x: the factor on the axis, "" without one, with its values xs; series: the factor that
    is compared, with its names; cells: (name, x) -> rows by seed.
    """

    fixed: dict[str, Any]
    x: str
    xs: tuple[Any, ...]
    series: str
    names: tuple[Any, ...]
    cells: dict[tuple[Any, Any], dict[int, Row]]

    def values(self, metric: Metric, name: Any, x: Any, seeds: list[int]) -> np.ndarray:
        """Values (n,) of a metric for the given seeds, NaN where there is none."""
        rows = self.cells.get((name, x), {})
        return np.array([metric_of(rows.get(seed), metric) for seed in seeds])

    def seeds(self) -> list[int]:
        """Every seed of the slice."""
        return sorted({seed for rows in self.cells.values() for seed in rows})


def metric_of(row: Row | None, metric: Metric) -> float:
    """A run's value in the shown unit; NaN where it was not driven or has none."""
    if row is None or not row.metrics:
        return float("nan")
    m = row.metrics
    if metric.key == LEAST_TTC and LEAST_TTC in m:
        never = m[LEAST_TTC] is None
        return metric.most if never else min(finite(m[LEAST_TTC]), metric.most)
    distance = finite(m.get("run.distance"))
    if metric.key == "effort.steer_per_km":
        return 1000.0 * finite(m.get("effort.steer_variation")) / distance if distance > 0.0 else float("nan")
    if metric == TRAVEL_TIME:
        return 1000.0 * finite(m.get("run.simulated")) / distance if distance > 0.0 else float("nan")
    value = metric.scale * finite(m.get(metric.key))
    return min(value, metric.most) if np.isfinite(value) else value


def slices(rows: list[Row], axes: dict[str, list[Any]], scenarios: list[str]) -> list[Slice]:
    """Cut a study into what is comparable.

    On the axis: density, or else the first factor of numbers; compared: controllers, or else the first other factor;
    everything else is held fixed within a slice.
    """
    varied = {key: tuple(dict.fromkeys(row.run.factors[key] for row in rows)) for key in axes}
    varied = {key: values for key, values in varied.items() if len(values) > 1}
    numbers = [key for key, values in varied.items() if all(_is_number(value) for value in values)]
    x = "traffic.density" if "traffic.density" in numbers else next(iter(numbers), "")
    others = [key for key in varied if key != x]
    series = "controller" if "controller" in others else next(iter(others), "")
    rest = [key for key in others if key != series]
    found = []
    labels = tuple(dict.fromkeys(row.run.label for row in rows)) or tuple(scenarios)
    for label, values in itertools.product(labels, itertools.product(*(varied[key] for key in rest))):
        fixed = dict(zip(rest, values, strict=True))
        cells: dict[tuple[Any, Any], dict[int, Row]] = {}
        for row in rows:
            factors = row.run.factors
            if row.run.label == label and all(factors[key] == value for key, value in fixed.items()):
                place = (factors.get(series, _only(row)), factors.get(x))
                cells.setdefault(place, {})[row.run.given["seed"]] = row
        names = tuple(dict.fromkeys(name for name, _ in cells))
        xs = tuple(dict.fromkeys(at for _, at in cells))
        shown = ({"scenario": label} if len(labels) > 1 else {}) | fixed
        found.append(Slice(shown, x, tuple(sorted(xs)) if x else xs, series, names, cells))
    return found


def _only(row: Row) -> str:
    """The name of the one series of a study that compares nothing."""
    return str(row.run.given.get("controller", row.run.label))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def columns(rows: list[Row]) -> dict[str, list[Any]]:
    """Column -> values: factors, how the run ended, its metrics and the command that repeats it.

    Nothing in here depends on the machine or on the time: two studies of the same plan have equal tables.
    """
    axes = list(dict.fromkeys(key for row in rows for key in row.run.factors))
    metrics = list(dict.fromkeys(name for row in rows for name in row.metrics))
    found: dict[str, list[Any]] = {"scenario": [row.run.label for row in rows]}
    for key in axes:
        found[key] = [_cell(row.run.factors.get(key)) for row in rows]
    found["seed"] = [row.run.given["seed"] for row in rows]
    for name in ("state", "ended", "reason", "error"):
        found[name] = [getattr(row, name) or "" for row in rows]
    for name in metrics:
        assert name not in found, f"{name} is a factor and a metric"
        found[name] = [row.metrics.get(name) for row in rows]
    found["command"] = [replay(row.run) for row in rows]
    return found


def _cell(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def write_tables(folder: Path, rows: list[Row]) -> list[Path]:
    """Write results.parquet and results.csv."""
    found = columns(rows)
    parquet, text = folder / "results.parquet", folder / "results.csv"
    try:
        part = parquet.with_suffix(".part")
        pq.write_table(pa.table({name: pa.array(values) for name, values in found.items()}), part)
        part.replace(parquet)
        part = text.with_suffix(".part")
        with part.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(found)
            writer.writerows(zip(*found.values(), strict=True))
        part.replace(text)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {error.strerror or error}.") from None
    return [parquet, text]
