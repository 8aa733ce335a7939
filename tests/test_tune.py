"""Tuning: the searches, the fitness, checkpoints, tuning files and what `run` makes of a result."""

import json
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from emran_sumo import checkpoint, cli, search, shipped
from emran_sumo import tune as tuner
from emran_sumo.errors import UserError
from emran_sumo.scenario import checked, values_in
from emran_sumo.tune import LOST, Plan, cost, ride, tune, units_of
from emran_sumo.tuning import decode, encode, find_file, read

ROOT = Path(__file__).parent.parent
TINY = """
title = "Two short runs"
[set]
world = "track"
duration = 1.0
disturbance.lateral_force = 800.0
[fitness]
reference = "coupled-base"
[fitness.terms]
cross_track_error_rms = 1.0
steer_variation = 0.5
[genes]
lateral.gain = { low = 0.5, high = 12.0, scale = "log", start = 3.0 }
lateral.emran.window = { low = 5, high = 20, scale = "integer" }
lateral.emran.error_learn = { low = 0.0002, high = 0.005, scale = "log", start = 0.001 }
lateral.emran.error_delete = { low = 0.05, high = 1.0, share_of = "lateral.emran.error_learn", start = 0.5 }
[[cases]]
name = "slow"
[[cases]]
name = "fast"
track.speed = 15.0
weight = 0.5
"""
PLAN = Plan("ga", 1, 3, 4, 1)


@pytest.fixture
def tiny(tmp_path):
    file = tmp_path / "tiny.toml"
    file.write_text(TINY)
    return file


def bowl(points):
    """Squared distance from a place near a corner of the unit cube."""
    return np.square(points - np.array((0.83, 0.21, 0.64))).sum(axis=1)


def searched(method, generations, population, seed=1):
    start = np.full(3, 0.4)
    asking = search.search(method, start, float(bowl(start[None])[0]), seed, population)
    points, seen = next(asking), []
    for _ in range(generations):
        seen.append(points)
        points = asking.send(bowl(points))
    return np.vstack(seen)


def test_ranking_follows_the_published_formula():
    p = search.ranking(20)
    # q / (1 - (1 - q)^n) = 0.08 / (1 - 0.92^20), and the worst has 0.92^19 of it
    assert p[0] == pytest.approx(0.0986, abs=5e-5)
    assert p[-1] == pytest.approx(0.0202, abs=5e-5)
    assert p.sum() == pytest.approx(1.0)
    assert np.allclose(p[1:] / p[:-1], 1 - search.SELECTION)


def test_latin_hypercube_has_one_point_in_every_slice_of_every_axis():
    points = search.hypercube(19, 5, seed=3)
    for axis in points.T:
        assert sorted(np.floor(axis * 19).astype(int)) == list(range(19))


@pytest.mark.parametrize(("method", "generations", "population", "near"), [("ga", 30, 20, 0.05), ("cma", 40, 10, 1e-4)])
def test_search_finds_the_bottom_of_a_bowl(method, generations, population, near):
    points = searched(method, generations, population)
    assert len(points) == generations * population
    assert np.all((points >= 0) & (points <= 1))
    assert np.sqrt(bowl(points).min()) < near


@pytest.mark.parametrize("method", search.METHODS)
def test_search_depends_on_its_seed_alone(method):
    first = searched(method, 4, 8)
    assert np.array_equal(first, searched(method, 4, 8))
    assert not np.array_equal(first, searched(method, 4, 8, seed=2))


def test_first_population_of_the_ga_holds_the_start():
    assert any(np.array_equal(point, np.full(3, 0.4)) for point in searched("ga", 1, 20))


def test_both_methods_have_the_same_budget():
    assert search.BUDGET["ga"] == (10, 20)
    assert {generations * population for generations, population in search.BUDGET.values()} == {200}


