"""Whom SUMO's driver lets pass first at a junction, the ego lets pass first."""

import json
import math
from pathlib import Path

import pytest

from emran_sumo import drive, scenario
from emran_sumo.world import braking

ROUNDABOUT = Path(__file__).parent / "data" / "roundabout.net.xml"  # one lane, 8 m/s, entries that give way
EQUALS = Path(__file__).parent / "data" / "equal.net.xml"  # four ways, right before left, 13.9 m/s
# one car each 1.5 s from its entry to its exit; on the way it passes the parts of the circle between
ROUTES = """
in2 c1 c0 out0|in1 c0 out0|in3 c2 c1 c0 c3 out3|in2 c1 out1|in3 c2 out2|in3 c2 c1 c0 c3 out3|in2 c1 out1|in2 c1 out1
in0 c3 c2 c1 out1|in3 c2 c1 c0 out0|in0 c3 c2 out2|in1 c0 c3 c2 out2|in1 c0 c3 c2 c1 out1|in3 c2 c1 c0 out0
in1 c0 out0|in2 c1 out1|in1 c0 c3 c2 out2
"""


def roundabout(folder: Path) -> Path:
    """A configuration with the cars 0, 1, ... on a roundabout."""
    kind = '<vType id="k" sigma="0"/>'
    cars = [
        f'<vehicle id="{k}" type="k" depart="{1.5 * k}"><route edges="{edges}"/></vehicle>'
        for k, edges in enumerate(ROUTES.replace("\n", "|").strip("|").split("|"))
    ]
    (folder / "cars.rou.xml").write_text(f"<routes>{kind}{''.join(cars)}</routes>", encoding="utf-8")
    inputs = f'<net-file value="{ROUNDABOUT}"/><route-files value="cars.rou.xml"/>'
    file = folder / "my.sumocfg"
    file.write_text(f"<configuration><input>{inputs}</input></configuration>", encoding="utf-8")
    return file


@pytest.mark.parametrize("ego", ["6", "11"])
def test_the_ego_takes_no_gap_that_sumos_driver_does_not(tmp_path, ego):
    """SUMO refuses the way at the very last moment; a car that goes on there is some 5 s the faster one."""
    file = roundabout(tmp_path)
    located = scenario.load(str(file), {"egos.ids": ((ego,), ""), "duration": (120.0, "")})
    result = drive.run(located, tmp_path / "runs", record=False)
    own = drive.native(located, result)
    assert result.ended == own.ended == "arrived"
    assert own.time - 3.0 < result.metrics["run"]["simulated"] < own.time + 3.0


def four_at_once(folder: Path) -> Path:
    """A configuration with four cars that come to a junction of equals together, each with one from its right."""
    cars = [
        f'<trip id="{k}" type="k" depart="0" departSpeed="max" from="in{k}" to="out{(k + 2) % 4}"/>' for k in range(4)
    ]
    kind = '<vType id="k" sigma="0"/>'
    (folder / "cars.rou.xml").write_text(f"<routes>{kind}{''.join(cars)}</routes>", encoding="utf-8")
    inputs = f'<net-file value="{EQUALS}"/><route-files value="cars.rou.xml"/>'
    file = folder / "my.sumocfg"
    file.write_text(f"<configuration><input>{inputs}</input></configuration>", encoding="utf-8")
    return file


@pytest.mark.parametrize("seed", [2, 3])
def test_four_who_wait_for_each_other_get_on_about_as_soon_as_sumos_drivers(tmp_path, seed):
    """SUMO lets them go for single steps of 7 mm, at random; a car whose drive lags did not move in one."""
    chosen = {"egos.ids": (("0", "1", "2", "3"), ""), "duration": (120.0, ""), "seed": (seed, "")}
    located = scenario.load(str(four_at_once(tmp_path)), chosen)
    result = drive.run(located, tmp_path / "runs", record=False)
    own = drive.native(located, result)
    summary = json.loads(next((tmp_path / "runs").rglob("summary.json")).read_text(encoding="utf-8"))
    assert [ego["ended"] for ego in summary["egos"].values()] == ["arrived"] * 4  # none of them collided
    assert own.ended == "arrived"
    assert result.metrics["run"]["simulated"] < own.time + 30.0


def test_a_line_that_closes_late_is_braked_for_steadily(monkeypatch):
    """SUMO comes back to its speed for the room within one step, here with 26 m/s2; v^2 / (2 room) is enough."""
    step, decel, speed, left = 0.05, 4.5, 9.0, 7.0

    class Vehicle:
        """The speed u after the step h with which a driver still stops: u^2 / (2 b) + (v + u) h / 2 = gap."""

        @staticmethod
        def getStopSpeed(_ego: str, v: float, gap: float) -> float:
            bh = 0.5 * decel * step
            return math.sqrt(max(bh * bh + 2.0 * decel * (gap - 0.5 * v * step), bh * bh)) - bh

    monkeypatch.setattr(braking.libsumo, "vehicle", Vehicle)
    steady, hardest = 0.5 * speed * speed / left, 0.0
    assert (speed - Vehicle.getStopSpeed("", speed, left)) / step > 20.0
    while speed > 0.5:
        after = braking.stopping("ego", speed, left, step)
        hardest = max(hardest, (speed - after) / step)
        left -= 0.5 * (speed + after) * step
        speed = after
    assert hardest < 1.1 * steady
    assert left > 0.0


@pytest.mark.parametrize(("state", "stops"), [("Z", False), ("m", True)])
def test_nobody_stops_at_a_closed_zipper(monkeypatch, state, stops):
    """Two lanes merge there in turn; a link without priority that is closed is stopped at."""

    class Vehicle:
        """A car 20 m before a closed link, with nothing else around."""

        getLaneID = staticmethod(lambda _: "a_0")
        getLanePosition = staticmethod(lambda _: 80.0)
        getNextLinks = staticmethod(lambda _: [("b_0", False, False, True, "", state, "s", 5.0)])

    monkeypatch.setattr(braking.libsumo, "vehicle", Vehicle)
    monkeypatch.setattr(braking.libsumo.lane, "getLength", lambda _: 100.0)
    assert braking._to_closed("ego", "a_0", 10.0) == (20.0 if stops else math.inf)
    assert braking._to_wait_inside("ego", "a_0") == math.inf
