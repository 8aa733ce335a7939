"""Opening the world of a scenario: its files checked first, then SUMO, a user's configuration, or the test bench."""

import gzip
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

from emran_sumo import locate
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.manifest import STARTING
from emran_sumo.scenario import Located, Scenario
from emran_sumo.world.config import read_config
from emran_sumo.world.demand import write_demand
from emran_sumo.world.network import main_limit
from emran_sumo.world.outputs import redirected
from emran_sumo.world.routes import check_ego, departures
from emran_sumo.world.session import scenario_options
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.track import TrackWorld

World = SumoWorld | TrackWorld


def opening(located: Located) -> Callable[[Path, bool], World]:
    """Check the files of a scenario now; returns how to open its world in the run's folder."""
    scenario = located.values
    rates = scenario.rates
    if scenario.world == "track":
        preview = scenario.longitudinal.preview
        return lambda _folder, _gui: TrackWorld(
            scenario.track, scenario.duration, rates.sumo_step, rates.control_step, preview
        )
    if scenario.config:
        config = read_config(located.folder / scenario.config)

        def open_config(folder: Path, gui: bool) -> SumoWorld:
            options = {"default.action-step-length": f"{rates.driver_step:g}"} | redirected(config, folder)
            world = SumoWorld(options, rates.sumo_step, scenario.seed, scenario.road.speed_limit, gui)
            world.end = config.end
            own = config.step if config.step is not None else 1.0
            if not math.isclose(own, rates.sumo_step):
                world.notes += (f"SUMO steps of {rates.sumo_step:g} s in place of the configuration's {own:g} s",)
            world.notes += config.notes
            return world

        return open_config
    network, routes = _files(located)
    for name in (scenario.ego,) if scenario.ego else scenario.egos.ids:
        check_ego(name, routes)
    additional = [located.folder / name for name in scenario.additional]

    def open_scenario(folder: Path, gui: bool) -> SumoWorld:
        traffic = folder / STARTING
        _write_traffic(traffic, network, routes, scenario)
        options = scenario_options(network, [*routes, traffic], additional, rates.driver_step)
        return SumoWorld(options, rates.sumo_step, scenario.seed, scenario.road.speed_limit, gui)

    return open_scenario


def _files(located: Located) -> tuple[Path, list[Path]]:
    """Network and route files: beside the scenario, or a shipped network by its name."""
    s = located.values
    network = located.folder / s.network
    if not network.suffix and not network.is_file():
        network = locate.folder("networks") / s.network / f"{s.network}.net.xml"
    if not network.is_file():
        hint = nearest_name(s.network, [folder.name for folder in locate.folder("networks").iterdir()])
        raise UserError(f'network: found "{s.network}"; no such network file: {network}. {hint}')
    return network, [located.folder / name for name in s.routes]


def _write_traffic(file: Path, network: Path, routes: list[Path], scenario: Scenario) -> None:
    try:
        limit = scenario.road.speed_limit or main_limit(network)
        named = [scenario.ego] if scenario.ego else list(scenario.egos.ids)
        egos = departures(routes, named, limit) if scenario.traffic.density > 0.0 else ()
        write_demand(file, network, routes, scenario.traffic, limit, scenario.seed, egos)
    except (ET.ParseError, gzip.BadGzipFile, EOFError) as error:
        raise UserError(f"{network}: not a network file: {error}.") from None
    except ValueError as error:
        raise UserError(f"{', '.join(map(str, routes))}: {error}.") from None
