"""The command line: words in, words out; no logic."""

import os
import shlex
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from emran_sumo import cli_files, cli_study, cli_vehicle
from emran_sumo.errors import Interrupted, UserError
from emran_sumo.garbage import collect_rarely

if TYPE_CHECKING:
    from emran_sumo.drive import RunResult

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Test vehicle controllers in SUMO traffic: a tire-level ego under EMRAN-aided control, recorded for Rerun.",
)

app.add_typer(cli_study.app, name="study")
app.add_typer(cli_vehicle.app, name="vehicle")
app.registered_commands += cli_files.app.registered_commands


@app.callback()
def _root() -> None:
    pass


@app.command("list")
def list_scenarios() -> None:
    """Show the scenarios and controllers that come with the package."""
    from rich.console import Console
    from rich.table import Table

    from emran_sumo.controllers import CONTROLLERS
    from emran_sumo.shipped import scenarios

    for title, rows in (
        ("scenario", scenarios().items()),
        ("controller", ((name, line) for name, (line, _) in CONTROLLERS.items())),
    ):
        table = Table(title, "what it is", box=None, title_justify="left", header_style="bold")
        for name, line in rows:
            table.add_row(name, line)
        Console().print(table, "")


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="Shipped scenario, folder with a scenario.toml, .toml or .sumocfg.")],
    controller: Annotated[
        str | None,
        typer.Option(help="One that `emran-sumo list` shows, or your own: module:factory or file.py:factory."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the traffic: the same seed gives the same run, bit for bit.")
    ] = None,
    density: Annotated[float | None, typer.Option(help="Vehicles per km and lane.")] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds to drive after the take-over.")] = None,
    vehicle: Annotated[str | None, typer.Option(help="sedan, compact, van, or a TOML file of [vehicle] keys.")] = None,
    ego: Annotated[list[str] | None, typer.Option(metavar="ID", help="Vehicle to drive; repeatable.")] = None,
    ego_type: Annotated[str | None, typer.Option(metavar="TYPE", help="Drive all vehicles of this vType.")] = None,
    penetration: Annotated[
        str | None, typer.Option(metavar="SHARE", help="Drive this share of all passenger cars, e.g. 10%.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Any dotted key, e.g. road.friction=0.6; repeatable."),
    ] = None,
    set_file: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="TOML file of keys, e.g. what `tune` wrote; --set wins; repeatable."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder that holds the runs.")] = Path("runs"),
    sumo_gui: Annotated[bool, typer.Option("--sumo-gui", help="Watch in SUMO's own window.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Open the recording in the Rerun viewer when done.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the recording in the Rerun viewer while the run goes on.")
    ] = False,
    no_record: Annotated[bool, typer.Option("--no-record", help="Write no recording.")] = False,
    baseline_native: Annotated[
        bool, typer.Option("--baseline-native", help="Also let SUMO drive the ego, and compare.")
    ] = False,
) -> None:
    """Drive one scenario: writes OUT/<scenario>/<controller>-seed<k>/ with run.rrd, trace.parquet, summary.json."""
    from emran_sumo import terminal

    flags = {
        "controller": ("--controller", controller),
        "seed": ("--seed", seed),
        "traffic.density": ("--density", density),
        "duration": ("--duration", duration),
    }
    with terminal.Display() as display:
        display.phase("load", 0.0, 0.0)
        from emran_sumo import drive
        from emran_sumo.options import overrides
        from emran_sumo.scenario import chosen_egos, load

        chosen = chosen_egos(ego, ego_type, penetration)
        located = load(scenario, overrides(flags, set_, set_file, chosen, vehicle))
        if baseline_native and located.values.world == "track":
            raise UserError("--baseline-native: the test bench has no SUMO; accepted is a scenario with traffic.")
        command = shlex.join(["emran-sumo", *sys.argv[1:]])
        shown = _live_viewer(no_record) if live else ""
        result = drive.run(
            located, out, record=not no_record, gui=sumo_gui, live=shown, command=command, progress=display.phase
        )
        compares = baseline_native and result.ended != "interrupted"
        native = drive.native(located, result, display.phase) if compares else None
    _finish(result, not no_record, view)
    if native is not None:
        terminal.show_native(result, native)


