import math
import os
import subprocess
import sys
from pathlib import Path as File

import numpy as np
import pytest

from emran_sumo.loop import AT, DIVERGED, PATH_ENDED, RUNNING, STATUS, TRACE, WIDTH
from emran_sumo.path import nearest, tracking_errors
from emran_sumo.plant.disturbance import DisturbanceParams
from emran_sumo.plant.vehicle import VehicleParams

CAR = VehicleParams()
L = 2.68
START = 20.0  # position of x = 0 on the double lane change


def arrays(networks):
    return [values for memory in networks for values in memory]


# ---------------------------------------------------------------- invariance


@pytest.mark.parametrize("controller", ["coupled-emran", "pid-stanley"])
@pytest.mark.parametrize("chunk", [1, 7, 50])
def test_result_does_not_depend_on_the_periods_per_call(bench, double_lane_change, controller, chunk):
    whole = bench.drive(double_lane_change, 10.0, 8.0, controller, position=START)
    parts = bench.drive(double_lane_change, 10.0, 8.0, controller, position=START, chunk=chunk)
    np.testing.assert_array_equal(parts.trace, whole.trace)
    for a, b in zip(arrays(parts.networks), arrays(whole.networks), strict=True):
        np.testing.assert_array_equal(a, b)


def test_same_inputs_give_the_same_bits(bench, double_lane_change):
    rough = DisturbanceParams(lateral_force=1500.0, mass_amplitude=0.15, friction_amplitude=0.3, wind_amplitude=15.0)
    a, b = (bench.drive(double_lane_change, 15.0, 8.0, position=START, disturbance=rough) for _ in range(2))
    np.testing.assert_array_equal(a.trace, b.trace)
    assert a.state[:3] == b.state[:3]


SHORT = """
import sys
sys.path.insert(0, sys.argv[1])
import conftest
import numpy as np
from emran_sumo.plant.disturbance import DisturbanceParams
rough = DisturbanceParams(lateral_force=1500.0, grade=0.05, mass_factor=1.2)
run = conftest.drive_along(conftest.eq23(-20.0, 80.0, 0.25), 15.0, 0.4, position=60.0, disturbance=rough)
assert run.trace[-1, conftest.AT.learned_steering] > 10
assert run.trace[-1, conftest.AT.learned_speed] > 10
print(run.trace.tobytes().hex())
"""


def test_interpreted_run_gives_the_bits_of_the_compiled_one():
    def run(**changes):
        command = [sys.executable, "-c", SHORT, str(File(__file__).parent)]
        return subprocess.run(command, env={**os.environ, **changes}, capture_output=True, text=True, check=True).stdout

    compiled, interpreted = (np.frombuffer(bytes.fromhex(run(NUMBA_DISABLE_JIT=flag))) for flag in ("0", "1"))
    assert compiled.size == 40 * WIDTH
    np.testing.assert_array_equal(interpreted, compiled)


def test_networks_that_know_the_road_are_kept_and_used(bench, double_lane_change):
    force = DisturbanceParams(lateral_force=1500.0)
    first = bench.drive(double_lane_change, 10.0, 12.0, position=START, disturbance=force)
    learned = first.column("learned_steering")[-1]
    again = bench.drive(double_lane_change, 10.0, 12.0, position=START, disturbance=force, networks=first.networks)
    assert again.networks is first.networks
    assert again.column("learned_steering")[0] >= learned
    early = slice(0, 200)  # the force is there from the start: who knows it leaves the path less
    error = [np.abs(run.column("cross_track_error")[early]).max() for run in (first, again)]
    assert error[1] < 0.5 * error[0]


# ---------------------------------------------------------------- ends


def test_car_that_leaves_the_path_is_reported_with_a_finite_trace(bench, double_lane_change):
    found = bench.drive(double_lane_change, 20.0, 20.0, "pid-stanley", position=START, friction=0.2)
    assert STATUS[found.status] == "diverged"
    assert found.status == DIVERGED
    assert 0 < len(found.trace) < 2000
    assert np.isfinite(found.trace).all()
    lost = (np.abs(found.column("cross_track_error")) > 6.0) | (np.abs(found.column("heading_error")) > 1.4)
    assert lost[-1]
    assert not lost[:-1].any()


def test_run_ends_where_the_path_ends(bench):
    found = bench.drive(bench.straight(50.0), 10.0, 20.0)
    assert (found.status, STATUS[found.status]) == (PATH_ENDED, "path ended")
    assert len(found.trace) == pytest.approx(500, abs=2)
    assert found.column("x")[-1] == pytest.approx(50.0, abs=0.11)
    assert found.column("x")[-2] < 50.0


