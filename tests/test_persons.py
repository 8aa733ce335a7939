"""Persons are bodies that an ego can touch, and neither its leaders nor its traffic."""

import libsumo
import numpy as np
import pytest
from test_any_scenario import ego, run, written

from emran_sumo.recording.playback import read_scene
from emran_sumo.world.persons import Persons

LENGTH, WIDTH = 0.215, 0.478  # m, SUMO's default


def walker(depart: float, position: float, lateral: float, inside: str = "") -> str:
    """Somebody who walks along c3.d3 from `position` [m] on, `lateral` [m] to the left of the lane's center."""
    walk = f'<walk edges="c3.d3" departPosLat="{lateral}" arrivalPos="-1"/>'
    return f'<person id="p" depart="{depart}" departPos="{position}">{inside or walk}</person>'


def test_who_steps_before_the_ego_too_late_for_any_brake_is_hit_and_named(tmp_path):
    # 2 m before its bumper at more than 10 m/s: nobody stops there
    result = run(written(tmp_path / "user", [ego("c3.d3"), walker(3.0, 60.0, 0.0)]), 20.0, "ego", record=True)
    assert result.ended == "collision"
    assert "with person p at " in result.reason
    assert result.reason.endswith("the ego ran into it")
    assert result.metrics["safety"]["collisions"] == 1
    assert result.metrics["safety"]["time_to_collision_min"] is None  # no leader
    assert result.metrics["safety"]["conflicts"] == 0


@pytest.mark.parametrize(("lateral", "ended"), [(-1.0, "collision"), (-1.3, "finished")])
def test_who_walks_beside_the_ego_is_touched_where_the_bodies_overlap_and_drawn(tmp_path, lateral, ended):
    # half the bodies' widths are 1.16 m; who departs there is abreast of the ego's doors
    result = run(written(tmp_path / "user", [ego("c3.d3"), walker(2.9, 54.0, lateral)]), 5.0, "ego", record=True)
    assert result.ended == ended, result.reason
    assert ended == "finished" or result.reason.endswith("side by side")
    boxes = np.concatenate(read_scene(result.recording).traffic)
    assert len(boxes) > 0
    np.testing.assert_allclose(boxes[:, 3:], np.tile((LENGTH, WIDTH), (len(boxes), 1)), atol=1e-4)


def test_who_rides_in_the_ego_or_waits_for_a_bus_is_no_body(tmp_path, monkeypatch):
    seen = []
    around = Persons.around

    def noted(self, *where):
        seen.append(len(libsumo.person.getIDList()))
        found = around(self, *where)
        assert found.ids == ()
        return found

    monkeypatch.setattr(Persons, "around", noted)
    rider = '<person id="r" depart="triggered"><ride from="c3.d3" to="d3.east3" lines="ego"/></person>'
    waits = walker(0.0, 60.0, 0.0, '<ride from="c3.d3" to="d3.east3" lines="bus"/>')
    car = ego("c3.d3 d3.east3")
    result = run(written(tmp_path / "user", [car, waits]), 6.0, "ego")
    assert result.ended == "finished", result.reason
    assert max(seen) == 1
    file = written(tmp_path / "user", [car + rider])
    assert run(file, 6.0, "ego").ended == "finished"
    assert max(seen) == 1


def test_without_persons_nothing_is_asked_of_sumo_but_their_number(tmp_path, monkeypatch):
    monkeypatch.setattr(Persons, "_look", lambda self: pytest.fail("looked"))
    assert run(written(tmp_path / "user", [ego("c3.d3")]), 1.0, "ego").ended == "finished"
