import math
import re

import numpy as np
import pytest
from rerun.chunk import RrdReader

from emran_sumo.errors import UserError
from emran_sumo.loop import AT
from emran_sumo.paper import tables
from emran_sumo.paper.command import paper
from emran_sumo.paper.drawing import draw
from emran_sumo.paper.figures import RECORDING, bands, cases_of, chosen, driven_cases, write_figures
from emran_sumo.paper.plates import PLATES
from emran_sumo.paper.tables import Condition
from emran_sumo.print_style import image

# what each figure with data shows in the paper, by its number: words of its caption and of its panels
PAPER = {
    5: ("cruise", "speed", "error", "without disturbance"),
    6: ("neurons", "cruise"),
    7: ("cruise", "speed", "error", "grades"),
    8: ("neurons", "grades"),
    9: ("double lane change", "10 m/s", "path", "cross-track error"),
    10: ("double lane change", "10 m/s", "heading", "error"),
    11: ("yaw rate", "lateral velocity"),
    12: ("10 m/s", "1500 N", "cross-track error", "heading error"),
    13: ("steering", "double lane change"),
    14: ("neurons", "steering", "10 m/s"),
    15: ("20 m/s", "cross-track error", "heading error"),
    16: ("20 m/s", "gust", "cross-track error", "heading error"),
}
ERRORS = ("cross_track_error", "heading_error", "speed_error")


@pytest.fixture(scope="module")
def driven():
    return driven_cases(PLATES)


@pytest.mark.parametrize("number", PAPER)
def test_every_figure_with_data_of_the_paper_is_drawn(number):
    (plate,) = (plate for plate in PLATES if plate.number == number)
    text = " ".join((plate.caption, *(panel.words for panel in plate.panels))).lower()
    assert all(words.lower() in text for words in PAPER[number])
    assert plate.stem.startswith(f"fig{number:02d}_")
    assert all(re.search(r"\(.+\)", panel.axis) or panel.steps for panel in plate.panels), "a unit on every axis"


def test_no_figure_is_drawn_that_the_paper_does_not_have():
    assert [plate.number for plate in PLATES] == sorted(PAPER)


@pytest.mark.parametrize("table", ["III", "VI", "VIII"])
def test_errors_in_a_figure_are_the_cells_of_its_table(table, driven):
    found = tables.results(tables.driven_tables([table]), Condition(), False, 1)
    cells = {(r.case.name, r.row.name): r for r in found}
    compared = 0
    for plate in chosen([table]):
        figure = draw(plate, cases_of(plate, driven))
        grid = iter(figure.axes)
        for case in plate.cases:
            for panel in plate.panels:
                axes = next(grid)
                if panel.column not in ERRORS:
                    continue
                lines = {line.get_label(): line.get_ydata() for line in axes.get_lines() if line.get_label()[0] != "_"}
                assert set(lines) == set(plate.rows)
                for row, values in lines.items():
                    result = cells[case, row]
                    if not result.lost:
                        assert math.sqrt(np.mean(np.square(values))) == pytest.approx(
                            result.values[f"{panel.column}_rms"], rel=1e-9
                        )
                        assert np.abs(values).max() == pytest.approx(result.values[f"{panel.column}_max"], rel=1e-9)
                        compared += 1
    assert compared >= 6


def test_who_is_lost_in_a_table_is_lost_in_its_figure(driven):
    found = tables.results(tables.driven_tables(["VIII"]), Condition(), False, 1)
    (plate,) = chosen(["VIII"])
    for case in cases_of(plate, driven):
        lost = {r.row.name for r in found if r.case.name == case.name and r.lost and r.row.name in plate.rows}
        assert set(case.lost) == lost
        assert lost
    words = [text.get_text() for axes in draw(plate, cases_of(plate, driven)).axes for text in axes.texts]
    assert any("pid-stanley: lost at" in text for text in words)


