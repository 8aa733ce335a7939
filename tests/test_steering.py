import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emran_sumo.control.emran import LEARNED, NEURONS, SAMPLES, EmranParams, blank_memory
from emran_sumo.control.steering import INPUTS, SteeringMemory, SteeringParams, cornering_slip, static_load, track
from emran_sumo.path import nearest, tracking_errors
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.plant.vehicle import VehicleParams, rolling_start

CAR = VehicleParams()
G, L = 9.81, 2.68
C_FRONT, C_REAR = 135_000.0, 95_000.0  # axles [N/rad]
UNDERSTEER = 1480.0 / L * (1.63 / C_FRONT - 1.05 / C_REAR)  # [rad s^2/m]
AIDED = SteeringParams()
BASE = AIDED._replace(emran=AIDED.emran._replace(authority=0.0))
PLAIN = BASE._replace(feedforward=False, gain=2.5, softening=0.0)
quick = settings(deadline=None)  # the first call compiles


def car(speed, **state):
    return rolling_start(CAR, speed, 0.0, 0.0, 0.0)._replace(**state)


def steer(params, path, state, net=None, memory=SteeringMemory(0.0), hint=0.0):  # noqa: B008
    net = blank_memory(params.emran, INPUTS) if net is None else net
    point = nearest(path, state.x, state.y, hint)
    errors = tracking_errors(point, state.x, state.y, state.yaw)
    return track(params, net, CAR, memory, state, path, point, *errors, 0.01)


# ---------------------------------------------------------------- feed-forward


def test_static_loads_carry_the_car():
    assert static_load(CAR, False) == pytest.approx(8830, abs=1)
    assert static_load(CAR, True) == pytest.approx(5688, abs=1)


@pytest.mark.parametrize(("rear", "stiffness"), [(False, C_FRONT), (True, C_REAR)])
def test_slip_of_a_gentle_bend_is_that_of_the_linear_tire(rear, stiffness):
    for accel in (0.1, -0.1):
        expected = static_load(CAR, rear) / G * accel / stiffness
        assert cornering_slip(AIDED, CAR, accel, rear) == pytest.approx(expected, rel=0.01)


def test_slip_of_a_sharp_bend_is_larger_than_linear_and_capped():
    linear = static_load(CAR, True) / G * 7.0 / C_REAR
    assert linear < cornering_slip(AIDED, CAR, 7.0, True) < AIDED.slip_cap
    assert cornering_slip(AIDED, CAR, 50.0, True) == AIDED.slip_cap
    assert cornering_slip(AIDED, CAR, -50.0, True) == -AIDED.slip_cap
    assert cornering_slip(AIDED, CAR, 0.0, True) == 0.0


@pytest.mark.parametrize("speed", [5.0, 15.0, 30.0])
@pytest.mark.parametrize("turn", [1, -1])
def test_angle_for_a_gentle_bend_is_that_of_the_linear_bicycle(bench, speed, turn):
    kappa = turn * 0.3 / speed**2  # 0.3 m/s2
    path = bench.circle(1 / kappa, 200.0)
    side_slip = 1.63 * kappa - 1480.0 * 1.05 / (L * C_REAR) * speed**2 * kappa
    position = 100.0
    state = car(
        speed,
        x=math.sin(position * kappa) / kappa,
        y=(1 - math.cos(position * kappa)) / kappa,
        yaw=position * kappa - side_slip,
        yaw_rate=speed * kappa,
        speed_lat=speed * math.tan(side_slip),
    )
    # at its steady side slip the law is its feed-forward; reference_ahead shifts the wanted heading by a kappa
    found = steer(BASE._replace(reference_ahead=0.0), path, state, hint=position)[0]
    expected = L * kappa + UNDERSTEER * speed**2 * kappa
    assert found.law == pytest.approx(expected, rel=0.01, abs=2e-5)
    assert found.angle == found.law
    assert found.network == 0.0


def test_car_on_a_straight_path_is_not_steered(bench):
    for params in (AIDED, BASE, PLAIN):
        assert steer(params, bench.straight(100.0), car(20.0, x=10.0), hint=9.0)[0].angle == 0.0


@pytest.mark.parametrize("params", [AIDED, BASE, PLAIN])
@pytest.mark.parametrize("side", [1, -1])
def test_car_beside_a_straight_path_is_steered_back(bench, params, side):
    state = car(15.0, x=20.0, y=-0.5 * side)
    found = steer(params, bench.straight(100.0), state, hint=20.0)[0]
    assert found.angle * side > 0.0
    assert found.law == pytest.approx(math.atan(params.gain * 0.5 * side / (params.softening + 15.0)))


def test_turning_car_on_a_straight_path_is_damped(bench):
    found = steer(BASE, bench.straight(100.0), car(15.0, x=20.0, yaw_rate=0.1), hint=20.0)[0]
    assert found.law == pytest.approx(-BASE.yaw_damping * 0.1)


