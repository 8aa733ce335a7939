"""`emran-sumo vehicle`: what a car's parameters mean, before it is driven."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="Vehicles that ship, and what follows from their parameters.")


@app.command("list")
def list_() -> None:
    """The vehicles that ship."""
    from emran_sumo.vehicles import shipped_vehicles

    for name, title in shipped_vehicles().items():
        typer.echo(f"{name:10} {title}")


@app.command()
def show(
    name: Annotated[str, typer.Argument(help="sedan, compact, van, or a TOML file of [vehicle] keys.")],
    out: Annotated[
        Path | None, typer.Option(help="Picture of the tire forces; vehicle-<name>.png here by default.")
    ] = None,
) -> None:
    """Derived figures of a vehicle, and a picture of its tire forces."""
    from emran_sumo import vehicle_figure
    from emran_sumo.vehicles import figures, load_vehicle

    file, params = load_vehicle(name)
    typer.echo(f"{file.stem}  ({file})")
    for figure in figures(params):
        typer.echo(f"  {figure.name:28} {figure.value}")
    picture = out or Path(f"vehicle-{file.stem}.png")
    vehicle_figure.draw(params, file.stem, picture)
    typer.echo(f"tire forces:  {picture}")
