"""Post-encroachment time: between the leaving of a place by one body and the reaching of it by one that crosses."""

import math

import numpy as np
import pytest

from emran_sumo.encounters import SAMPLING, Encounters
from emran_sumo.metrics import Box
from emran_sumo.world.records import NOBODY, Traffic

SPEED, LENGTH, WIDTH = 10.0, 4.0, 2.0


def crossing(begin: float, yaw: float = math.pi / 2) -> float:
    """The ego passes the origin along x at t = 2 s; another comes along `yaw`, at the origin at `begin` [s]."""
    seen = Encounters()
    for t in np.arange(-3.0, 8.0, 0.05):
        ahead = SPEED * (t - begin)
        one = [np.array([v]) for v in (ahead * math.cos(yaw), ahead * math.sin(yaw), yaw, LENGTH, WIDTH, 1.5, SPEED)]
        seen.look(float(t), Box(SPEED * (t - 2.0), 0.0, 0.0, LENGTH, WIDTH), Traffic(("other",), *one))
    return seen.least


# a body leaves the square of both ways 0.3 s after its center has passed, and reaches it 0.3 s before
@pytest.mark.parametrize("later", [1.0, 1.6, 2.4, -1.0, -1.6, -2.4])
def test_it_is_the_time_between_leaving_and_reaching_whoever_is_first(later):
    assert crossing(2.0 + later) == pytest.approx(abs(later) - 0.6, abs=SAMPLING + 1e-6)


def test_whoever_comes_much_later_has_no_encounter():
    assert crossing(7.0) == math.inf


@pytest.mark.parametrize("yaw", [0.0, math.pi])
def test_following_and_oncoming_are_no_crossing(yaw):
    assert crossing(3.0, yaw) == math.inf


def test_an_empty_road_has_none():
    seen = Encounters()
    assert seen.look(0.0, Box(0.0, 0.0, 0.0, LENGTH, WIDTH), NOBODY) == seen.least == math.inf