def test_plain_law_steers_by_the_errors_of_the_front_axle(bench):
    state = car(10.0, x=20.0, y=-0.2, yaw=0.1)
    offset = 0.2 - 1.05 * math.sin(0.1)
    expected = -0.1 + math.atan(2.5 * offset / 10.0)
    assert steer(PLAIN, bench.straight(100.0), state, hint=20.0)[0].law == pytest.approx(expected, abs=1e-12)


# ---------------------------------------------------------------- limits


def test_angle_stays_within_the_steering_and_the_front_slip_limit(bench):
    path = bench.straight(100.0)
    assert steer(PLAIN, path, car(1.0, x=20.0, y=-5.0), hint=20.0)[0].angle == CAR.steer_limit
    for y, sign in ((-5.0, 1), (5.0, -1)):
        found = steer(BASE, path, car(3.0, x=20.0, y=y, speed_lat=0.3), hint=20.0)[0]
        assert found.angle == pytest.approx(math.atan2(0.3, 3.0) + sign * BASE.slip_limit)


def small(limit):
    return st.floats(-limit, limit)


@quick
@given(
    small(1.5), small(0.3), st.floats(2, 30), small(1.0), small(0.5), small(0.2), st.floats(30, 60),
    st.sampled_from([AIDED, BASE, PLAIN]),
)  # fmt: skip
def test_law_and_learning_are_mirror_symmetric(bench, y, yaw, speed, speed_lat, yaw_rate, angle, along, params):
    left, right = bench.circle(120.0, 100.0), bench.circle(-120.0, 100.0)
    state = car(speed, x=along, y=y + 5.0, yaw=yaw, speed_lat=speed_lat, yaw_rate=yaw_rate, steer=angle)
    mirrored = state._replace(y=-state.y, yaw=-yaw, speed_lat=-speed_lat, yaw_rate=-yaw_rate, steer=-angle)
    nets = blank_memory(params.emran, INPUTS), blank_memory(params.emran, INPUTS)
    memories = SteeringMemory(0.0), SteeringMemory(0.0)
    for _ in range(5):
        a, memory_a = steer(params, left, state, nets[0], memories[0], hint=along)
        b, memory_b = steer(params, right, mirrored, nets[1], memories[1], hint=along)
        memories = memory_a, memory_b
        assert (a.angle, a.law, a.network, a.signal) == pytest.approx(
            (-b.angle, -b.law, -b.network, -b.signal), abs=1e-12
        )
        assert a.learned == b.learned


def test_mirrored_double_lane_change_is_driven_as_its_mirror_image(bench, double_lane_change):
    path = double_lane_change
    mirror = path._replace(y=-path.y, yaw=-path.yaw, curvature=-path.curvature)
    a, b = (bench.drive(p, 15.0, 8.0, position=20.0) for p in (path, mirror))
    for name in ("y", "yaw", "speed_lat", "yaw_rate", "steer_command", "steer_network", "cross_track_error"):
        np.testing.assert_allclose(a.column(name), -b.column(name), atol=1e-12)
    for name in ("x", "speed_long", "neurons_steering", "learned_steering"):
        np.testing.assert_allclose(a.column(name), b.column(name), atol=1e-12)
    assert np.abs(a.column("steer_network")).max() > 1e-3


# ---------------------------------------------------------------- network


def count_after(state, path, params=AIDED, times=1):
    net, memory = blank_memory(params.emran, INPUTS), SteeringMemory(0.0)
    for _ in range(times):
        command, memory = steer(params, path, state, net, memory, hint=20.0)
    return net, command


def test_network_learns_toward_the_path(bench):
    for y in (0.1, -0.1):
        net, command = count_after(car(15.0, x=20.0, y=y), bench.straight(100.0), times=20)
        assert net.counts[LEARNED] == 20
        assert command.learned
        assert command.network * command.law > 0.0


def test_perfect_tracking_of_a_bend_is_no_lesson(bench):
    # course error: zero where the car moves along the path, whatever its side slip
    path, speed, kappa, beta = bench.circle(100.0, 200.0), 15.0, 0.01, -0.012
    state = car(
        speed, x=100 * math.sin(0.5), y=100 * (1 - math.cos(0.5)), yaw=0.5 - beta,
        speed_lat=speed * math.tan(beta), yaw_rate=speed * kappa,
    )  # fmt: skip
    command = steer(AIDED._replace(reference_ahead=0.0), path, state, hint=50.0)[0]
    assert command.signal == pytest.approx(0.0, abs=1e-6)
    assert not command.learned


def test_sliding_tires_teach_nothing_and_the_weights_fade(bench):
    path, net = bench.straight(100.0), blank_memory(AIDED.emran, INPUTS)
    net.counts[NEURONS] = 1
    net.weights[0], net.bias[0] = 0.1, 0.05
    for slip, learns in ((0.9 * AIDED.guard, True), (1.1 * AIDED.guard, False)):
        before, weight = net.counts[SAMPLES], net.weights[0]
        command, _ = steer(AIDED, path, car(15.0, x=20.0, y=-0.3, steer=slip), net, hint=20.0)
        assert command.learned == learns
        assert net.counts[SAMPLES] == before + learns
        if not learns:
            assert net.weights[0] == pytest.approx(weight * (1 - AIDED.guard_decay * 0.01), rel=1e-12)


