"""Which vehicles become egos, and when: stepping the world until the first is there, and those that come later."""

import math
from pathlib import Path
from typing import NamedTuple

from emran_sumo.ego import Ego, fitted
from emran_sumo.errors import UserError
from emran_sumo.opening import World
from emran_sumo.planner import DoubleLaneChanger, LaneFollower, planner_for
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.scenario import Located
from emran_sumo.selection import LONGEST, Selection
from emran_sumo.user_code import Maker
from emran_sumo.warm import Progress
from emran_sumo.world.config import read_config
from emran_sumo.world.routes import why_missing
from emran_sumo.world.session import one_line
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.track import TrackWorld
from emran_sumo.world.wishes import decides_every

WAIT_FOR_A_CAR = 3600.0  # s in which some car of a configuration must depart, where none is asked for
WAIT_FOR_DEPARTURE = 300.0  # s after the warm-up in which the ego of a scenario must appear


class Driven(NamedTuple):
    """An ego with its planner."""

    ego: Ego
    planner: DoubleLaneChanger | LaneFollower


class Takeovers:
    """Takes vehicles over, each with memory, planner and controller of its own.

    Args:
        world: where they are; located: the scenario.
        maker: of the user's own controllers; None for a built-in one.
    """

    def __init__(self, world: World, located: Located, maker: Maker | None = None) -> None:
        self._world, self._located, self._maker = world, located, maker
        self.selection = Selection(located.values)
        self._slow_types: set[str] = set()  # of which has been told
        self._taken: set[str] = set()

    def first(self, progress: Progress) -> dict[str, Driven]:
        """Step the world until the first ego is there."""
        world, scenario, selection = self._world, self._located.values, self.selection
        if isinstance(world, TrackWorld):
            return {"ego": self._take("ego", scenario.vehicle, 0)}
        patience = WAIT_FOR_DEPARTURE if not scenario.config else math.inf if selection.asked_for else WAIT_FOR_A_CAR
        candidates, end = world.present(), min(world.time + patience, world.end)
        while True:
            egos = self._chosen(world, candidates, 0)
            if egos:
                return egos
            if world.expected() == 0 or world.time > end:
                self._explain_missing(world.time)
                said = f" SUMO said: {one_line(world.last_message)}" if world.last_message else ""
                raise UserError(
                    f"ego: {selection.words()} of {self._sources()} was not on the road when the warm-up ended or "
                    f"until {world.time:g} s; accepted is one that has departed by then and not arrived."
                    f"{selection.others()}{said}"
                )
            progress("wait", world.time, 0.0)
            world.advance()
            candidates = world.departed()

    def newcomers(self, count: int) -> dict[str, Driven]:
        """Those that have departed in this step and are to be driven; `count` egos have been before."""
        world = self._world
        if isinstance(world, TrackWorld) or self.selection.complete(count):
            return {}
        return self._chosen(world, world.departed(), count)

    def _explain_missing(self, time: float) -> None:
        """Refuse egos of a configuration for what its own files say about them, if they say anything."""
        values = self._located.values
        if not values.config:
            return
        config = read_config(self._located.folder / values.config)
        listed = (config.options.get(key, "").split(",") for key in ("route-files", "additional-files"))
        files = [Path(name) for names in listed for name in names if name]
        for ego in self.selection.ids if files else ():
            if why := why_missing(ego, files, config.begin, time):
                raise UserError(why)

    def _sources(self) -> str:
        """The files that declare the vehicles."""
        s = self._located.values
        return ", ".join(str(self._located.folder / name) for name in ((s.config,) if s.config else s.routes))

    def _chosen(self, world: SumoWorld, candidates: tuple[str, ...], count: int) -> dict[str, Driven]:
        """Take over those of the candidates that are to be driven."""
        vehicle, selection = self._located.values.vehicle, self.selection
        found: dict[str, Driven] = {}
        for name in (*candidates, *selection.waiting):
            if name in self._taken:  # SUMO tells of a departure in both halves of a split step
                continue
            if not world.lane_of(name):  # it departs from a parking area
                selection.waiting[name] = None
                continue
            selection.waiting.pop(name, None)
            if selection.chooses(world, name):
                self._taken.add(name)
                length, width, _ = world.size(name)
                if length > LONGEST:
                    told = f"{name} is {length:g} m long and driven as one rigid body, which needs wide bends"
                    world.notes = (*world.notes, told)
                self._tell_of_slower_decisions(world, name)
                found[name] = self._take(name, fitted(vehicle, length, width), count + len(found))
        return found

    def _tell_of_slower_decisions(self, world: SumoWorld, name: str) -> None:
        """An ego decides in every step, whatever its type says."""
        own, rates = decides_every(name), self._located.values.rates
        told = f"{name} decides in each step; SUMO's own driver of its type does so every {own:g} s, and drives slower"
        kind, _ = world.kind(name)
        if own > max(rates.sumo_step, rates.driver_step) + 1e-6 and kind not in self._slow_types:
            self._slow_types.add(kind)
            world.notes = (*world.notes, told)

    def _take(self, name: str, vehicle: VehicleParams, index: int) -> Driven:
        own = self._maker() if self._maker is not None else None  # before the world knows: it may fail
        world, scenario = self._world, self._located.values
        front = vehicle.front_axle + vehicle.front_overhang
        if isinstance(world, SumoWorld):
            lag = vehicle.torque_lag + scenario.rates.command_delay
            handed = world.take_over(name, front, vehicle.width, scenario.egos.lane_changes, lag)
        else:
            handed = world.take_over(name, front, vehicle.width, scenario.egos.lane_changes)
        ego = Ego(name, scenario, vehicle, handed, world.time, index, own)
        room = world.room if isinstance(world, SumoWorld) else lambda _: math.inf
        return Driven(ego, planner_for(ego, handed, room))
