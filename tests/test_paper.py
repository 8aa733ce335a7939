import json
import math

import numpy as np
import pytest

from emran_sumo.bench import drive_track, scores
from emran_sumo.controllers import CONTROLLERS
from emran_sumo.errors import UserError
from emran_sumo.paper import memory, tables, timing
from emran_sumo.paper.cases import ACCURACY, ADD_ON, BLIND, MAIN, TABLES, compared, dlc, printed_rows, published
from emran_sumo.paper.command import paper
from emran_sumo.paper.document import document, sheet_text
from emran_sumo.paper.layout import sheets
from emran_sumo.paper.overview import GLANCE, overview_sheet
from emran_sumo.paper.rows import OWN, PLAIN, literal_rows, other_rows, pairs, rows
from emran_sumo.paper.sheet import Line, Sheet
from emran_sumo.paper.tables import Condition
from emran_sumo.scenario import build, keys

QUIET = Condition()


@pytest.fixture(scope="module")
def lane_change():
    """Everything that drives table VI."""
    return tables.results(tables.driven_tables(["VI"]), QUIET, False, 1)


# ---------------------------------------------------------------- published numbers


def test_published_cells_are_those_of_the_paper():
    printed = published()["tables"]
    assert printed["III"]["PID-EMRAN"] == [0.0017, 0.0332]
    assert printed["V"]["PID"] == [0.1463, 0.2678]
    assert printed["VI"]["Stanley-EMRAN"] == [0.0218, 0.0462, 0.0089, 0.0256]
    assert printed["IX"]["Stanley"] == [75.3552, 152.1152, 1.3771, 1.6698]
    assert printed["XI"]["Coupled-EMRAN"] == [0.0272, 0.0598, 0.0085, 0.0290]
    assert published()["table_II"]["lateral"]["P_0"] == 1.155
    assert published()["table_II"]["longitudinal"]["N_w"] == 12


@pytest.mark.parametrize(
    ("table", "cell", "percent"),
    [("VI", 1, 77.25), ("VI", 3, 42.72), ("VII", 1, 60.80), ("VII", 3, 32.97), ("III", 0, 88.59), ("III", 1, 57.65)],
)
def test_published_cells_give_the_percentages_in_the_text_of_the_paper(table, cell, percent):
    printed = published()["tables"][table]
    without, with_network = compared(printed, False)[cell], compared(printed, True)[cell]
    assert 100.0 * (1.0 - with_network / without) == pytest.approx(percent, abs=0.02)


def test_table_viii_is_compared_with_the_lowest_cells_of_both_rows_with_emran():
    assert compared(published()["tables"]["VIII"], True) == (0.0943, 0.2968, 0.0304, 0.1168)


def test_table_xii_names_the_rows_that_are_not_runs_of_the_authors():
    table = published()["tables"]["XII"]
    assert table["quoted"] == ["EKF-T2FNN", "ADRC"]
    assert printed_rows(table)["EKF-T2FNN"] == (0.0587, 0.0685, 0.0050, 0.0089)
    assert printed_rows(table)["ADRC"] == (0.2207, 0.5593, 0.0178, 0.0363)
    assert printed_rows(table)["Stanley-EMRAN"] == printed_rows(published()["tables"]["VI"])["Stanley-EMRAN"]
    assert compared(table, False) == compared(table, True) == printed_rows(table)["Stanley-EMRAN"]


# ---------------------------------------------------------------- cases and rows


def test_every_case_and_row_consists_of_scenario_keys():
    known = keys()
    for table in (*TABLES.values(), *BLIND.values()):
        for row in (*rows(table.half), *literal_rows()):
            for case in table.cases:
                given = {**case.given, **case.draws[-1], **tables.NOISE, **row.given}
                assert set(given) <= set(known)
                build(given)


def test_every_controller_has_a_row_of_its_own_or_drives_like_one():
    for half in ("lateral", "longitudinal"):
        drive = [getattr(build(row.given), half) for row in rows(half)]
        assert all(getattr(build({"controller": name}), half) in drive for name in CONTROLLERS)
        others = other_rows(half)
        assert {row.name for row in others} <= set(CONTROLLERS)
        assert len({row.name for row in rows(half)}) == len(rows(half))


def test_pairs_differ_in_the_network_alone():
    listed = {row.name: row for row in pairs()}
    assert {PLAIN.name, OWN, ACCURACY} <= set(listed)
    for row in listed.values():
        alone, aided = build(listed[row.unaided].given), build(row.given)
        assert alone.lateral.emran.authority == 0.0
        assert aided.lateral.emran.authority == float(row.unaided != row.name)
        assert alone.lateral._replace(emran=aided.lateral.emran, K_2=0.0, K_3=0.0) == aided.lateral._replace(
            K_2=0.0, K_3=0.0
        )


def test_unaided_rows_are_rows():
    for half in ("lateral", "longitudinal"):
        names = {row.name for row in rows(half)}
        assert {row.unaided for row in rows(half)} <= names
        assert MAIN in names


