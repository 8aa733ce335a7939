"""Every steering law in the closed loop: what must hold whichever of them steers."""

import typing

import numpy as np
import pytest

from emran_sumo.control.emran import blank_memory
from emran_sumo.control.stanley import HoffmannMemory, HoffmannParams, full_stanley
from emran_sumo.control.steering import (
    INPUTS,
    Law,
    SteeringMemory,
    SteeringParams,
    blank_steering,
    compiled_view,
    track,
)
from emran_sumo.path import Path, nearest, tracking_errors
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.plant.vehicle import VehicleParams, rolling_start

CAR = VehicleParams()
OTHERS = [law for law in typing.get_args(Law) if law != "stanley"]
every_other = pytest.mark.parametrize("law", OTHERS)


def test_each_law_has_parameters_and_a_memory_of_its_own():
    for law in OTHERS:
        params = SteeringParams(law=law)
        assert law in SteeringParams._fields
        memory = blank_steering(params, CAR, rolling_start(CAR, 5.0, 0.0, 0.0, 0.0), 0.01)
        assert sum(part is not None for part in memory[1:]) == 1
    assert blank_steering(SteeringParams(), CAR, rolling_start(CAR, 5.0, 0.0, 0.0, 0.0), 0.01) == SteeringMemory()


def test_a_record_made_for_kernels_starts_no_law():
    with pytest.raises(AssertionError, match="made for kernels"):
        blank_steering(compiled_view(SteeringParams()), CAR, rolling_start(CAR, 5.0, 0.0, 0.0, 0.0), 0.01)


def steer(law, path, state, hint, authority=0.0):
    params = SteeringParams(law=law)
    params = params._replace(emran=params.emran._replace(authority=authority))
    memory = blank_steering(params, CAR, state, 0.01)
    point = nearest(path, state.x, state.y, hint)
    errors = tracking_errors(point, state.x, state.y, state.yaw)
    net = blank_memory(params.emran, INPUTS)
    return track(compiled_view(params), net, CAR, memory, state, path, point, *errors, 0.01)[0]


@every_other
def test_car_on_a_straight_path_is_not_steered_and_one_beside_it_is_steered_back(bench, law):
    path = bench.straight(100.0)
    assert steer(law, path, rolling_start(CAR, 12.0, 20.0, 0.0, 0.0), 20.0).angle == 0.0
    left, right = (steer(law, path, rolling_start(CAR, 12.0, 20.0, y, 0.0), 20.0).angle for y in (0.2, -0.2))
    assert left < 0.0 < right
    assert left == pytest.approx(-right, rel=1e-9)


@every_other
def test_command_stays_within_the_reach_of_tires_and_steering(bench, law):
    path = bench.straight(100.0)
    for speed in (0.0, 0.3, 1.0, 5.0, 30.0):
        for y in (-4.0, 4.0):
            angle = steer(law, path, rolling_start(CAR, speed, 20.0, y, 0.5), 20.0).angle
            assert abs(angle) <= min(CAR.steer_limit, SteeringParams().slip_limit + 1e-12)


def authority(value):
    return {"lateral.emran.authority": value}


@every_other
def test_mirrored_double_lane_change_is_driven_as_its_mirror_image(bench, double_lane_change, law):
    path = double_lane_change
    mirror = path._replace(y=-path.y, yaw=-path.yaw, curvature=-path.curvature)
    changes = {"lateral.law": law}
    a, b = (bench.drive(p, 12.0, 8.0, position=20.0, changes=changes) for p in (path, mirror))
    for name in ("y", "yaw", "steer_command", "steer_network", "cross_track_error"):
        np.testing.assert_allclose(a.column(name), -b.column(name), atol=1e-9)


@every_other
def test_calls_of_any_length_give_the_same_bits(bench, double_lane_change, law):
    changes = {"lateral.law": law}
    whole, parts = (
        bench.drive(double_lane_change, 12.0, 6.0, position=20.0, changes=changes, chunk=chunk) for chunk in (None, 5)
    )
    np.testing.assert_array_equal(whole.trace, parts.trace)


@every_other
@pytest.mark.parametrize("radius", [60.0, -60.0])
def test_law_settles_on_a_circle(bench, law, radius):
    changes = {"lateral.law": law, **authority(0.0)}
    found = bench.drive(bench.circle(radius, 200.0), 10.0, 14.0, changes=changes)
    late = found.column("time") > 12.0
    assert np.abs(found.column("cross_track_error")[late]).max() < 0.06
    assert np.ptp(found.column("cross_track_error")[late]) < 5e-3
    assert found.column("yaw_rate")[late] == pytest.approx(10.0 / radius, rel=0.01)


@pytest.mark.parametrize("law", ["hoffmann", "adrc", "lqr", "lq_preview", "t2fnn"])
def test_any_law_is_aided_by_the_network_against_a_side_force(bench, law):
    # a constant push, which no law without an integral takes away
    push, path, late = DisturbanceParams(lateral_force=1500.0), bench.straight(260.0), slice(1200, None)
    alone, aided = (
        np.abs(bench.drive(
            path, 12.0, 18.0, changes={"lateral.law": law, **authority(share)}, disturbance=push, position=5.0
        ).column("cross_track_error")[late]).mean()
        for share in (0.0, 1.0)
    )  # fmt: skip
    assert aided < max(0.35 * alone, 2e-3)


