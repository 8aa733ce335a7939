"""Who becomes an ego: by id, by type, by a share that the seed draws, or the first car that goes far."""

from typing import Any, cast

import pytest

from emran_sumo.scenario import EgoParams, Scenario
from emran_sumo.selection import Selection
from emran_sumo.world.sumo import SumoWorld


class Cars:
    """A world of vehicles with a type, a class and a length of route."""

    time = 0.0

    def __init__(self, **kinds: tuple[str, str, float]) -> None:
        self._kinds = kinds

    def kind(self, name: str) -> tuple[str, str]:
        return self._kinds[name][:2]

    def size(self, name: str) -> tuple[float, float, float]:
        return (16.0 if "long" in self._kinds[name][0] else 5.0), 1.8, 1.5

    def route_length(self, name: str) -> float:
        return self._kinds[name][2]


def chosen(world: Cars, names: list[str], seed: int = 1, **egos: Any) -> list[str]:
    selection = Selection(Scenario(ego="", seed=seed, egos=EgoParams(**egos)))
    return [name for name in names if selection.chooses(cast(SumoWorld, world), name)]


CARS = Cars(
    bus=("bus", "bus", 900.0), near=("car", "passenger", 200.0), far=("car", "passenger", 800.0),
    van=("van", "delivery", 800.0), late=("car", "passenger", 900.0),
)  # fmt: skip
NAMES = ["bus", "near", "far", "van", "late"]


def test_ids_are_taken_whatever_they_are():
    assert chosen(CARS, NAMES, ids=("van", "near")) == ["near", "van"]


def test_a_type_takes_all_of_it():
    assert chosen(CARS, NAMES, type="car") == ["near", "far", "late"]


def test_without_a_choice_it_is_the_first_car_that_goes_far():
    assert chosen(CARS, NAMES) == ["far"]


def test_after_a_minute_a_shorter_way_will_do():
    patient = Cars(near=("car", "passenger", 200.0))
    assert chosen(patient, ["near"]) == []
    patient.time = 60.0
    assert chosen(patient, ["near"]) == ["near"]


def many(count: int) -> Cars:
    return Cars(**{f"c{k}": ("car", "passenger", 900.0) for k in range(count)})


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_a_share_is_drawn_by_the_seed_and_nothing_else(share):
    world, names = many(2000), [f"c{k}" for k in range(2000)]
    one = chosen(world, names, 1, penetration=share)
    assert set(one) == set(chosen(world, names[::-1], 1, penetration=share))
    assert set(one) != set(chosen(world, names, 2, penetration=share))
    # binomial: four standard deviations
    assert abs(len(one) - 2000 * share) < 4.0 * (2000 * share * (1.0 - share)) ** 0.5


def test_of_a_share_only_cars_are_taken():
    assert chosen(CARS, NAMES, penetration=1.0) == ["near", "far", "late"]


def test_what_is_too_long_for_one_rigid_body_is_taken_only_when_it_is_named():
    world = Cars(trailer=("long car", "passenger", 900.0), car=("car", "passenger", 900.0))
    assert chosen(world, ["trailer", "car"], penetration=1.0) == ["car"]
    assert chosen(world, ["trailer", "car"]) == ["car"]
    assert chosen(world, ["trailer", "car"], ids=("trailer",)) == ["trailer"]


def test_the_run_may_end_only_when_all_named_have_come():
    named = Selection(Scenario(ego="", egos=EgoParams(ids=("a", "b"))))
    assert [named.complete(k) for k in (1, 2)] == [False, True]
    assert not Selection(Scenario(ego="", egos=EgoParams(penetration=0.1))).complete(10)


def test_those_that_came_in_place_are_told():
    selection = Selection(Scenario(ego="", egos=EgoParams()))
    assert selection.others() == ""
    selection.chooses(cast(SumoWorld, CARS), "bus")
    assert "of class bus;" in selection.others()