@app.command()
def tune(
    file: Annotated[str, typer.Argument(help="Tuning file, or the name of a shipped one: lateral, longitudinal.")],
    method: Annotated[str, typer.Option(help="ga (the paper's genetic algorithm) or cma (CMA-ES).")] = "ga",
    seed: Annotated[int, typer.Option(min=1, help="The same seed gives the same result.")] = 1,
    generations: Annotated[int | None, typer.Option(min=1, help="10 for ga, 20 for cma; more continue.")] = None,
    population: Annotated[int | None, typer.Option(min=4, help="Per generation: 20 for ga, 10 for cma.")] = None,
    out: Annotated[
        Path | None, typer.Option(help="Result file; runs/tuning/<file>-<method>-seed<k>.toml by default.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores by default.")] = None,
) -> None:
    """Search values for the keys of a tuning file; the same command continues a search that was interrupted."""
    from emran_sumo import terminal

    with terminal.SearchDisplay() as display:
        from emran_sumo import kernels
        from emran_sumo.search import BUDGET, METHODS
        from emran_sumo.tune import Plan, checkpoint_file
        from emran_sumo.tune import tune as search
        from emran_sumo.tuning import find_file

        if method not in METHODS:
            raise UserError(f'--method: found "{method}"; accepted is {" or ".join(METHODS)}.')
        source = find_file(file)
        usual = BUDGET[method]
        plan = Plan(method, seed, generations or usual[0], population or usual[1], workers or os.cpu_count() or 1)
        result = out or Path("runs") / "tuning" / f"{source.stem}-{method}-seed{seed}.toml"
        display.begin(plan.generations, plan.population, kernels.compiled_before())
        command = shlex.join(["emran-sumo", *sys.argv[1:]])
        try:
            tuned = search(source, result, plan, command, display.step)
        except KeyboardInterrupt:
            print(
                f"emran-sumo: interrupted; the finished generations are in {checkpoint_file(result)}, and the same "
                "command continues.",
                file=sys.stderr,
            )
            raise SystemExit(130) from None
    terminal.show_tuned(tuned)


@app.command()
def paper(
    table: Annotated[
        list[str] | None,
        typer.Argument(help="III to IX, XI, XII, add-on, blind, memory, timing; all but timing by default."),
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every cell to this file.")] = None,
    literal: Annotated[
        bool, typer.Option("--literal", help="Take the paper word for word: Table II, raw inputs, norm of the error.")
    ] = False,
    noise: Annotated[bool, typer.Option("--noise", help="With sensor noise, mean of three seeds.")] = False,
    delay: Annotated[int, typer.Option(metavar="MS", help="Delay of the commands, a multiple of 10 ms.")] = 0,
    markdown: Annotated[
        Path | None, typer.Option(help="Write the whole document, in all conditions, to this file instead.")
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Draw the paper's figures into this folder instead: PNG, SVG and an .rrd."),
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores by default.")] = None,
) -> None:
    """Recompute the tables and figures of the paper on this plant, beside the published numbers."""
    from emran_sumo.paper.command import paper as recompute

    recompute(
        table or [], json_file=json_file, markdown=markdown, literal=literal, noise=noise, delay=delay,
        figures=figures, workers=workers,
    )  # fmt: skip


def _live_viewer(no_record: bool) -> str:
    if no_record:
        raise UserError("--live: found with --no-record; accepted is --live alone, which shows what is recorded.")
    from emran_sumo.viewer import listening_viewer

    return listening_viewer()


def _finish(result: "RunResult", recorded: bool, view: bool) -> None:
    from emran_sumo import terminal

    terminal.show(result, recorded)
    if view and recorded:
        from emran_sumo.viewer import open_viewer

        open_viewer(result.folder / "run.rrd")
    if result.ended == "interrupted":
        raise SystemExit(128 + (signal.SIGTERM if "SIGTERM" in result.reason else signal.SIGINT))


def main() -> None:
    """Entry point: a user's mistake is one sentence and exit code 2."""
    signal.signal(signal.SIGTERM, _terminate)
    collect_rarely()
    try:
        code = app(standalone_mode=False)  # what typer makes of Ctrl-C depends on its version
    except UserError as error:
        print("\n".join([f"emran-sumo: {error}", *getattr(error, "__notes__", [])]), file=sys.stderr)
        raise SystemExit(2) from None
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except Exception as error:
        _click_error(error)
    except Interrupted as error:
        code = 128 + error.args[0]
    if code in (130, 143):
        print("emran-sumo: interrupted before the drive began; nothing was recorded.", file=sys.stderr)
    raise SystemExit(code)


def _terminate(number: int, _frame: object) -> NoReturn:
    """SIGTERM before a run has its own handling."""
    raise Interrupted(number)


def _click_error(error: Exception) -> NoReturn:
    """Wrong options are reported like any other mistake; everything else is a defect and keeps its traceback."""
    show = getattr(error, "format_message", None)
    if show is None:
        raise error
    if text := show().rstrip("."):  # without one the help has been shown already
        print(f"emran-sumo: {text}. Try `emran-sumo --help`.", file=sys.stderr)
    raise SystemExit(2) from None