def town_corner(radius=6.0, spacing=0.1):
    """20 m straight, a left and a right corner of a right angle each, as a town's streets have them."""
    lead, turn = 25.0, 0.5 * np.pi * radius
    s = np.arange(0.0, 3 * lead + 2 * turn, spacing)
    kappa = np.where((s > lead) & (s < lead + turn), 1.0, 0.0) / radius
    kappa -= np.where((s > 2 * lead + turn) & (s < 2 * lead + 2 * turn), 1.0, 0.0) / radius
    wide = 20  # corners begin and end over 2 m
    kappa = np.convolve(kappa, np.ones(wide) / wide, "same")
    yaw = np.concatenate(([0.0], np.cumsum(0.5 * (kappa[1:] + kappa[:-1]) * spacing)))
    x = np.concatenate(([0.0], np.cumsum(0.5 * (np.cos(yaw[1:]) + np.cos(yaw[:-1])) * spacing)))
    y = np.concatenate(([0.0], np.cumsum(0.5 * (np.sin(yaw[1:]) + np.sin(yaw[:-1])) * spacing)))
    return Path(x, y, yaw, kappa, np.zeros_like(x), spacing)


@every_other
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_car_stops_creeps_and_turns_through_a_town(bench, law, share):
    # from standstill, through a corner at 4 m/s, a stop within the next one, creeping on at 0.6 m/s, and away
    t = np.arange(0.0, 50.0, 0.01)
    knots = [
        (0, 0.0),
        (1, 0.0),
        (4, 4.0),
        (15.5, 4.0),
        (17.5, 0.0),
        (22, 0.0),
        (23, 0.6),
        (30, 0.6),
        (33, 4.0),
        (50, 4.0),
    ]
    speeds = np.interp(np.append(t, 50.0), *zip(*knots, strict=True))
    path = town_corner()
    found = bench.drive(path, 0.0, 50.0, changes={"lateral.law": law, **authority(share)}, speeds=speeds, position=5.0)
    assert found.status in (0, 2)  # runs on, or at the end of the path
    assert found.column("path_position")[-1] > 80.0
    assert np.abs(found.column("cross_track_error")).max() < 0.6
    standing = (found.column("time") > 19.0) & (found.column("time") < 21.9)
    assert np.ptp(found.column("steer")[standing]) < 0.05


@every_other
def test_take_over_at_speed_beside_the_path_is_calm(bench, law):
    path = bench.straight(400.0)
    shifted = path._replace(y=path.y + 0.3)
    changes = {"lateral.law": law}
    found = bench.drive(path, 25.0, 8.0, changes=changes, position=10.0)
    assert np.abs(found.column("steer_command")).max() == 0.0
    from emran_sumo.loop import Clock, blank_networks, closed_loop, new_trace, quiet_references, start

    control = bench.control("coupled-emran", changes)
    state = start(CAR, control.longitudinal, control.lateral, rolling_start(CAR, 25.0, 10.0, 0.0, 0.0), 10.0, 0.01)
    nets, trace = blank_networks(control), new_trace(800)
    control = control._replace(lateral=compiled_view(control.lateral))
    references = quiet_references(shifted, np.full(801, 25.0), np.zeros(800))
    _, status, _ = closed_loop(
        CAR, control, DisturbanceParams(), 1.0, Clock(0, 0.01, 10, 0.001), references, state, nets.speed,
        nets.steering, trace,
    )  # fmt: skip
    drive = type(found)(state, status, nets, trace)
    assert status == 0
    assert np.abs(drive.column("steer_command")).max() < 0.2
    assert np.abs(drive.column("cross_track_error")[-100:]).max() < 0.05


# ---------------------------------------------------------------- the full law of Hoffmann et al.


def test_full_stanley_in_a_steady_bend_needs_no_offset():
    # on the path the front axle moves along it: heading error = its course; the angle is course plus slip
    speed, kappa = 15.0, 0.01
    slip = 1480.0 * speed**2 * kappa * 1.63 / (2.68 * 135_000.0)  # load share of the front axle over its stiffness
    state = rolling_start(CAR, speed, 0.0, 0.0, 0.0)._replace(yaw_rate=speed * kappa, steer=0.02)
    angle, after = full_stanley(HoffmannParams(), HoffmannMemory(0.02), CAR, state, 0.0, 0.013, kappa)
    assert angle == pytest.approx(0.013 + slip, rel=1e-12)
    assert after == HoffmannMemory(0.02)


def test_full_stanley_damps_yaw_and_steering():
    params = HoffmannParams(yaw_damping=0.1, steer_damping=0.4)
    state = rolling_start(CAR, 10.0, 0.0, 0.0, 0.0)._replace(yaw_rate=0.2, steer=0.05)
    angle, after = full_stanley(params, HoffmannMemory(0.04), CAR, state, 0.0, 0.0, 0.0)
    assert angle == pytest.approx(-0.1 * 0.2 - 0.4 * 0.01, rel=1e-12)
    assert after.steer == 0.05