def test_start_values_are_decoded_as_they_are_written(tiny):
    genes = read(tiny).genes
    values = decode(genes, encode(genes))
    assert values == {
        "lateral.gain": 3.0,
        "lateral.emran.window": 14,  # the default
        "lateral.emran.error_learn": 0.001,
        "lateral.emran.error_delete": 0.0005,
    }


def test_ends_of_the_unit_cube_are_the_bounds_and_shares_never_pass_their_whole(tiny):
    genes = read(tiny).genes
    assert decode(genes, np.zeros(4)) == dict(zip(values_of(genes), (0.5, 5, 0.0002, 0.00001), strict=True))
    assert decode(genes, np.ones(4)) == dict(zip(values_of(genes), (12.0, 20, 0.005, 0.005), strict=True))
    for point in search.hypercube(50, 4, seed=1):
        values = decode(genes, point)
        assert values["lateral.emran.error_delete"] <= values["lateral.emran.error_learn"]
        assert isinstance(values["lateral.emran.window"], int)


def values_of(genes):
    return [gene.key for gene in genes]


def test_middle_of_a_log_scale_is_the_geometric_mean(tiny):
    genes = read(tiny).genes
    assert decode(genes, np.full(4, 0.5))["lateral.gain"] == pytest.approx(np.sqrt(0.5 * 12), rel=1e-4)


def test_the_reference_costs_one(tiny):
    tiny.write_text(
        TINY.replace("start = 3.0", "start = 3.3585").replace("[set]", '[set]\ncontroller = "coupled-base"')
    )
    tuning = read(tiny)
    begin = decode(tuning.genes, encode(tuning.genes))
    assert cost(tuning, units_of(tuning), begin) == pytest.approx(1.0)


def test_cost_is_the_weighted_mean_of_weighted_terms_over_their_units(tiny):
    tuning = read(tiny)
    units = units_of(tuning)
    values = decode(tuning.genes, encode(tuning.genes))
    parts = []
    for case, unit in zip(tuning.cases, units, strict=True):
        found = ride({**case.given, **values})
        parts.append(
            (found["cross_track_error_rms"] / unit["cross_track_error_rms"]
             + 0.5 * found["steer_variation"] / unit["steer_variation"]) / 1.5
        )  # fmt: skip
    assert cost(tuning, units, values) == pytest.approx((parts[0] + 0.5 * parts[1]) / 1.5)


def test_a_lost_car_costs_more_the_earlier_it_is_lost(tiny):
    tuning = read(tiny)
    units = units_of(tuning)
    costs = []
    for force in (15_000.0, 20_000.0):
        pushed = [
            case._replace(given={**case.given, "disturbance.lateral_force": force, "duration": 5.0})
            for case in tuning.cases
        ]
        one = tuning._replace(cases=tuple(pushed[:1]))
        driven = ride(pushed[0].given)
        assert not driven["ended"]
        costs.append(cost(one, units[:1], {}))
        assert costs[-1] == pytest.approx(LOST + 1 - driven["driven"] / 5.0)
    assert costs[0] < costs[1] < LOST + 1


class Stop:
    """Progress that interrupts after `runs` evaluations."""

    def __init__(self, runs):
        self.runs = runs

    def __call__(self, step):
        if step.driven >= self.runs:
            raise KeyboardInterrupt


@pytest.mark.parametrize("method", search.METHODS)
def test_an_interrupted_search_ends_like_an_undisturbed_one(tiny, tmp_path, method):
    plan = PLAN._replace(method=method)
    whole, broken = tmp_path / "whole.toml", tmp_path / "broken.toml"
    tune(tiny, whole, plan, "command")
    with pytest.raises(KeyboardInterrupt):
        tune(tiny, broken, plan, "command", Stop(6))
    assert not broken.exists()
    kept = checkpoint.checkpoint_file(broken)
    with kept.open("ab") as stream:
        stream.write(b'{"generation": 2, "co')  # a kill in the middle of a line
    result = tune(tiny, broken, plan, "command")
    assert 0 < result.step.driven < result.step.evaluations == 12
    assert broken.read_text() == whole.read_text()
    assert kept.read_text() == checkpoint.checkpoint_file(whole).read_text()
    assert tune(tiny, broken, plan, "command").step.driven == 0


