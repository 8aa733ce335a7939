"""The command line of studies: `study SCENARIO|FILE`, `study status DIR`, `study report DIR`; no logic."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer.core import TyperGroup

from emran_sumo.errors import UserError

if TYPE_CHECKING:
    from emran_sumo.study.plan import Plan


class _RunByDefault(TyperGroup):
    """`study X ...` means `study run X ...`."""

    def parse_args(self, ctx, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, "--help"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_RunByDefault,
    no_args_is_help=True,
    help="Drive a grid of runs with paired seeds, here or on a Dask cluster, and answer with figures. "
    "`study SCENARIO` and `study FILE.toml` mean `study run`.",
)


@app.command()
def run(
    study: Annotated[str, typer.Argument(help="Study file, or a scenario as `emran-sumo run` takes it.")],
    density: Annotated[str | None, typer.Option(help="Vehicles per km and lane: 5,10,20.")] = None,
    controllers: Annotated[str | None, typer.Option(help="Names: pid-stanley,coupled-emran.")] = None,
    seeds: Annotated[str | None, typer.Option(help="How many (20), or which (3,7 or 11-30).")] = None,
    grid: Annotated[
        list[str] | None, typer.Option(metavar="KEY=V1,V2", help="Values of any dotted key; repeatable.")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Any dotted key of all runs; repeatable.")
    ] = None,
    duration: Annotated[float | None, typer.Option(help="Seconds to drive after the take-over.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the study; studies/<name> without.")] = None,
    record: Annotated[str | None, typer.Option(help="Runs that keep a recording: none, all, failed or worst.")] = None,
    workers: Annotated[int, typer.Option(help="Processes; 0 for one per core.", min=0)] = 0,
    dask: Annotated[str, typer.Option(metavar="ADDRESS", help="Scheduler of a Dask cluster: tcp://host:8786.")] = "",
    timeout: Annotated[float | None, typer.Option(help="Seconds after which a run is given up; 0: automatic.")] = None,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Drive failed runs once more.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only tell runs, time and disk, from a pilot.")] = False,
) -> None:
    """Drive a study, or what is missing of it: the same command goes on where it was stopped."""
    from emran_sumo.study import plan

    file = Path(study)
    base, axes = _pairs("--set", set_), _pairs("--grid", grid)
    if duration is not None:
        base["duration"] = plan.Given(duration, "--duration")
    given = {key: plan.Given(plan.values(value.value), "--grid") for key, value in axes.items()}
    for key, text, flag in (("traffic.density", density, "--density"), ("controller", controllers, "--controllers")):
        if text is not None:
            given[key] = plan.Given(plan.values(text), flag)
    base = {key: value._replace(value=_value(value.value)) for key, value in base.items()}
    chosen = None if seeds is None else plan.seeds(seeds, "--seeds")
    begun = plan.read(file) if plan.is_study(file) else plan.of_scenario(study)
    _drive(
        plan.changed(begun, base, given, seeds=chosen, record=record, timeout=timeout),
        out, workers, dask, retry_failed, dry_run,
    )  # fmt: skip


def _pairs(flag: str, texts: list[str] | None) -> dict:
    from emran_sumo.study.plan import Given

    found = {}
    for text in texts or []:
        key, equals, value = text.partition("=")
        if not equals or not key:
            wanted = "KEY=VALUE, e.g. road.friction=0.6" if flag == "--set" else "KEY=V1,V2, e.g. road.friction=0.6,1.0"
            raise UserError(f'{flag}: found "{text}"; accepted is {wanted}.')
        found[key.strip()] = Given(value.strip(), flag)
    return found


def _value(value: object) -> object:
    from emran_sumo.scenario import parse_value

    parsed = parse_value(value) if isinstance(value, str) else value
    return tuple(parsed) if isinstance(parsed, list) else parsed


def _drive(of: "Plan", out: Path | None, workers: int, dask: str, retry_failed: bool, dry_run: bool) -> None:
    from emran_sumo.study import display, execute

    folder = out or Path("studies") / of.name
    settings = execute.Settings(workers, dask, retry_failed)
    if dry_run:
        from emran_sumo.study.sizing import estimate

        display.show_size(estimate(of, settings), of)
        return
    try:
        with display.Display() as shown:
            counts = execute.study(folder, of, settings, shown.told)
    except KeyboardInterrupt:
        print(f"emran-sumo: stopped; what is done is in {folder}, the same command goes on.", file=sys.stderr)
        raise SystemExit(130) from None
    display.show_end(folder, counts)
    if counts.done:
        report(folder)
    if counts.failed:
        raise SystemExit(1)


@app.command()
def status(folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the study.")]) -> None:
    """Show how far a study is, also while it runs in another terminal."""
    from emran_sumo.study.display import show_status

    show_status(folder)


@app.command()
def report(folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of the study.")]) -> None:
    """Write results.parquet, results.csv, report.html and figures/ from what is done so far."""
    from emran_sumo.study.report import write_report

    for file in write_report(folder):
        print(file)
