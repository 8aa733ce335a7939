"""Every shipped scenario is driven: some seconds of each always, all of each, and better than unaided, when asked."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from emran_sumo import drive, locate, scenario, shipped

TRAFFIC = [name for name in shipped.scenarios() if scenario.load(name).values.world == "sumo"]
DISTURBED = {"wet_curves", "bridge_gust"}  # friction patches, side gusts


def driven(name: str, folder, **given) -> drive.RunResult:
    values = {key: (value, "test") for key, value in given.items()}
    return drive.run(scenario.load(name, values), folder, record=False)


@pytest.mark.parametrize("name", TRAFFIC)
def test_its_first_seconds_are_driven_without_harm(name, tmp_path):
    result = driven(name, tmp_path, duration=4.0)
    assert result.ended == "finished", result.reason
    assert result.metrics["run"]["simulated"] == pytest.approx(4.0)
    assert result.metrics["run"]["mirror_error_max"] < 1e-6
    assert result.metrics["safety"]["collisions"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAFFIC)
def test_all_of_it_is_driven_and_better_than_by_the_unaided_controller(name, tmp_path):
    ours = driven(name, tmp_path / "ours")
    assert ours.ended in ("finished", "arrived"), ours.reason
    unaided = driven(name, tmp_path / "unaided", controller="pid-stanley")
    factor = 2.0 if name in DISTURBED else 1.0
    for key in ("cross_track_error_rms", "speed_error_rms"):
        assert factor * ours.metrics["tracking"][key] < unaided.metrics["tracking"][key], key


@pytest.mark.parametrize(
    ("seed", "ego", "duration", "where"),
    [
        (2, "first.239", 5.0, "it is taken over within a right turn, beside a queue"),
        (7, "first.286", 48.0, "it turns left behind somebody who crosses when the link is open again"),
    ],
)
def test_an_ego_of_the_town_turns_without_harm(seed, ego, duration, where, tmp_path):
    only = {"ego": "", "egos.ids": (ego,), "egos.penetration": 0.0}
    result = driven("town", tmp_path, seed=seed, duration=duration, **only)
    assert result.ended == "finished", f"{where}: {result.reason}"


def test_the_hills_are_driven_with_the_grades_that_the_network_has(tmp_path):
    """The heights of the lanes as the file gives them, where they run on for 40 m before and behind."""
    result = driven("highway_cruise", tmp_path, duration=30.0)
    net = ET.parse(locate.folder("networks") / "hills" / "hills.net.xml").getroot()
    lane = next(lane for lane in net.iter("lane") if lane.get("id") == "fast_1")
    line = np.array([[float(v) for v in point.split(",")] for point in lane.get("shape", "").split()])
    run = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))))
    seen = result.signals[::100]
    place = [run[np.hypot(line[:, 0] - x, line[:, 1] - y).argmin()] for x, y in zip(seen["x"], seen["y"], strict=True)]
    before, behind = (np.interp(np.add(place, d), run, line[:, 2]) for d in (-40.0, 40.0))
    inside = (np.array(place) > 40.0) & (np.array(place) < run[-1] - 40.0)
    assert np.tan(seen["grade"][inside]).max() > 0.04
    # parabolas of a radius above 5000 m: 80 m of chord and the distance to the nearest point are 0.5 % at the most
    np.testing.assert_allclose(np.tan(seen["grade"])[inside], ((behind - before) / 80.0)[inside], atol=0.005)
