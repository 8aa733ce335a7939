"""Several controllers on the same scenario, traffic and seed: one merged recording and one table."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from emran_sumo import drive
from emran_sumo.controllers import CONTROLLERS, is_own, label
from emran_sumo.ego import COLUMNS
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.manifest import writable
from emran_sumo.recording.comparison import MOST, Compared, write_comparison
from emran_sumo.report import surroundings
from emran_sumo.scenario import Located, load
from emran_sumo.user_code import maker

LOWER, HIGHER, NEITHER = -1, 1, 0


class Measure(NamedTuple):
    """One row of the table: group and key of a metric, its words, unit, digits, scale, and which value is the best."""

    group: str
    key: str
    words: str
    unit: str = ""
    digits: int = 0
    scale: float = 1.0
    better: int = LOWER


MEASURES = (
    Measure("tracking", "cross_track_error_rms", "cross-track error, RMS", "m", 4),
    Measure("tracking", "cross_track_error_max", "cross-track error, max", "m", 3),
    Measure("tracking", "heading_error_rms", "heading error, RMS", "deg", 3, 180.0 / math.pi),
    Measure("tracking", "heading_error_max", "heading error, max", "deg", 2, 180.0 / math.pi),
    Measure("tracking", "speed_error_rms", "speed error, RMS", "m/s", 4),
    Measure("tracking", "speed_error_max", "speed error, max", "m/s", 3),
    Measure("safety", "collisions", "collisions of the ego"),
    Measure("safety", "conflicts", "conflicts (TTC < 3 s, DRAC > 3 m/s²)"),
    Measure("safety", "time_to_collision_min", "least time to collision", "s", 1, better=HIGHER),
    Measure("safety", "gap_min", "least gap ahead", "m", 1, better=HIGHER),
    Measure("comfort", "accel_lat_max", "lateral acceleration, max", "m/s²", 2),
    Measure("comfort", "jerk_lat_rms", "lateral jerk, RMS", "m/s³", 2),
    Measure("comfort", "jerk_long_rms", "longitudinal jerk, RMS", "m/s³", 2),
    Measure("effort", "steer_variation", "variation of the steering command", "rad", 2),
    Measure("effort", "accel_variation", "variation of the acceleration command", "m/s²", 1),
    Measure("networks", "neurons_steering_max", "neurons, steering network, most", better=NEITHER),
    Measure("networks", "neurons_speed_max", "neurons, speed network, most", better=NEITHER),
    Measure("run", "distance", "distance", "m", 1, better=NEITHER),
)


class Row(NamedTuple):
    """One line of the table: group, words with the unit, a text per controller, and the places of the best."""

    group: str
    words: str
    values: tuple[str, ...]
    best: tuple[int, ...]


class Comparison(NamedTuple):
    """What a comparison left: its recording, the runs by controller, in order, and whether it was broken off."""

    file: Path
    results: dict[str, drive.RunResult]
    interrupted: bool = False


def chosen(controllers: str) -> tuple[str, ...]:
    """The names of a list with commas.

    Raises:
        UserError: fewer than two, too many, unknown or repeated ones.
    """
    names = tuple(name.strip() for name in controllers.split(",") if name.strip())
    for i, name in enumerate(names):
        if not (name in CONTROLLERS or is_own(name)):
            raise UserError(f'--controllers: found "{name}". {nearest_name(name, list(CONTROLLERS))}')
        if label(name) in map(label, names[:i]):
            raise UserError(f'--controllers: found "{name}" twice; accepted is each controller once.')
    if not 2 <= len(names) <= MOST:
        wanted = f"two to {MOST} names with commas, e.g. pid-stanley,coupled-emran"
        raise UserError(f'--controllers: found "{controllers}"; accepted is {wanted}.')
    return names


def compare(
    scenario: str,
    controllers: tuple[str, ...],
    overrides: Mapping[str, tuple[Any, str]],
    out: Path,
    command: str = "",
    about: Callable[[str], drive.Progress] = lambda _: lambda *_: None,
) -> Comparison:
    """Drive a scenario once per controller and write OUT/<scenario>/compare-seed<k>/compare.rrd.

    Args:
        scenario: as for `scenario.load`.
        controllers: from `chosen`; the scene shows the traffic of the first.
        overrides: dotted key -> (value, where it came from), the same for all.
        out: folder that holds the runs.
        command: what the user typed.
        about: called with each controller before it drives; gives the progress of its run.

    Raises:
        UserError: a file, key or folder is not usable.
    """
    located = {
        label(name): load(scenario, {**overrides, "controller": (name, "--controllers")}) for name in controllers
    }  # all of them before the first is driven: a mistake must not cost a run
    for of in located.values():
        maker(of)
    first = located[label(controllers[0])]
    file = out / first.name / f"compare-seed{first.values.seed}" / "compare.rrd"
    with writable(file.parent):
        file.parent.mkdir(parents=True, exist_ok=True)
    results: dict[str, drive.RunResult] = {}
    for name, of in located.items():
        results[name] = drive.run(of, out, command=command, progress=about(name))
        if results[name].ended == "interrupted":
            return Comparison(file, results, interrupted=True)
    _write(file, first, results, command)
    return Comparison(file, results)


def _write(file: Path, first: Located, results: dict[str, drive.RunResult], command: str) -> None:
    summary = markdown(first, results, command)
    runs = [
        Compared(name, r.folder / "run.rrd", dict(zip(COLUMNS, r.trace.T, strict=True)), r.shape)
        for name, r in results.items()
    ]
    title = f"{first.name}, seed {first.values.seed}: {' against '.join(results)}"
    identity = f"{first.name}-compare-seed{first.values.seed}-{'-'.join(results)}"
    with writable(file.parent):
        write_comparison(file, runs, recording=identity, name=title, summary=summary)
        file.with_suffix(".md").write_text(summary, encoding="utf-8")


def rows(results: Mapping[str, drive.RunResult]) -> list[Row]:
    """The table: one row per measure, one value per controller.

    The best are marked among the runs that came to their end; where all are alike, none is.
    """
    ended = Row("", "ended", tuple(r.ended for r in results.values()), ())
    return [ended] + [_row(measure, list(results.values())) for measure in MEASURES]


def _row(measure: Measure, results: list[drive.RunResult]) -> Row:
    values = [r.metrics[measure.group][measure.key] for r in results]
    texts = tuple("none" if v is None else f"{v * measure.scale:.{measure.digits}f}" for v in values)
    words = f"{measure.words} [{measure.unit}]" if measure.unit else measure.words
    return Row(measure.group, words, texts, _best(measure, results, values, texts))


def _best(measure: Measure, results: list[drive.RunResult], values: list, texts: tuple[str, ...]) -> tuple[int, ...]:
    nobody = math.inf if measure.better == HIGHER else -math.inf  # nobody ahead is the safest
    able = {
        i: nobody if value is None else value
        for i, value in enumerate(values)
        if results[i].ended in ("finished", "arrived")
    }
    if measure.better == NEITHER or len({texts[i] for i in able}) < 2:
        return ()
    top = max(able, key=lambda i: measure.better * able[i])
    return tuple(i for i in able if texts[i] == texts[top])


def markdown(first: Located, results: Mapping[str, drive.RunResult], command: str) -> str:
    """The summary inside the recording; the best value of a row is bold."""
    s = first.values
    where = surroundings(s.world, s.traffic.density)
    names = list(results)
    title = f"{s.title}. " if s.title else ""
    told = f"{first.name}, seed {s.seed}, {where}: {len(names)} controllers; the best value of a row is bold."
    lines = [f"**{title}{told}**\n"]
    lines.append(f"| | {' | '.join(names)} |")
    lines.append("|---|" + "---:|" * len(names))
    for row in rows(results):
        cells = (f"**{text}**" if i in row.best else text for i, text in enumerate(row.values))
        lines.append(f"| {row.words} | {' | '.join(cells)} |")
    if s.world != "track":
        lines.append(
            f"\nThe traffic shown is that of {names[0]}; all runs share it until an ego acts on it differently."
        )
    lines += ["".join(f"\n{name}: {r.reason}." for name, r in results.items() if r.ended != "finished")]
    return "\n".join(lines) + f"\nRepeat: `{command}`\n"
