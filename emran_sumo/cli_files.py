"""The command line of recordings: `compare`, `view`, `export`; no logic."""

import shlex
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()
RUN = "Folder of a run, a file in it, or a folder of runs, whose newest is taken."


@app.command()
def compare(
    scenario: Annotated[str, typer.Argument(help="Scenario as `emran-sumo run` takes it.")],
    controllers: Annotated[str, typer.Option(help="Names with commas: pid-stanley,coupled-emran.")],
    seed: Annotated[int | None, typer.Option(help="Of the traffic, the same for all.")] = None,
    density: Annotated[float | None, typer.Option(help="Vehicles per km and lane.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds to drive after the take-over.")] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Any dotted key of all runs; repeatable.")
    ] = None,
    set_file: Annotated[
        list[Path] | None, typer.Option(metavar="FILE", help="TOML file of keys; --set wins; repeatable.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder that holds the runs.")] = Path("runs"),
    view: Annotated[bool, typer.Option("--view", help="Open the comparison in the Rerun viewer when done.")] = False,
) -> None:
    """Drive a scenario once per controller in the same traffic: writes OUT/<scenario>/compare-seed<k>/compare.rrd."""
    from emran_sumo import terminal

    flags = {"seed": ("--seed", seed), "traffic.density": ("--density", density), "duration": ("--duration", duration)}
    with terminal.Display() as display:
        display.phase("load", 0.0, 0.0)
        from emran_sumo import compare as comparing
        from emran_sumo.options import overrides

        names = comparing.chosen(controllers)
        given = overrides(flags, set_, set_file)
        command = shlex.join(["emran-sumo", *sys.argv[1:]])
        found = comparing.compare(scenario, names, given, out, command, display.about)
    if found.interrupted:
        print("emran-sumo: interrupted; the comparison was not written, the runs so far were.", file=sys.stderr)
        reason = list(found.results.values())[-1].reason
        raise SystemExit(128 + (signal.SIGTERM if "SIGTERM" in reason else signal.SIGINT))
    terminal.show_comparison(found.file, list(found.results), comparing.rows(found.results))
    if view:
        from emran_sumo.viewer import open_viewer

        open_viewer(found.file)


@app.command()
def view(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help=f"{RUN} Or an .rrd file.")],
) -> None:
    """Open runs and comparisons in one Rerun viewer."""
    from emran_sumo import found, viewer

    viewer.open_viewer(*(found.recording(run) for run in runs), asked="view")


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help=RUN)],
    format_: Annotated[str, typer.Option("--format", help="csv, parquet, png or mp4.")],
    out: Annotated[Path | None, typer.Option(help="File to write; beside the trace without.")] = None,
) -> None:
    """Write a run as a table (csv, parquet), a sheet of figures (png) or a video (mp4)."""
    from emran_sumo import terminal

    with terminal.Display() as display:
        from emran_sumo.export.command import export as write

        file = write(run, format_, out, display.phase)
    print(file)