def test_more_generations_continue_a_finished_search(tiny, tmp_path):
    out = tmp_path / "out.toml"
    short = tune(tiny, out, PLAN._replace(generations=2), "command")
    longer = tune(tiny, out, PLAN, "command")
    assert longer.step.driven <= 4 < short.step.driven
    tune(tiny, tmp_path / "fresh.toml", PLAN, "command")
    assert out.read_text() == (tmp_path / "fresh.toml").read_text()


def test_the_result_does_not_depend_on_the_number_of_workers(tiny, tmp_path):
    files = [tmp_path / f"{workers}.toml" for workers in (1, 2)]
    for workers, file in enumerate(files, start=1):
        tune(tiny, file, PLAN._replace(workers=workers), "command")
    assert files[0].read_text() == files[1].read_text()


def test_a_search_never_ends_worse_than_it_began_and_writes_what_it_measured(tiny, tmp_path):
    out = tmp_path / "out.toml"
    tuned = tune(tiny, out, PLAN, "a command")
    assert tuned.step.best <= tuned.step.start
    tuning = read(tiny)
    written = values_in(out)
    assert cost(tuning, units_of(tuning), written) == tuned.step.best
    head = out.read_text()
    for word in ("a command", "ga", "seed 1", "12 evaluations", f"{tuned.step.best:.6g}", tuner.__version__):
        assert word in head


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda file, _: file.write_text(TINY.replace("weight = 0.5", "weight = 0.6")), "tuning file has changed"),
        (lambda _, patch: patch.setattr(tuner, "__version__", "9.9"), "version: found .*, now 9.9"),
        (lambda _, patch: patch.setattr(tuner, "sources", lambda: "other"), "package has changed"),
    ],
)
def test_a_checkpoint_of_another_search_is_named(tiny, tmp_path, monkeypatch, change, named):
    out = tmp_path / "out.toml"
    tune(tiny, out, PLAN._replace(generations=1), "command")
    change(tiny, monkeypatch)
    with pytest.raises(UserError, match=f"out.checkpoint.jsonl: .*{named}"):
        tune(tiny, out, PLAN, "command")


def test_another_seed_or_population_does_not_continue(tiny, tmp_path):
    out = tmp_path / "out.toml"
    tune(tiny, out, PLAN._replace(generations=1), "command")
    for other in (PLAN._replace(seed=2), PLAN._replace(population=5)):
        with pytest.raises(UserError, match=r"seed: found 1, now 2|population: found 4, now 5"):
            tune(tiny, out, other, "command")
    checkpoint.checkpoint_file(out).write_text("no search\n")
    with pytest.raises(UserError, match="is no checkpoint"):
        tune(tiny, out, PLAN, "command")


