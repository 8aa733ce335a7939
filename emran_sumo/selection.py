"""Which vehicles of a simulation become egos."""

import hashlib

from emran_sumo.scenario import Scenario
from emran_sumo.world.sumo import SumoWorld

FAR_ENOUGH = 500.0  # m of route that an ego chosen by us should have
PATIENCE = 60.0  # s after which a shorter one will do
SHORT = 100.0  # m
LONGEST = 8.0  # m of a vehicle that is chosen by us: the plant is one rigid body


class Selection:
    """Chooses among vehicles as they come onto the road: by id, by type, by share, or the first that goes far."""

    def __init__(self, scenario: Scenario) -> None:
        self._egos = scenario.egos
        self._seed = scenario.seed
        self.ids = (scenario.ego,) if scenario.ego else scenario.egos.ids
        self._found_first = False
        self._groups: set[str] = set()
        self.waiting: dict[str, None] = {}  # departed, but on no lane yet; in order

    @property
    def named(self) -> bool:
        """Whether the egos are known by their ids: the run ends when all of them have ended."""
        return bool(self.ids) or not (self._egos.type or self._egos.penetration)

    @property
    def asked_for(self) -> bool:
        """Whether the user has told which: then even those that depart late are waited for."""
        return bool(self.ids or self._egos.type)

    def complete(self, taken: int) -> bool:
        """Whether no further ego can come after `taken` ones."""
        return self.named and taken >= max(len(self.ids), 1)

    def chooses(self, world: SumoWorld, name: str) -> bool:
        """Whether the vehicle is to be driven by us."""
        if self.ids:
            return name in self.ids
        kind, group = world.kind(name)
        self._groups.add(group)
        if self._egos.type:
            return kind == self._egos.type
        if group != "passenger" or world.size(name)[0] > LONGEST:
            return False
        if self._egos.penetration > 0.0:
            return _share(self._seed, name) < self._egos.penetration
        if self._found_first:
            return False
        least = FAR_ENOUGH if world.time < PATIENCE else SHORT
        self._found_first = world.route_length(name) >= least
        return self._found_first

    def words(self) -> str:
        """What is looked for, in words."""
        if self.ids:
            return "vehicle " + ", ".join(f'"{name}"' for name in self.ids)
        if self._egos.type:
            return f'a vehicle of type "{self._egos.type}"'
        return "a passenger car"

    def others(self) -> str:
        """What came in its place, as a sentence, or nothing."""
        if self.ids or not self._groups:
            return ""
        return f" Those that came were of class {', '.join(sorted(self._groups))}; --ego takes any one by its id."


def _share(seed: int, name: str) -> float:
    """Number in [0, 1) that depends on nothing but the seed and the id."""
    digest = hashlib.sha256(f"{seed} {name}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2.0**64
