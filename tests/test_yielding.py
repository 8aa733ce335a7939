"""Whom SUMO's driver lets pass first at a junction, the ego lets pass first."""

from pathlib import Path

import pytest

from emran_sumo import drive, scenario

ROUNDABOUT = Path(__file__).parent / "data" / "roundabout.net.xml"  # one lane, 8 m/s, entries that give way
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