def test_cars_of_table_xi_are_all_corners_and_a_latin_hypercube():
    corners, draws = (case.draws for case in TABLES["XI"].cases)
    assert len({tuple(car.values()) for car in corners}) == 16
    assert {car["disturbance.mass_factor"] for car in corners} == {0.8, 1.2}
    assert {car["disturbance.stiffness_rear"] for car in corners} == {0.85, 1.15}
    for key, low, high in (("mass_factor", 0.8, 1.2), ("stiffness_front", 0.85, 1.15)):
        strata = [math.floor(64 * (car[f"disturbance.{key}"] - low) / (high - low)) for car in draws]
        assert sorted(strata) == list(range(64))


def test_table_ii_becomes_rates_with_which_a_filter_of_one_weight_has_its_gains():
    given, period = literal_rows()[2].given, 0.01
    for half in ("lateral", "longitudinal"):
        t = published()["table_II"][half]
        p, r, q = t["P_0"], t["r"], t["q"]
        assert given[f"{half}.emran.rate_initial"] * period == pytest.approx(p / (r + p))
        for _ in range(2000):
            p = p - p * p / (r + p) + q
        assert given[f"{half}.emran.rate_steady"] * period == pytest.approx(p / (r + p), rel=1e-6)


def test_words_for_tables_are_checked():
    assert tables.chosen(["viii", "III"]) == ("III", "VIII")
    assert "timing" not in tables.chosen([])
    with pytest.raises(UserError, match=r'^Unknown table "VIIII"\. Did you mean "VIII"\?$'):
        tables.chosen(["VIIII"])
    with pytest.raises(UserError, match=r"^--delay: found 15 ms; accepted is a whole multiple of 10 ms"):
        tables.condition(delay=15)


def test_files_and_words_that_cannot_be_are_one_sentence(tmp_path):
    with pytest.raises(UserError, match=r"^--json: found .*; accepted is a file in a folder that exists\.$"):
        paper(["VI"], json_file=tmp_path / "nowhere" / "cells.json")
    with pytest.raises(UserError, match=r"^--literal: accepted with the tables III to IX, XI, XII and blind"):
        paper(["memory"], literal=True)


# ---------------------------------------------------------------- results


def holds(found):
    return {(r.table, r.case.name, r.row.name): tables.missed(r, TABLES[r.table].metrics) for r in found}


@pytest.mark.parametrize("name", ["III", "VI"])
def test_what_the_paper_reached_is_beaten_quick(name):
    found = holds(tables.required_results([name], 1))
    assert len(found) == 2
    assert not any(found.values()), found


@pytest.mark.slow
def test_every_required_cell_holds():
    found = holds(tables.required_results())
    assert {name for name, _, _ in found} == set(TABLES)
    assert not any(found.values()), found


@pytest.mark.slow
def test_steering_of_the_network_is_calm_in_every_table():
    drawn = tables.driven_tables(TABLES)
    found = tables.results(drawn, QUIET, False, None)
    for result in found:
        if result.row.name in (MAIN, ACCURACY):
            side = tables.side_values(result, tables.unaided_of(result, found), drawn[result.table].half)
            assert side["command_variation_ratio"] <= 1.5


def test_a_missed_cell_is_named_and_so_is_a_lost_car(lane_change):
    result = next(r for r in lane_change if r.row.name == MAIN)
    metrics = TABLES["VI"].metrics
    worse = result._replace(values={**result.values, "heading_error_rms": 0.01})
    assert tables.missed(worse, metrics) == ["heading_error_rms"]
    lost = result._replace(values=dict.fromkeys(result.values), lost=1)
    assert tables.missed(lost, metrics) == list(metrics)
    assert tables.missed(next(r for r in lane_change if r.row.name == "coupled-base"), metrics) is None


def test_digits_depend_neither_on_the_time_nor_on_the_number_of_processes(lane_change, monkeypatch):
    monkeypatch.setattr(tables, "ALONE", 0)
    again = tables.results(tables.driven_tables(["VI"]), QUIET, False, 2)
    assert again == lane_change


def test_noise_is_averaged_over_three_different_seeds():
    how = tables.condition(noise=True)
    (result,) = (r for r in tables.results(tables.driven_tables(["VI"]), how, False, 1) if r.row.name == "coupled-base")
    assert result.runs == 3
    assert result.worst["cross_track_error_rms"] > result.values["cross_track_error_rms"]


def test_the_paper_word_for_word_is_far_worse_than_the_law_alone():
    alone, norm, signed = tables.results(tables.driven_tables(["VI"]), QUIET, True, 1)
    for result in (norm, signed):
        error = result.values["cross_track_error_rms"]
        assert result.lost or error > 5.0 * alone.values["cross_track_error_rms"]