BAD = {
    "unknown table": ("[set]", "[sets]", 'unknown key "sets.* Did you mean "set"'),
    "unknown gene": ("lateral.gain =", "lateral.gian =", 'lateral.gian.*Did you mean "lateral.gain"'),
    "gene that is text": ("lateral.gain =", "controller =", "genes.controller: found a key that is no number"),
    "unknown part": ("high = 12.0", "heigh = 12.0", 'unknown part "heigh".*"high"'),
    "no bound": ("low = 0.5, ", "", "genes.lateral.gain.low: found 'nothing'; accepted is a number"),
    "bound that is text": ("low = 0.5", 'low = "a"', "genes.lateral.gain.low: found 'a'; accepted is a number"),
    "bounds the wrong way": ("high = 12.0", "high = 0.1", "found low 0.5, high 0.1; accepted is low < high"),
    "beyond what the key accepts": ("high = 12.0", "high = 99.0", "genes.lateral.gain.high: .*found 99.0.*to 50 1/s"),
    "log of zero": ("low = 0.5", "low = 0.0", "genes.lateral.gain.low: found 0; accepted on a log scale"),
    "scale": ('"log", start = 3.0', '"cubic"', "genes.lateral.gain.scale: found 'cubic'; accepted is linear or log"),
    "half a sample": ("low = 5,", "low = 5.5,", "window.low: found 5.5; accepted on this scale is a whole number"),
    "start outside": ("start = 3.0", "start = 30.0", "found the start 30; accepted is one from 0.5 to 12"),
    "share of nothing": ('share_of = "lateral.emran.error_learn"', 'share_of = "lateral.x"', "found 'lateral.x'"),
    "gene set by a case": ("track.speed = 15.0", "lateral.gain = 3.0", 'case "fast": sets lateral.gain'),
    "unknown key of a case": ("track.speed", "track.sped", 'case "fast": unknown key "track.sped". Did you mean'),
    "value of a case": ("track.speed = 15.0", "track.speed = 900.0", 'case "fast": track.speed: found 900.0'),
    "not on the bench": ('world = "track"', 'world = "sumo"', 'world: found "sumo"; accepted is "track"'),
    "two of one name": ('name = "fast"', 'name = "slow"', "name of case 2: found 'slow'"),
    "no name": ('name = "fast"\n', "", "name of case 2: found nothing"),
    "no cases": ("[[cases]]", "[[others]]", "unknown key|cases: found nothing"),
    "negative weight": ("weight = 0.5", "weight = -1.0", 'case "fast": weight: found -1.0'),
    "unknown score": ("steer_variation", "steer_variance", 'unknown score "steer_variance". Did you mean'),
    "weights of zero": ("= 1.0\nsteer_variation = 0.5", "= 0.0", "found only zeros"),
    "unknown reference": ('"coupled-base"', '"coupled-bass"', "fitness.reference: found 'coupled-bass'"),
    "no TOML": ("[set]", "[set", "not valid TOML"),
}


@pytest.mark.parametrize("mistake", BAD)
def test_a_mistake_in_a_tuning_file_is_one_sentence(tiny, mistake):
    old, new, sentence = BAD[mistake]
    assert old in TINY
    tiny.write_text(TINY.replace(old, new))
    with pytest.raises(UserError, match=sentence) as caught:
        read(tiny)
    assert "tiny.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_case_may_begin_from_a_shipped_scenario(tiny):
    tiny.write_text(TINY.replace('name = "fast"', 'name = "fast"\nscenario = "track_dlc"'))
    assert read(tiny).cases[1].given["track.shape"] == "double_lane_change"


def test_a_term_without_a_unit_is_named(tiny):
    tiny.write_text(TINY.replace("steer_variation", "neurons_steering_max"))
    with pytest.raises(UserError, match='case "slow": neurons_steering_max of the reference coupled-base is 0'):
        units_of(read(tiny))


def test_missing_packages_are_named(monkeypatch):
    monkeypatch.setattr(search, "find_spec", lambda _: None)
    with pytest.raises(UserError, match=r'pymoo and cma, not installed here: pip install "emran-sumo\[tune\]"'):
        search.need_packages()


def typed(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["emran-sumo", *map(str, words)])
    try:
        cli.main()
    except SystemExit as end:
        if end.code:
            raise


def test_run_takes_set_files_below_flags_and_set(tmp_path, monkeypatch):
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text('controller = "coupled-base"\nduration = 9.0\n[lateral]\ngain = 2.0\nsoftening = 1.0\n')
    second.write_text("[lateral]\nsoftening = 2.0\nyaw_damping = 0.1\n[lateral.emran]\nwindow = 9\n")
    typed(
        monkeypatch, "run", "track_dlc", "--set-file", first, "--set-file", second, "--duration", "0.3",
        "--set", "lateral.yaw_damping=0.05", "--no-record", "--out", tmp_path / "runs",
    )  # fmt: skip
    (file,) = (tmp_path / "runs").rglob("summary.json")
    used = find_key(json.loads(file.read_text()), "lateral")
    assert (used["gain"], used["softening"], used["yaw_damping"]) == (2.0, 2.0, 0.05)
    assert used["emran"]["window"] == 9
    assert used["emran"]["authority"] == 0.0  # coupled-base, from the first file
    assert find_key(json.loads(file.read_text()), "track")["shape"] == "double_lane_change"
    assert find_key(json.loads(file.read_text()), "scenario")["duration"] == 0.3