def test_run_that_goes_on_fills_every_row(bench):
    found = bench.drive(bench.straight(200.0), 10.0, 3.0)
    assert (found.status, len(found.trace)) == (RUNNING, 300)


# ---------------------------------------------------------------- trace


def test_every_column_has_its_name_and_place():
    assert len(set(TRACE)) == WIDTH == len(AT)
    assert (AT.time, AT.x) == (0, 1)
    assert AT._fields == TRACE


def test_last_row_is_the_state_returned(bench, double_lane_change):
    found = bench.drive(double_lane_change, 15.0, 5.0, position=START)
    row, car = found.trace[-1], found.state.vehicle
    for name in ("x", "y", "yaw", "speed_long", "speed_lat", "yaw_rate", "steer", "torque"):
        assert row[getattr(AT, name)] == getattr(car, name)
    for name in ("wheel_speed_front", "wheel_speed_rear"):
        assert row[getattr(AT, name)] == getattr(car, name)
    point = nearest(double_lane_change, car.x, car.y, found.state.position)
    assert row[AT.path_position] == pytest.approx(found.state.position, abs=1e-9)
    assert (row[AT.reference_x], row[AT.reference_y]) == pytest.approx((point.x, point.y), abs=1e-9)
    errors = tracking_errors(point, car.x, car.y, car.yaw)
    assert (row[AT.cross_track_error], row[AT.heading_error]) == pytest.approx(errors, abs=1e-9)
    speed, steering = found.networks
    assert (row[AT.neurons_speed], row[AT.neurons_steering]) == (speed.counts[0], steering.counts[0])


def test_columns_agree_with_each_other(bench, double_lane_change):
    found = bench.drive(double_lane_change, 15.0, 6.0, position=START)
    column = found.column
    np.testing.assert_array_equal(column("time"), np.arange(1, 601) * 0.01)
    np.testing.assert_array_equal(column("speed_error"), column("speed_reference") - column("speed_long"))
    # rates from differences of the neighbors
    slope = (column("x")[2:] - column("x")[:-2]) / 0.02
    along = column("speed_long") * np.cos(column("yaw")) - column("speed_lat") * np.sin(column("yaw"))
    np.testing.assert_allclose(slope, along[1:-1], atol=0.01)
    np.testing.assert_allclose((column("yaw")[2:] - column("yaw")[:-2]) / 0.02, column("yaw_rate")[1:-1], atol=0.01)
    # Newton: specific force from the forces of the axles
    steer = column("steer")
    lateral = column("force_long_front") * np.sin(steer) + column("force_lat_front") * np.cos(steer)
    np.testing.assert_allclose(column("accel_lat"), (lateral + column("force_lat_rear")) / CAR.mass, atol=1e-9)
    assert np.abs(column("accel_lat")).max() > 4.0
    np.testing.assert_allclose(column("load_front") + column("load_rear"), CAR.mass * 9.81)
    limit = (-CAR.steer_limit, CAR.steer_limit)
    total = column("steer_law") + column("steer_network")
    np.testing.assert_allclose(column("steer_command"), np.clip(total, *limit), atol=1e-12)
    for name in ("learned", "grown", "pruned", "merged"):
        for half in ("speed", "steering"):
            assert (np.diff(column(f"{name}_{half}")) >= 0).all()
    for half in ("speed", "steering"):
        born = column(f"grown_{half}") - column(f"pruned_{half}") - column(f"merged_{half}")
        np.testing.assert_array_equal(column(f"neurons_{half}"), born)


def test_command_of_a_row_has_acted_on_its_state(bench, double_lane_change):
    # first-order actuators over one control period, far from their limits
    found = bench.drive(double_lane_change, 10.0, 8.0, position=START)
    torque_command = CAR.mass * CAR.wheel_radius * found.column("accel_command")
    for state, command, lag in (
        (found.column("steer"), found.column("steer_command"), CAR.steer_lag),
        (found.column("torque"), torque_command, CAR.torque_lag),
    ):
        expected = command[1:] + (state[:-1] - command[1:]) * math.exp(-0.01 / lag)
        np.testing.assert_allclose(state[1:], expected, rtol=1e-6, atol=1e-8)