def test_output_fades_out_between_one_and_two_slip_guards(bench):
    path, found = bench.straight(100.0), []
    for share in (1.5, 1.75, 2.0, 3.0):
        net = blank_memory(AIDED.emran, INPUTS)
        net.bias[0] = 0.05
        found.append(steer(AIDED, path, car(15.0, x=20.0, steer=share * AIDED.guard), net, hint=20.0)[0].network)
    assert found[0] > 0.0
    assert found[1] == pytest.approx(0.5 * found[0])
    assert found[2:] == pytest.approx([0.0, 0.0], abs=1e-15)


def test_standing_car_learns_nothing(bench):
    net, command = count_after(car(1.9, x=20.0, y=-0.3), bench.straight(100.0))
    assert (net.counts[SAMPLES], command.learned) == (0, False)


def test_saturated_output_is_not_pushed_further(bench):
    path = bench.straight(100.0)
    for bias, learns in ((AIDED.emran.output_max, False), (-AIDED.emran.output_max, True)):
        net = blank_memory(AIDED.emran, INPUTS)
        net.bias[0] = bias
        assert steer(AIDED, path, car(15.0, x=20.0, y=-0.3), net, hint=20.0)[0].learned == learns


def test_rates_follow_the_speed_and_stop_growing_below_the_slowest(bench):
    params = AIDED._replace(emran=AIDED.emran._replace(neurons_max=1, bias_rate=0.0, leak=0.0, growth_gain=0.0))

    def variance(speed):
        net, _ = count_after(car(speed, x=20.0, y=-0.3), bench.straight(100.0), params)
        p0 = net.covariance[0, 0, 0]
        return p0 / (1 + p0) / 0.01  # rate at birth [1/s]

    rate, power = params.emran.rate_initial, params.rate_exponent
    assert variance(10.0) == pytest.approx(rate)
    assert variance(20.0) == pytest.approx(rate * 0.5**power)
    assert variance(7.5) == pytest.approx(rate * (10 / 7.5) ** power)
    assert variance(4.0) == pytest.approx(variance(7.5))


# ---------------------------------------------------------------- closed loop


@pytest.mark.parametrize("speed", [6.0, 15.0, 20.0])
@pytest.mark.parametrize("radius", [80.0, -80.0])
def test_law_without_network_settles_on_a_circle(bench, speed, radius):
    found = bench.drive(bench.circle(radius, 9.0 * speed + 60.0), speed, 8.0, "coupled-base")
    late = found.column("time") > 6.0
    assert np.abs(found.column("cross_track_error")[late]).max() < 0.03
    assert np.ptp(found.column("cross_track_error")[late]) < 2e-3
    assert found.column("yaw_rate")[late] == pytest.approx(speed / radius, rel=5e-3)


@pytest.mark.parametrize("radius", [80.0, -80.0])
def test_network_takes_away_what_the_law_leaves_on_a_circle(bench, radius):
    path = bench.circle(radius, 300.0)
    late = slice(1200, None)
    base, aided = (
        np.abs(bench.drive(path, 15.0, 15.0, name).column("cross_track_error")[late]).max()
        for name in ("coupled-base", "coupled-emran")
    )
    # the dead zone of the learning signal is what remains: atan(k e / (k_s + v)) = error_learn
    dead = AIDED.emran.error_learn * (AIDED.softening + 15.0) / AIDED.gain
    assert aided < max(1.2 * dead, 0.5 * base)


def test_network_without_authority_gives_the_bits_of_the_base_law(bench, double_lane_change):
    base = bench.drive(double_lane_change, 10.0, 8.0, "coupled-base", position=20.0)
    other = EmranParams(authority=0.0, eps_max=0.1, eps_min=0.05, rate_initial=80.0, bias_rate=50.0, error_learn=0.0)
    odd = bench.drive(
        double_lane_change, 10.0, 8.0, position=20.0, changes={"lateral.emran": other, "longitudinal.emran": other}
    )
    np.testing.assert_array_equal(odd.trace, base.trace)
    assert odd.networks.steering.counts[SAMPLES] == 0


def test_network_that_cannot_change_gives_the_bits_of_the_base_law(bench, double_lane_change):
    mute = ("growth_gain", "rate_initial", "rate_steady", "bias_rate")
    changes = {f"{half}.emran.{key}": 0.0 for half in ("lateral", "longitudinal") for key in mute}
    push = DisturbanceParams(lateral_force=1500.0)
    base = bench.drive(double_lane_change, 10.0, 8.0, "coupled-base", position=20.0, disturbance=push)
    silent = bench.drive(double_lane_change, 10.0, 8.0, position=20.0, changes=changes, disturbance=push)
    for name in ("x", "y", "yaw", "speed_long", "yaw_rate", "steer_command", "accel_command", "cross_track_error"):
        np.testing.assert_array_equal(silent.column(name), base.column(name))
    assert silent.column("learned_steering")[-1] > 0