def test_only_networks_and_observers_remember():
    half, given = memory.CASES["DLC 10 m/s, steering 15 % weak"]
    base, _, _ = memory.repeated(half, {**given, "controller": "coupled-base"})
    assert len(set(base)) == 1
    learned, _, neurons = memory.repeated(half, given)
    assert neurons > 0
    assert learned[-1] < learned[0] < base[0]


# ---------------------------------------------------------------- output


def test_json_has_one_record_per_cell(tmp_path, capsys):
    file = tmp_path / "cells.json"
    paper(["VI"], json_file=file, workers=1)
    cells = json.loads(file.read_text())
    assert all(set(cell) == {"table", "case", "row", "metric", "published", "ours", "ours_unaided"} for cell in cells)
    (cell,) = (c for c in cells if c["row"] == MAIN and c["metric"] == "cross_track_error_max")
    assert cell["published"] == 0.0462
    assert 0.0 < cell["ours"] < 0.0462
    (base,) = (c for c in cells if c["row"] == "coupled-base" and c["metric"] == "cross_track_error_max")
    assert cell["ours_unaided"] == base["ours"]
    shown = capsys.readouterr().out
    assert "T = 14 s at 10 m/s" in shown
    assert f"{cell['ours']:.4f}" in shown
    assert "holds" in shown


def test_sheets_show_published_numbers_and_ratio(lane_change):
    (sheet,) = sheets(tables.driven_tables(["VI"]), lane_change, QUIET)
    lines = {line.cells[0]: line for line in sheet.lines}
    assert lines["published Coupled-EMRAN"].cells[1:] == ("0.0274", "0.0677", "0.0083", "0.0267")
    ours, ratio = lines["pid-stanley"].cells[1].split(" x")
    assert float(ratio) == pytest.approx(float(ours) / 0.0683, abs=0.01)
    widest = [max(len(line.cells[i]) for line in sheet.lines if i < len(line.cells)) for i in range(8)]
    assert sum(np.array(widest) + 1) <= 120


def test_table_xii_shows_which_rows_are_quoted():
    (sheet,) = sheets(
        tables.driven_tables(["XII"]), tables.results(tables.driven_tables(["XII"]), QUIET, False, 1), QUIET
    )
    names = [line.cells[0] for line in sheet.lines]
    assert {"quoted EKF-T2FNN", "quoted ADRC", "published Stanley-EMRAN"} <= set(names)
    assert any("taken" in remark or "literature" in remark for remark in sheet.remarks)


def test_the_add_on_table_says_what_the_network_changes():
    table = ADD_ON["add-on"]._replace(cases=ADD_ON["add-on"].cases[:1])
    found = tables.results({"add-on": table}, QUIET, False, 1)
    (sheet,) = sheets({"add-on": table}, found, QUIET)
    lines = {line.cells[0]: line for line in sheet.lines}
    by_row = {result.row.name: result.values for result in found}
    alone, aided = by_row["coupled-base, accuracy mode"], by_row[ACCURACY]
    change = 100.0 * (aided["cross_track_error_rms"] / alone["cross_track_error_rms"] - 1.0)
    assert lines["coupled-base, accuracy mode"].cells[3] == f"{change:+.0f} %"
    assert change < -50.0
    assert lines["coupled-base, accuracy mode"].good[2]
    assert len(lines) == 1 + len(pairs()) // 2


def test_the_glance_needs_every_lateral_table(lane_change):
    assert overview_sheet(lane_change, QUIET) is None
    found = [
        result._replace(table=table, case=result.case._replace(name=case, draws=(({},) * (1 + view))))
        for table, case, view in GLANCE.values()
        for result in lane_change
    ]
    sheet = overview_sheet(found, QUIET)
    assert sheet is not None
    cells = next(line.cells for line in sheet.lines if line.cells[0] == MAIN)
    value = next(r for r in lane_change if r.row.name == MAIN).values["cross_track_error_rms"]
    assert float(cells[1].split()[0]) == pytest.approx(1e3 * value, abs=0.06)


def test_markdown_marks_what_beats_the_paper():
    lines = (Line("case", ("nominal",)), Line("ours", ("a", "0.1 x0.50", "0.3 x1.50"), (True, False)))
    text = sheet_text(Sheet("Title", ("", "rms", "max"), lines, ("Remark.",)))
    assert "| **nominal** |  |  |\n| a | **0.1 x0.50** | 0.3 x1.50 |" in text
    assert text.endswith("Remark.\n")


def test_every_chapter_of_the_document_has_its_prose():
    names = ("tables", "literal", "memory", "memory under noise", "blind", "noise", "delay", "delay 20", "timing")
    text = document([(name, []) for name in names])
    assert text.startswith("<!-- Written by")
    assert "## The tables" in text
    assert "## Computing time" in text


def test_the_network_that_is_made_to_fill_up_does():
    """At one speed there is nothing to tell apart for the other one."""
    assert scores(drive_track(build({**dlc(10.0, 14.0), **timing.FULL})))["neurons_steering_max"] == 40