def find_key(tree, key):
    """The table of that name, wherever it lies."""
    if key in tree and isinstance(tree[key], dict):
        return tree[key]
    found = [find_key(value, key) for value in tree.values() if isinstance(value, dict)]
    return next((one for one in found if one is not None), None)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("[lateral]\ngian = 2.0\n", 'set.toml: unknown key "lateral.gian". Did you mean "lateral.gain"?'),
        ("[lateral]\ngain = 200.0\n", "set.toml: lateral.gain: found 200.0; accepted is a number from 0 to 50 1/s."),
        ("[lateral\n", "set.toml: not valid TOML"),
    ],
)
def test_a_mistake_in_a_set_file_is_one_sentence(tmp_path, monkeypatch, capsys, content, sentence):
    (tmp_path / "set.toml").write_text(content)
    with pytest.raises(SystemExit) as caught:
        typed(monkeypatch, "run", "track_dlc", "--set-file", tmp_path / "set.toml", "--out", tmp_path)
    assert caught.value.code == 2
    assert sentence in capsys.readouterr().err


def test_tune_on_the_command_line_writes_a_result_that_run_takes(tiny, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    typed(monkeypatch, "tune", tiny, "--generations", 2, "--population", 4, "--seed", 3, "--workers", 1)
    result = tmp_path / "runs/tuning/tiny-ga-seed3.toml"
    shown = capsys.readouterr()
    assert "--set-file runs/tuning/tiny-ga-seed3.toml" in shown.out
    assert "generation 2 of 2: 8 of 8" in shown.err
    with result.open("rb") as stream:
        assert set(tomllib.load(stream)) == {"lateral"}
    typed(monkeypatch, "run", "track_dlc", "--set-file", result, "--duration", "0.3", "--no-record")


def test_an_interrupt_says_how_to_continue(tiny, tmp_path, monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(tuner, "units_of", interrupted)
    with pytest.raises(SystemExit) as caught:
        typed(monkeypatch, "tune", tiny, "--out", tmp_path / "x.toml")
    assert caught.value.code == 130
    assert "x.checkpoint.jsonl, and the same command continues" in capsys.readouterr().err


def test_shipped_tuning_files_are_no_scenarios_and_look_at_no_published_case():
    assert "tuning" not in shipped.scenarios()
    for name in ("lateral", "longitudinal"):
        for case in read(find_file(name)).cases:
            given = case.given
            assert max(given.get("track.speed", 10), *given.get("track.speed_values", (0,))) <= 16
            assert abs(given.get("disturbance.lateral_force", 0)) <= 800
            assert abs(given.get("disturbance.grade_pulse", 0)) <= np.deg2rad(5.01)
            assert not any("gust" in key or "draw" in key or "amplitude" in key for key in given)
    with pytest.raises(UserError, match='Did you mean "lateral"'):
        find_file("latral")


@pytest.mark.parametrize("name", ["lateral", "longitudinal"])
def test_shipped_results_hold_the_genes_of_their_file_within_the_bounds(name):
    file = ROOT / "scenarios/tuning" / f"{name}.result.toml"
    written = values_in(file)
    genes = {gene.key: gene for gene in read(find_file(name)).genes}
    assert set(written) == set(genes)
    checked(written, dict.fromkeys(written, str(file)), str(file))
    for key, gene in genes.items():
        whole = written[gene.share_of] if gene.share_of else 1.0
        assert gene.low * whole <= written[key] * (1 + 1e-4)
        assert written[key] <= gene.high * whole * (1 + 1e-4)
