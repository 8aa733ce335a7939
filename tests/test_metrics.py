import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from emran_sumo import metrics
from emran_sumo.loop import AT, WIDTH, new_trace
from emran_sumo.metrics import NO_LEAD, Box, boxes_overlap, comfort, effort, largest, lead, networks, rms, tracking


def trace_of(**columns):
    trace = new_trace(len(next(iter(columns.values()))))
    trace[:, AT.time] = 0.01 * np.arange(1, len(trace) + 1)
    for name, values in columns.items():
        trace[:, getattr(AT, name)] = values
    return trace


# ---------------------------------------------------------------- numbers of a series


def test_rms_of_a_sine_over_whole_periods_is_its_amplitude_over_root_two():
    wave = 3.0 * np.sin(2 * np.pi * np.arange(1000) / 100)
    assert rms(wave) == pytest.approx(3.0 / math.sqrt(2))
    assert largest(-wave) == pytest.approx(3.0)


def test_nothing_has_no_rms():
    assert (rms(np.zeros(0)), largest(np.zeros(0))) == (0.0, 0.0)


def test_tracking_names_each_error_with_rms_and_largest_magnitude():
    found = tracking(trace_of(cross_track_error=[3.0, -4.0], heading_error=[0.0, 0.1], speed_error=[-2.0, -2.0]))
    assert found == pytest.approx(
        {
            "cross_track_error_rms": math.sqrt(12.5), "cross_track_error_max": 4.0,
            "heading_error_rms": 0.1 / math.sqrt(2), "heading_error_max": 0.1,
            "speed_error_rms": 2.0, "speed_error_max": 2.0,
        }
    )  # fmt: skip


def test_jerk_is_the_rate_of_the_acceleration():
    found = comfort(trace_of(accel_long=[0.0, 0.02, 0.04, 0.06], accel_lat=[1.0, 1.0, 1.0, 0.5]))
    assert found["jerk_long_rms"] == pytest.approx(2.0)
    assert found["jerk_lat_max"] == pytest.approx(50.0)
    assert found["accel_lat_max"] == 1.0
    assert set(found) == {f"{a}_{b}_{c}" for a in ("accel", "jerk") for b in ("lat", "long") for c in ("rms", "max")}


def test_effort_is_the_way_the_commands_went():
    found = effort(trace_of(steer_command=[0.0, 0.1, -0.1, 0.0], accel_command=[1.0, 1.0, 3.0, 3.0]))
    assert found == pytest.approx({"steer_variation": 0.4, "accel_variation": 2.0})


def test_networks_are_counted_and_their_learning_shared():
    found = networks(trace_of(neurons_speed=[0, 2, 1], learned_speed=[1, 2, 3], neurons_steering=[0, 0, 1]))
    assert found["neurons_speed_max"] == 2
    assert found["neurons_speed_end"] == 1
    assert found["learned_share_speed"] == 1.0
    assert (found["neurons_steering_max"], found["learned_share_steering"]) == (1, 0.0)


def test_empty_trace_has_metrics_too():
    empty = new_trace(0)
    assert set(tracking(empty).values()) == {0.0}
    assert set(comfort(empty).values()) == {0.0}
    assert set(effort(empty).values()) == {0.0}
    assert set(networks(empty).values()) == {0}


# ---------------------------------------------------------------- safety


@given(st.floats(0.5, 200), st.floats(0, 40), st.floats(0, 40))
def test_time_to_collision_is_when_the_gap_is_used_up(gap, speed, ahead):
    assume(abs(speed - ahead) > 0.01)
    found = lead(gap, speed, ahead)
    assert found.gap == gap
    if speed > ahead:
        assert gap + (ahead - speed) * found.time_to_collision == pytest.approx(0.0, abs=1e-9)
        # braking so, the speeds are alike just when the gap is used up
        time = (speed - ahead) / found.deceleration_to_avoid
        assert (speed - ahead) * time - 0.5 * found.deceleration_to_avoid * time**2 == pytest.approx(gap)
    else:
        assert (found.time_to_collision, found.deceleration_to_avoid) == (math.inf, 0.0)


def test_same_speed_is_no_conflict():
    assert lead(3.0, 20.0, 20.0) == (3.0, math.inf, 0.0)
    assert (math.inf, math.inf, 0.0) == NO_LEAD


@pytest.mark.parametrize("gap", [0.0, -1.0])
def test_touching_bumpers_are_a_collision_now(gap):
    found = lead(gap, 20.0, 10.0)
    assert 0.0 <= found.time_to_collision < 1e-3
    assert math.isfinite(found.deceleration_to_avoid)


# ---------------------------------------------------------------- boxes


CAR = Box(0.0, 0.0, 0.0, 4.0, 2.0)


