"""Which vehicles become egos, and when: stepping the world until the first is there, and those that come later."""

import math
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
from emran_sumo.world.session import one_line
from emran_sumo.world.sumo import SumoWorld
from emran_sumo.world.track import TrackWorld

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
                found[name] = self._take(name, fitted(vehicle, length, width), count + len(found))
        return found

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
