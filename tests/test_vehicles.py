"""Vehicles of TOML files: figures from textbook formulas, refusals in one sentence, and the same car when driven."""

import math
from pathlib import Path

import numpy as np
import pytest

from emran_sumo import vehicle_figure
from emran_sumo.bench import drive_track, scores
from emran_sumo.errors import UserError
from emran_sumo.plant.records import VehicleParams
from emran_sumo.scenario import build
from emran_sumo.vehicles import (
    axle_loads,
    critical_speed,
    figures,
    load_vehicle,
    peak_lateral_acceleration,
    shipped_vehicles,
    understeer_gradient,
    vehicle_values,
)

SEDAN = VehicleParams()


def test_three_vehicles_ship_and_the_sedan_is_the_default():
    assert list(shipped_vehicles()) == ["compact", "sedan", "van"]
    assert load_vehicle("sedan")[1] == SEDAN


def test_axle_loads_carry_the_weight_and_balance_about_the_center_of_gravity():
    for name in shipped_vehicles():
        car = load_vehicle(name)[1]
        front, rear = axle_loads(car)
        assert front + rear == pytest.approx(car.mass * 9.81)
        assert front * car.front_axle == pytest.approx(rear * car.rear_axle)


def test_understeer_gradient_of_the_sedan_is_that_of_table_i_by_hand():
    # m (C_r b - C_f a) / (C_f C_r L), with 135 and 95 kN/rad per axle
    by_hand = 1480.0 * (95e3 * 1.63 - 135e3 * 1.05) / (135e3 * 95e3 * 2.68)
    assert understeer_gradient(SEDAN) == pytest.approx(by_hand, rel=1e-12)
    assert critical_speed(SEDAN) == math.inf


def test_critical_speed_is_where_the_linear_single_track_model_loses_its_stability():
    car = SEDAN._replace(tire=SEDAN.tire._replace(cornering_stiffness_rear=38_000.0))
    front, rear, a, b = 2 * 67_500.0, 2 * 38_000.0, car.front_axle, car.rear_axle

    def stiffness(v: float) -> float:
        """Determinant of the state matrix: positive where the car is stable."""
        matrix = np.array(
            [
                [-(front + rear) / (car.mass * v), -v - (front * a - rear * b) / (car.mass * v)],
                [
                    -(front * a - rear * b) / (car.yaw_inertia * v),
                    -(front * a**2 + rear * b**2) / (car.yaw_inertia * v),
                ],
            ]
        )
        return float(np.linalg.det(matrix))

    v = critical_speed(car)
    assert math.isfinite(v)
    assert stiffness(0.999 * v) > 0.0 > stiffness(1.001 * v)


@pytest.mark.parametrize("friction", [0.5, 1.0])
def test_no_car_corners_harder_than_its_sliding_friction_lets_it(friction):
    for name in shipped_vehicles():
        peak = peak_lateral_acceleration(load_vehicle(name)[1], friction)
        assert 0.85 * friction * 9.81 < peak < 1.05 * friction * 9.81


def test_figures_are_words_with_units():
    told = {figure.name: figure.value for figure in figures(SEDAN)}
    assert told["load, front and rear"] == "60.8 %, 39.2 %"
    assert told["understeer gradient"].endswith(": understeers")
    assert told["power"] == "280 kW, 189 W/kg"


def test_the_picture_of_the_tire_forces_is_a_png(tmp_path):
    vehicle_figure.draw(SEDAN, "sedan", tmp_path / "new" / "sedan.png")
    assert (tmp_path / "new" / "sedan.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(UserError, match=r"--out: cannot write .*sedan\.words"):
        vehicle_figure.draw(SEDAN, "sedan", tmp_path / "sedan.words")


def own(folder: Path, text: str) -> str:
    file = folder / "mine.toml"
    file.write_text(text, encoding="utf-8")
    return str(file)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("[vehicle]\nmass = -5.0", r".*mine\.toml: vehicle\.mass: .*"),
        ("[vehicle]\nmas = 5.0", r'.*mine\.toml: unknown key "vehicle\.mas"\. Did you mean "vehicle\.mass"\?.*'),
        ("[road]\nfriction = 0.5", r".*mine\.toml: road\.friction: found in a vehicle; .*"),
        ("[vehicle]\nlength = 3.0", r".*mine\.toml: vehicle\.length: found 3 m; .* 3\.53 m\."),
        ("[vehicle]\nyaw_inertia = 200.0", r".*mine\.toml: vehicle\.yaw_inertia: found 200 kg m\^2; .*"),
        ("[vehicle]\ncog_height = 2.0", r".*mine\.toml: vehicle\.cog_height: found 2 m; .*"),
        (
            "[vehicle.tire]\ncornering_stiffness_rear = 33000.0",
            r".*mine\.toml: vehicle\.tire: found an oversteering .*",
        ),
        ("vehicle = [", r".*mine\.toml: .*"),
    ],
)
def test_what_no_car_can_be_is_refused_in_one_sentence(tmp_path, text, sentence):
    with pytest.raises(UserError, match=sentence) as error:
        load_vehicle(own(tmp_path, text))
    assert "\n" not in str(error.value)


def test_an_unknown_vehicle_is_told_with_the_nearest_name():
    with pytest.raises(UserError, match=r'Unknown vehicle "vann"\. .*van'):
        load_vehicle("vann")


@pytest.mark.parametrize("name", ["compact", "van"])
def test_each_vehicle_follows_the_double_lane_change_of_eq_23(name):
    shape = {"world": "track", "track.shape": "double_lane_change", "track.speed": 10.0, "duration": 14.0}
    found = scores(drive_track(build(shape | vehicle_values(name)[1])))
    assert found["ended"] == 1.0
    assert found["cross_track_error_max"] < 0.15  # twice the paper's sedan and driver