@pytest.mark.parametrize(
    ("other", "overlap"),
    [
        (CAR, True),
        (CAR._replace(x=3.99), True),
        (CAR._replace(x=4.01), False),
        (CAR._replace(y=-1.99), True),
        (CAR._replace(y=-2.01), False),
        (CAR._replace(x=3.0, y=1.9), True),
        (CAR._replace(x=2.99, yaw=math.pi / 2), True),  # half a length and half a width
        (CAR._replace(x=3.01, yaw=math.pi / 2), False),
        # a square on its corner, half a diagonal of sqrt(2) from its center
        (Box(3.41, 0.0, math.pi / 4, 2.0, 2.0), True),
        (Box(3.42, 0.0, math.pi / 4, 2.0, 2.0), False),
        # beside the corner of the car, where the boxes around both would overlap
        (Box(2.9, 1.9, math.pi / 4, 2.0, 2.0), False),
        (Box(0.5, 0.3, 1.0, 0.2, 0.1), True),  # one inside the other
        (Box(0.0, 0.0, 1.3, 30.0, 0.1), True),  # a cross: no corner of either lies in the other
    ],
)
def test_boxes_overlap_as_drawn_on_paper(other, overlap):
    assert boxes_overlap(CAR, other) == overlap
    assert boxes_overlap(other, CAR) == overlap


def corners(box):
    c, s = math.cos(box.yaw), math.sin(box.yaw)
    half = [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
    return [
        (box.x + a * box.length * c - b * box.width * s, box.y + a * box.length * s + b * box.width * c)
        for a, b in half
    ]


def common_area(a, b):
    """Area of the intersection: one polygon clipped by the edges of the other (Sutherland and Hodgman)."""
    polygon, edges = corners(a), corners(b)
    for (x0, y0), (x1, y1) in zip(edges, edges[1:] + edges[:1], strict=True):

        def side(p, x0=x0, y0=y0, x1=x1, y1=y1):
            return (x1 - x0) * (p[1] - y0) - (y1 - y0) * (p[0] - x0)

        clipped = []
        for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            if side(p) >= 0:
                clipped.append(p)
            if side(p) * side(q) < 0:
                t = side(p) / (side(p) - side(q))
                clipped.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        polygon = clipped
    around = zip(polygon, polygon[1:] + polygon[:1], strict=True)
    return 0.5 * abs(sum(p[0] * q[1] - q[0] * p[1] for p, q in around))


boxes = st.builds(Box, st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4), st.floats(0.5, 12), st.floats(0.5, 3))


@settings(max_examples=400)
@given(boxes, boxes)
def test_boxes_overlap_when_their_common_area_is_positive(a, b):
    area = common_area(a, b)
    assume(area == 0.0 or area > 1e-6)
    if area > 0.0:
        assert boxes_overlap(a, b)
    else:  # a hair apart may count as touching
        smaller = a._replace(length=a.length - 1e-6, width=a.width - 1e-6)
        assert not boxes_overlap(smaller, b)


@settings(max_examples=200)
@given(boxes, boxes, st.floats(-0.49, 0.49), st.floats(-0.49, 0.49))
def test_boxes_with_a_point_in_common_overlap(a, b, along, across):
    # move b so that a point of it lies on a point of a
    def inside(box):
        c, s = math.cos(box.yaw), math.sin(box.yaw)
        u, w = along * box.length, across * box.width
        return box.x + u * c - w * s, box.y + u * s + w * c

    (xa, ya), (xb, yb) = inside(a), inside(b)
    moved = b._replace(x=b.x + xa - xb, y=b.y + ya - yb)
    assert boxes_overlap(a, moved)


@given(boxes, boxes, st.floats(-4, 4))
def test_overlap_does_not_depend_on_the_direction_one_looks_from(a, b, turn):
    area = common_area(a, b)
    assume(area > 1e-6 or not boxes_overlap(a._replace(length=a.length + 1e-6, width=a.width + 1e-6), b))

    def turned(box):
        c, s = math.cos(turn), math.sin(turn)
        return box._replace(x=box.x * c - box.y * s, y=box.x * s + box.y * c, yaw=box.yaw + turn)

    assert boxes_overlap(turned(a), turned(b)) == boxes_overlap(a, b)


# ---------------------------------------------------------------- safety of a run


def test_least_values_and_conflicts_of_a_run_are_those_of_its_series():
    trace = np.zeros((6, WIDTH))
    trace[:, AT.speed_long] = (10.0, 10.0, 0.5, 10.0, 10.0, 10.0)
    gap = np.array([20.0, 15.0, 1.0, 30.0, math.inf, 12.0])
    ttc = np.array([2.9, 2.0, 3.1, 2.5, math.inf, 5.0])
    drac = np.array([0.0, 1.0, 3.1, 0.5, 0.0, 2.0])
    found = metrics.safety(trace, gap, ttc, drac)
    assert found["time_to_collision_min"] == 2.0
    assert found["time_headway_min"] == 1.2  # 12 m at 10 m/s; the car that hardly moves does not count
    assert found["gap_min"] == 1.0
    assert found["deceleration_to_avoid_max"] == 3.1
    assert found["conflicts"] == 1  # one that lasts four samples
    ttc[1], drac[2] = 4.0, 0.0
    assert metrics.safety(trace, gap, ttc, drac)["conflicts"] == 2


def test_a_run_without_anybody_ahead_has_no_least_values():
    nobody = np.full(3, math.inf)
    found = metrics.safety(np.zeros((3, WIDTH)), nobody, nobody, np.zeros(3))
    assert [found[key] for key in ("time_to_collision_min", "time_headway_min", "gap_min")] == [None] * 3
    assert found["conflicts"] == 0
