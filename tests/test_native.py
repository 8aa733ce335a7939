"""SUMO's own driving of a vehicle is measured like the ego's."""

from pathlib import Path

import pytest

from emran_sumo.world.native import watch
from emran_sumo.world.session import scenario_options
from emran_sumo.world.sumo import SumoWorld

LINE = Path(__file__).parent / "data" / "line.net.xml"  # 1 km at 30 m/s, then 1 km at 15 m/s
STEP = 0.05


def opened(tmp_path, inside: str, edges: str = "fast") -> SumoWorld:
    file = tmp_path / "cars.rou.xml"
    kind = '<vType id="k" sigma="0" speedFactor="1" speedDev="0" lcSpeedGain="0" lcKeepRight="0"/>'
    place = 'departLane="1" departPos="{}" departSpeed="20"'
    ego = f'<vehicle id="ego" type="k" route="all" depart="0" {place.format(100)}>{inside}</vehicle>'
    follower = f'<vehicle id="f" type="k" route="all" depart="0" {place.format(60)}/>'
    file.write_text(f'<routes>{kind}<route id="all" edges="{edges}"/>{ego}{follower}</routes>', encoding="utf-8")
    return SumoWorld(scenario_options(LINE, [file], [], 0.0), STEP, 1)


def test_it_ends_when_the_vehicle_arrives_with_the_way_it_drove(tmp_path):
    with opened(tmp_path, "") as world:
        world.advance()
        found = watch(world, "ego", 100.0)
    assert found.ended == "arrived"
    assert found.distance == pytest.approx(900.0, abs=30.0 * 2 * STEP)
    # from 20 m/s with 2.6 m/s2 to 30 m/s: 3.85 s and 96 m, then 804 m at 30 m/s
    assert found.time == pytest.approx(3.85 + 804.0 / 30.0, abs=0.3)


def test_it_ends_after_its_duration(tmp_path):
    with opened(tmp_path, "") as world:
        world.advance()
        found = watch(world, "ego", 5.0)
    assert (found.ended, found.time) == ("finished", pytest.approx(5.0))


def test_a_follower_pays_for_a_vehicle_that_stops(tmp_path):
    free, stops = (watch_wake(tmp_path, inside) for inside in ("", '<stop lane="fast_1" endPos="300" duration="10"/>'))
    assert free["follower_decel_max"] < 1.0
    assert stops["follower_decel_max"] > 1.0
    assert stops["follower_delay"] > free["follower_delay"] + 1.5
    assert stops["followers"] == 1


def watch_wake(tmp_path, inside: str) -> dict[str, float]:
    with opened(tmp_path, inside) as world:
        world.advance()
        return watch(world, "ego", 40.0).wake
