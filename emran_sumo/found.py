"""Finding what earlier runs left: a run's folder, its files, or the newest run below a folder."""

from pathlib import Path

from emran_sumo.errors import UserError, nearest_name

RECORDINGS = ("run.rrd", "compare.rrd")
TRACE = "trace.parquet"
# what lies in a folder without a trace, and why
ALONE = {"run.rrd": "its run goes on or was killed", "compare.rrd": "a comparison, whose runs lie beside it"}
_DEPTH = 3  # folders below the given one in which runs are looked for: runs/<scenario>/<run>
_LISTED = 5


def recording(given: Path) -> Path:
    """The .rrd file meant by a file, a run's folder, or a folder of runs, whose newest it is.

    Raises:
        UserError: there is none; with what lies near.
    """
    if given.is_file() and given.suffix == ".rrd":
        return given
    return _newest(given, RECORDINGS, "a run's folder, an .rrd file, or a folder of runs")


def trace(given: Path) -> Path:
    """The trace meant by a run's folder, a file in it, or a folder of runs, whose newest it is.

    Raises:
        UserError: there is none; with what lies near.
    """
    folder = given.parent if given.is_file() and given.name in (*RECORDINGS, TRACE) else given
    return _newest(folder, (TRACE,), "a run's folder, or a folder of runs")


def _newest(given: Path, names: tuple[str, ...], accepted: str) -> Path:
    if not given.is_dir():
        kind = "no such run" if not given.exists() else "that is no run"
        raise UserError(f'RUN: found "{given}"; {kind}. {_near(given, names)}')
    for depth in range(_DEPTH):
        files = [file for name in names for file in given.glob("*/" * depth + name)]
        if files:
            return max(files, key=lambda file: file.stat().st_mtime)
    alone = next((f"; {name} is: {why}" for name, why in ALONE.items() if (given / name).exists()), "")
    raise UserError(f'RUN: found "{given}"; there is no {" or ".join(names)} in it{alone}; accepted is {accepted}.')


def _near(given: Path, names: tuple[str, ...]) -> str:
    """The nearest existing folder's runs, or the default folder's."""
    folder = next((parent for parent in given.parents if parent.is_dir()), Path())
    for place in (folder, Path("runs")):
        runs = {file.parent for name in names for depth in range(_DEPTH) for file in place.glob("*/" * depth + name)}
        near = sorted(map(str, runs))
        if near:
            listed = ", ".join(near[:_LISTED]) + (", ..." if len(near) > _LISTED else "")
            return nearest_name(str(given), [*near, *(str(run.parent) for run in runs)], listed)
    return "No runs lie near; `emran-sumo run` makes one."