def test_disturbances_are_shaded_where_they_act(driven):
    hills = bands(driven["IV", "transitions 0.3 s", "coupled-emran"].trace)
    assert [band.words for band in hills] == ["+40°", "\N{MINUS SIGN}40°"]
    edges = [time for band in hills for time in (band.start, band.end)]
    assert edges == pytest.approx([10.15, 20.15, 30.15, 40.15], abs=0.02)  # halfway through 0.3 s
    (force,) = bands(driven["VII", "+1500 N", "coupled-emran"].trace)
    assert (force.words, force.start) == ("1.5 kN from the right", pytest.approx(0.0, abs=0.02))
    assert bands(driven["VI", "nominal", "coupled-emran"].trace) == ()


def test_figures_fit_a_column_with_letters_that_can_be_read(driven):
    for plate in PLATES:
        figure = draw(plate, cases_of(plate, driven))
        image(figure, "svg")
        assert figure.get_figwidth() in (3.4, 7.0)
        letters = [
            text for axes in figure.axes for text in (*axes.texts, axes.title, axes.xaxis.label, axes.yaxis.label)
        ]
        letters += [text for legend in figure.legends for text in legend.get_texts()]
        letters += [label for axes in figure.axes for label in (*axes.get_xticklabels(), *axes.get_yticklabels())]
        assert min(text.get_fontsize() for text in letters) >= 7.0
        (legend,) = figure.legends
        box = legend.get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1


def test_lines_differ_in_dashes_or_width_as_well_as_in_color(driven):
    for plate in PLATES:
        for axes in draw(plate, cases_of(plate, driven)).axes:
            lines = [line for line in axes.get_lines() if line.get_label()[0] != "_"]
            assert len({line.get_color() for line in lines}) == len(lines)
            assert len({(str(line._dash_pattern), line.get_linewidth()) for line in lines}) == len(lines)


def test_the_same_figure_is_the_same_file(driven):
    plate = PLATES[4]
    first, second = (image(draw(plate, cases_of(plate, driven)), "svg") for _ in range(2))
    assert first == second
    assert b"<dc:date>" not in first


def test_the_recording_holds_every_panel_with_the_signals_of_the_runs(tmp_path, driven):
    files = write_figures(tmp_path / "new", chosen(["VI"]))
    assert {file.name for file in files} == {file.name for file in (tmp_path / "new").iterdir()}
    assert {file.suffix for file in files} == {".png", ".svg", ".md", ".rrd"}
    values: dict[str, list[np.ndarray]] = {}
    for chunk in RrdReader(str(tmp_path / "new" / RECORDING)).stream():
        batch = chunk.to_record_batch()
        if "Scalars:scalars" in batch.schema.names:
            values.setdefault(str(chunk.entity_path), []).append(batch["Scalars:scalars"].flatten().to_numpy())
    for plate in chosen(["VI"]):
        for panel in plate.panels:
            mine = [path for path in values if path.startswith(f"/{plate.stem}/nominal/{panel.column}/")]
            assert len(mine) == len(plate.rows) + bool(panel.reference)
    trace = driven["VI", "nominal", "pid-stanley"].trace
    shown = np.concatenate(values["/fig09_lane_change_path/nominal/cross_track_error/0_pid_stanley"])
    every_second = np.rint(trace[:, AT.time] * 1e3).astype(int) % 20 == 0
    assert np.array_equal(shown, trace[every_second, AT.cross_track_error])


def test_wrong_folders_and_tables_are_one_sentence(tmp_path):
    file = tmp_path / "file"
    file.touch()
    for folder in (file, file / "below"):
        with pytest.raises(UserError, match=r"^--figures: cannot write to .*; accepted is a folder, new or not\.$"):
            paper([], figures=folder)
    with pytest.raises(UserError, match=r"^--figures: found memory; accepted are the tables III, IV, VI"):
        paper(["memory"], figures=tmp_path)
    with pytest.raises(UserError, match=r"^--figures: writes the figures instead of the tables"):
        paper([], figures=tmp_path, noise=True)