def test_disturbances_arrive_at_their_time_and_place(bench):
    patch = DisturbanceParams(
        patch_start=20.0, patch_end=30.0, patch_friction=0.5, lateral_force=800.0, lateral_force_start=1.0
    )
    found = bench.drive(bench.straight(100.0), 10.0, 5.0, disturbance=patch)
    position, friction = found.column("path_position"), found.column("friction")
    inside = (position > 20.1) & (position < 29.9)
    outside = (position < 19.9) | (position > 30.1)
    assert (friction[inside] == 0.5).all()
    assert (friction[outside] == 1.0).all()
    force, time = found.column("force_external_lat"), found.column("time")
    assert (force[time > 1.005] == 800.0).all()
    assert (force[time < 0.995] == 0.0).all()


# ---------------------------------------------------------------- published figures


def errors_of(run):
    cross_track, heading = run.column("cross_track_error"), run.column("heading_error")
    return [f(e) for e in (cross_track, heading) for f in (lambda e: np.sqrt(np.mean(e**2)), lambda e: np.abs(e).max())]


# gains of the independent model
MODEL = {
    "lateral.gain": 3.3585,
    "lateral.softening": 1.2817,
    "lateral.yaw_damping": 0.0702,
    "lateral.reference_ahead": 0.052,
    "lateral.preview_feedforward": 0.0423,
    "lateral.preview_feedback": 0.0555,
    "lateral.preview_slope": 0.072,
    "lateral.preview_window": 0.0323,
    "lateral.smoothing": 0.927,
}


@pytest.fixture(scope="module")
def table_vi(bench, double_lane_change):
    """Double lane change at 10 m/s for 14 s: rms and max of cross-track and heading error."""
    names = ("coupled-emran", "coupled-base", "pid-stanley")
    return {name: errors_of(bench.drive(double_lane_change, 10.0, 14.0, name, position=START)) for name in names}


def test_coupled_scheme_tracks_the_double_lane_change_within_millimeters(table_vi):
    rms, largest, _, _ = table_vi["coupled-emran"]
    # published for the EMRAN-aided Stanley, Table VI: 0.0218 and 0.0462 m; an independent model reaches 0.0019, 0.0065
    assert rms <= 0.004
    assert largest <= 0.012


def test_baseline_agrees_with_an_independent_model(table_vi):
    assert table_vi["pid-stanley"] == pytest.approx([0.0118, 0.0301, 0.0118, 0.0293], rel=0.15)


def test_base_law_agrees_with_an_independent_model_of_the_same_gains(bench, double_lane_change):
    found = errors_of(bench.drive(double_lane_change, 10.0, 14.0, "coupled-base", position=START, changes=MODEL))
    assert found == pytest.approx([0.0033, 0.0122, 0.0113, 0.0271], rel=0.15)


def test_heading_error_that_remains_is_the_side_slip_of_the_bends(table_vi, double_lane_change):
    # perfect tracking needs e_psi = beta = l_r kappa - m l_f v^2 kappa / (L C_r)
    # known disagreement with Table VI (0.0089, 0.0256): below this floor without leaving the path
    path = double_lane_change
    driven = path.curvature[round(START / path.spacing) : round((START + 140.0) / path.spacing)]
    beta = driven * (1.63 - CAR.mass * 1.05 * 10.0**2 / (L * 95_000.0))
    assert table_vi["coupled-emran"][2] == pytest.approx(math.sqrt(np.mean(beta**2)), rel=0.05)
    assert table_vi["coupled-emran"][3] == pytest.approx(np.abs(beta).max(), rel=0.1)


def test_network_takes_away_a_constant_side_force(bench, double_lane_change):
    # Table VII, 1500 N: published 0.0647 and 0.0983 m; an independent model reaches 0.0031, 0.0131
    force = DisturbanceParams(lateral_force=1500.0)
    base, aided = (
        errors_of(bench.drive(double_lane_change, 10.0, 14.0, name, position=START, disturbance=force, changes=MODEL))
        for name in ("coupled-base", "coupled-emran")
    )
    assert base == pytest.approx([0.0235, 0.0337, 0.0128, 0.0322], rel=0.15)
    assert aided[0] < 0.2 * base[0]
    assert aided[1] < 0.02


@pytest.mark.parametrize(("friction", "published"), [(1.2, (0.0943, 0.2968)), (1.0, (0.0943, 0.2968))])
def test_fast_double_lane_change_stays_below_the_published_errors(bench, double_lane_change, friction, published):
    # Table VIII, 20 m/s; 1.0 asks for more than the friction gives at the sharpest bend
    found = bench.drive(double_lane_change, 20.0, 7.0, position=START, friction=friction)
    assert found.status == RUNNING
    rms, largest, _, _ = errors_of(found)
    assert rms < published[0]
    assert largest < published[1]
