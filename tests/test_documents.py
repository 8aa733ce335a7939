"""What the pages about the paper say is what the tables, the defaults and linear theory say."""

import re
from pathlib import Path

import numpy as np
import pytest

from emran_sumo.bench import drive_track, scores
from emran_sumo.control.steering import SLOWEST_SCALED, SteeringParams
from emran_sumo.paper.cases import TABLES, printed_rows, published
from emran_sumo.plant.vehicle import VehicleParams
from emran_sumo.scenario import build

DOCS = Path(__file__).parent.parent / "docs"
PUBLISHED_ROW = {"pid-stanley": ("PID", "Stanley"), "paper's signal, tuned": ("PID-EMRAN", "Stanley-EMRAN")}
CELLS = {"e_v rms": 0, "e_v max": 1, "e_y rms": 0, "e_y max": 1, "e_psi rms": 2, "e_psi max": 3}


def rows_of(text: str, columns: int) -> list[list[str]]:
    """Cells of all Markdown rows of so many columns, without heads and rules."""
    found = [[cell.strip() for cell in line.strip().strip("|").split("|")] for line in text.splitlines() if "|" in line]
    return [cells for cells in found if len(cells) == columns and not set("".join(cells)) <= {"-"}]


def our_cells(table: str, case: str, row: str) -> list[str]:
    """Cells of a row in the first part of docs/tables.md."""
    text = (DOCS / "tables.md").read_text(encoding="utf-8").split("## The paper word for word")[0]
    section = next(part for part in text.split("### ") if part.startswith(f"Table {table}. "))
    at = section.split(f"| **{case}** |")[1].split("\n| **")[0]
    line = next(line for line in at.splitlines() if line.startswith(f"| {row} |"))
    return [re.sub(r"\*| x.*", "", cell.strip()) for cell in line.strip("| ").split("|")[1:]]


def readings() -> list[list[str]]:
    text = (DOCS / "paper.md").read_text(encoding="utf-8").split("### Readings")[1].split("## Figures")[0]
    return rows_of(text, 5)[1:]


@pytest.mark.parametrize("line", readings(), ids=lambda line: " ".join(line[:2]))
def test_other_readings_of_the_paper_give_the_cells_that_are_stated(line):
    name, case_name, settings, printed, measured = line
    case = next(case for case in TABLES[name].cases if case.name == case_name)
    given = {key: float(value) for key, value in re.findall(r"([\w.]+)=([\d.]+)", settings)}
    found = scores(drive_track(build({**case.given, "controller": "pid-stanley", **given})))
    assert " ".join(f"{found[metric]:.4f}" for metric in TABLES[name].metrics) == measured
    rows = printed_rows(published()["tables"][name])
    assert tuple(map(float, printed.split())) == rows["PID" if "PID" in rows else "Stanley"]


def deviations() -> list[list[str]]:
    text = (DOCS / "paper.md").read_text(encoding="utf-8").split("## Where our numbers differ")[1]
    text = text.split("### Readings")[0]
    return rows_of(text, 7)[1:]


@pytest.mark.parametrize("line", deviations(), ids=lambda line: " ".join(line[:4]))
def test_every_deviation_quotes_the_cells_of_the_tables(line):
    table, case, row, cell, printed, ours, why = line
    names = printed_rows(published()["tables"][table])
    row_names = PUBLISHED_ROW.get(row, ("PID-EMRAN", "Stanley-EMRAN"))
    source = next(names[name] for name in row_names if name in names)
    assert float(printed) == source[CELLS[cell]]
    mine = our_cells(table, case, row)
    assert ours == (mine[0] if mine[0].startswith("lost") else mine[CELLS[cell]])
    assert len(why) > 20


def test_there_are_deviations_of_every_table():
    assert {line[0] for line in deviations()} >= {"III", "IV", "V", "VI", "VII", "VIII", "IX", "XI"}


@pytest.mark.parametrize("page", ["paper.md", "control.md"])
def test_pictures_and_links_of_a_page_are_there_and_small(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        file = DOCS / target
        assert file.exists(), target
        assert file.suffix != ".png" or file.stat().st_size < 150_000
    assert text.count("```") % 2 == 0
    assert all(text[m.end() : m.end() + 1] == "\n" for m in re.finditer(r"```math", text))


def largest_rate(speed: float, paper: bool) -> float:
    """Largest rate [1/s] of learning with which the linear bicycle with steering lag is stable on a straight road."""
    car, law = VehicleParams(), SteeringParams()
    m, inertia, a, b = car.mass, car.yaw_inertia, car.front_axle, car.rear_axle
    front, rear = 2.0 * car.tire.cornering_stiffness_front, 2.0 * car.tire.cornering_stiffness_rear
    gain = 2.5 / speed if paper else law.gain / (law.softening + speed)
    ahead = a if paper else law.reference_ahead
    feedback = np.array([-gain, -1.0 - gain * ahead, 0.0, 0.0, 0.0, 0.0])  # y, psi, v_y, r, delta, network
    signal, steer = feedback.copy(), feedback.copy()
    if not paper:
        signal += np.array([0.0, 0.0, -1.0 / speed, -ahead / speed, 0.0, 0.0])
        steer[3] -= law.yaw_damping
    system = np.zeros((6, 6))
    system[0, 1:3] = speed, 1.0
    system[1, 3] = 1.0
    system[2, 2:5] = -(front + rear) / (m * speed), -(a * front - b * rear) / (m * speed) - speed, front / m
    system[3, 2:5] = (
        -(a * front - b * rear) / (inertia * speed), -(a * a * front + b * b * rear) / (inertia * speed),
        a * front / inertia,
    )  # fmt: skip
    system[4] = (steer + np.array([0.0, 0.0, 0.0, 0.0, -1.0, 1.0])) / car.steer_lag
    low, high = 0.0, 200.0
    for _ in range(60):
        system[5] = (rate := 0.5 * (low + high)) * signal
        low, high = (rate, high) if np.linalg.eigvals(system).real.max() < 1e-9 else (low, rate)
    return low


def test_the_stability_budget_is_that_of_the_linear_car_and_is_kept():
    text = (DOCS / "control.md").read_text(encoding="utf-8").split("## How fast a loop may learn")[1]
    speeds, plain, full, used = ([float(cell) for cell in cells[1:]] for cells in rows_of(text, 6)[:4])
    law = SteeringParams()
    for v, stanley, course, rate in zip(speeds, plain, full, used, strict=True):
        assert largest_rate(v, True) == pytest.approx(stanley, abs=0.06)
        assert largest_rate(v, False) == pytest.approx(course, abs=0.06)
        scale = (10.0 / max(v, SLOWEST_SCALED)) ** law.rate_exponent
        assert law.emran.rate_steady * scale + law.emran.bias_rate == pytest.approx(rate, abs=0.06)
        assert rate < 0.65 * course
