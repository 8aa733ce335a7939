import numpy as np
import pytest

from emran_sumo.errors import UserError
from emran_sumo.maneuver import DoubleLaneChange, Others, declared, gap_is_free, maneuver_path, transitions
from emran_sumo.path import lane_change_offset

LEFT = DoubleLaneChange(100.0, 25.0, 21.95, 1)
RIGHT = LEFT._replace(side=-1)
WIDTH, LENGTH = 3.5, 4.7


def free(*vehicles, change=LEFT, speed=25.0):
    """Vehicles: (bumper gap, offset, speed), gap negative behind; each 5.3 m long."""
    others = np.array(vehicles, dtype=float).reshape(-1, 3)
    center = others[:, 0] + np.sign(others[:, 0]) * 0.5 * (5.3 + LENGTH)
    same = np.ones(len(others))
    seen = Others(center, others[:, 1], others[:, 2], 5.3 * same, 1.8 * same)
    return gap_is_free(change, seen, speed, LENGTH, WIDTH)


# ---------------------------------------------------------------- declaration


def params(**values):
    return {f"double_lane_change.{key}": value for key, value in values.items()}


def test_vehicle_without_the_param_declares_nothing():
    assert declared({}, "ego") is None
    assert declared({"lcStrategic": "1"}, "ego") is None


def test_only_the_start_is_needed_and_the_lengths_are_those_of_eq_23():
    assert declared(params(start="1250"), "ego") == DoubleLaneChange(1250.0, 25.0, 21.95, 1)


def test_every_param_is_read():
    given = params(start="10.5", length_out="60", length_back="80", direction="right")
    assert declared(given, "ego") == DoubleLaneChange(10.5, 60.0, 80.0, -1)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            params(start="soon"),
            'vehicle "blue": param double_lane_change.start: found "soon"; accepted is a number above 0 m.',
        ),
        (
            params(start="5", length_out="-25"),
            'vehicle "blue": param double_lane_change.length_out: found "-25"; accepted is a number above 0 m.',
        ),
        (
            params(start="5", length_back="nan"),
            'vehicle "blue": param double_lane_change.length_back: found "nan"; accepted is a number above 0 m.',
        ),
        (
            params(start="inf"),
            'vehicle "blue": param double_lane_change.start: found "inf"; accepted is a number above 0 m.',
        ),
        (
            params(start="5", direction="up"),
            'vehicle "blue": param double_lane_change.direction: found "up"; accepted is left or right.',
        ),
    ],
)
def test_wrong_param_is_told_in_one_sentence(given, sentence):
    with pytest.raises(UserError) as error:
        declared(given, "blue")
    assert str(error.value) == sentence


# ---------------------------------------------------------------- gap: 6 m and 0.4 s of headway, after closing in


def test_empty_road_is_free():
    assert free()


@pytest.mark.parametrize(
    ("vehicle", "expected"),
    [
        ((16.1, 3.5, 25.0), True),  # 6 m + 0.4 s * 25 m/s
        ((15.9, 3.5, 25.0), False),
        ((-16.1, 3.5, 25.0), True),
        ((-15.9, 3.5, 25.0), False),
        ((36.1, 3.5, 20.0), True),  # 5 m/s slower for 4 s: 20 m more
        ((35.9, 3.5, 20.0), False),
        ((16.1, 3.5, 40.0), True),  # a faster leader opens the gap
        ((-33.1, 3.5, 30.0), True),  # 5 m/s faster for 3 s, 0.4 s * 30 m/s: 6 + 12 + 15
        ((-32.9, 3.5, 30.0), False),
        ((-14.1, 3.5, 20.0), True),  # 6 m + 0.4 s * 20 m/s
        ((16.1, 0.0, 25.0), True),
        ((15.9, 0.0, 25.0), False),  # the own lane is needed to return
        ((-1.0, 0.0, 40.0), True),  # a follower in the own lane looks ahead
        ((5.0, -3.5, 10.0), True),  # the other side does not matter
        ((-5.0, -3.5, 40.0), True),
        ((5.0, 7.0, 10.0), True),  # nor do two lanes away
        ((10.0, 1.75, 25.0), False),  # someone who is changing lanes is in both
        ((-10.0, 1.75, 25.0), False),
        ((10.0, 5.5, 25.0), False),  # and so is one who enters the lane beside from beyond
        ((10.0, 5.6, 25.0), True),
    ],
)
def test_gap_leaves_everybody_room_to_react(vehicle, expected):
    assert free(vehicle) == expected


def test_one_blocker_among_many_is_enough():
    far = [(100.0 + 30 * k, 3.5, 25.0) for k in range(5)]
    assert free(*far)
    assert not free(*far, (-10.0, 3.5, 25.0))


@pytest.mark.parametrize("vehicle", [(15.9, 3.5, 25.0), (16.1, 3.5, 25.0), (-15.9, 3.5, 25.0), (5.0, -3.5, 25.0)])
def test_change_to_the_right_is_the_mirror_image(vehicle):
    gap, offset, speed = vehicle
    assert free(vehicle) == free((gap, -offset, speed), change=RIGHT)


# ---------------------------------------------------------------- path


@pytest.mark.parametrize("change", [LEFT, RIGHT])
def test_path_goes_one_lane_aside_and_returns(bench, change):
    path = maneuver_path(bench.straight(400.0), change, 100.0, WIDTH)
    assert path.curvature[0] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(path.y[path.x < 100.0]).max() < 0.002 * WIDTH
    assert np.abs(path.y[path.x > 100.0 + change.length]).max() < 0.005 * WIDTH
    peak = path.y[np.argmax(np.abs(path.y))]
    assert np.sign(peak) == change.side
    # between the transitions tanh leaves a few centimeters: 4.05 m becomes 3.53 m + overlap in Eq. 23 as well
    assert 0.85 * WIDTH < abs(peak) <= WIDTH


def test_transitions_begin_where_those_of_eq_23_begin():
    out, back = transitions(LEFT, 1000.0, WIDTH)
    assert (out.start, out.length, out.height) == (1027.19, 25.0, 3.5)
    assert (back.start, back.length, back.height) == (1056.46, 21.95, -3.5)
    total = lane_change_offset((out, back), np.array([0.0, 2000.0]))[0]
    assert total == pytest.approx([0.0, 0.0], abs=1e-12)


def test_gentler_transitions_need_less_curvature(bench):
    gentle = LEFT._replace(length_out=30.0, length_back=40.0)
    base = bench.straight(400.0)
    sharp = np.abs(maneuver_path(base, LEFT, 100.0, WIDTH).curvature).max()
    assert np.abs(maneuver_path(base, gentle, 100.0, WIDTH).curvature).max() < sharp
