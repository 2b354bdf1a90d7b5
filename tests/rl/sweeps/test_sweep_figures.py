"""What a sweep says of its seeds: seeds as words, interquartile means, intervals, tables; by a second route."""

import numpy as np
import pytest
from scipy import stats

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.sweeps.aggregates import describe_scores, interquartile_mean, stratified_interval
from nerf_rl.rl.sweeps.seed_list import parse_seeds
from nerf_rl.rl.sweeps.summary import summarise
from nerf_rl.rl.sweeps.table import aligned, describe_summary, seeds_table
from nerf_rl.rl.training.evaluation_results import EVALUATIONS


def run_of(seed: int, rates: list[float], good: int | None = None) -> dict:
    """A run as it is read from its folder, evaluated every 1,000 steps, 4 steps late."""
    evaluations = [
        {"due": 1000 * number, "env_steps": 1000 * number + 4, "episodes": 20, "mean_return": 500.0 - seed}
        | {"success_rate": rate, "ci_low": max(0.0, rate - 0.1), "ci_high": min(1.0, rate + 0.1)}
        for number, rate in enumerate(rates, 1)
    ]
    first = None if good is None else {"env_steps": good, "seconds": good / 100}
    facts = {"env_steps": 3004, "episodes": 15, "updates": 1500, "seconds": 31.0, "good": first}
    return {"seed": seed, "run": f"seed-{seed}", **facts, "evaluations": evaluations}


@pytest.mark.parametrize(
    ("words", "seeds"),
    [("0..3", [0, 1, 2, 3]), ("5,3,0", [0, 3, 5]), ("7", [7]), ("0..1, 9,4..5", [0, 1, 4, 5, 9])],
)
def test_seeds_are_ranges_and_single_ones(words: str, seeds: list[int]):
    assert parse_seeds(words) == seeds


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("0...3", "--seeds takes seeds such as 0..19 or 0,3,5, got '0...3'"),
        ("-1..3", "--seeds takes seeds such as 0..19 or 0,3,5, got '-1..3'"),
        ("0,,3", "--seeds takes seeds such as 0..19 or 0,3,5, got '0,,3'"),
        ("9..2", "--seeds 9..2 ends before it begins; write 2..9"),
        ("0..4,3", "--seeds names seed 3 twice"),
        ("0..999999999999", "--seeds must be from 0 to 4294967295, got 999999999999"),
        ("0..4294967295", "--seeds names more than 1000 seeds; use several sweeps"),
    ],
)
def test_what_are_no_seeds_is_told_in_a_sentence(
    words: str, sentence: str, capsys: pytest.CaptureFixture[str], tmp_path
):
    assert cli.main(["train-rl", "--out", str(tmp_path / "x"), f"--seeds={words}"]) == 2
    assert capsys.readouterr().err == f"nerf-rl train-rl: {sentence}\n"
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"seeds": "0..3", "seed": 4}, "--seeds 0..3 leaves no room for --seed 4"),
        ({"seeds": "0..3", "workers": 0}, "--workers must be at least 1, got 0"),
        ({"seeds": "0..3", "backend": "rai"}, "did you mean ray"),
    ],
)
def test_keys_that_contradict_each_other_are_refused(keys: dict, sentence: str):
    with pytest.raises(UserError, match=sentence):
        TrainRLConfig("out", **keys)


@pytest.mark.parametrize("shape", [(1, 1), (2, 1), (5, 1), (20, 1), (7, 3), (10, 8)])
def test_the_interquartile_mean_is_scipys(shape: tuple[int, int]):
    scores = np.random.default_rng(1).normal(size=(4, *shape))
    found = interquartile_mean(scores)
    assert found.shape == (4,)
    expected = [stats.trim_mean(table, proportiontocut=0.25, axis=None) for table in scores]
    assert np.allclose(found, expected, rtol=1e-12)


def test_the_interval_is_that_of_drawing_runs_within_each_task_one_by_one():
    rng = np.random.default_rng(2)
    scores = rng.normal(size=(6, 2)) + np.array([0.0, 10.0])  # tasks so far apart that mixing them would show
    means = []
    for _ in range(4000):
        drawn = np.stack([rng.choice(scores[:, task], 6) for task in range(2)], axis=1)
        means.append(stats.trim_mean(drawn, 0.25, axis=None))
    expected = np.percentile(means, [2.5, 97.5])
    assert np.allclose(stratified_interval(scores), expected, atol=0.08)
    assert stratified_interval(scores) == stratified_interval(scores)


def test_the_interval_holds_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(3)
    held = 0
    for _ in range(200):
        low, high = stratified_interval(rng.normal(size=(40, 1)), repetitions=400)
        held += low <= 0.0 <= high
    assert 0.88 < held / 200 < 0.99


def test_one_seed_has_no_interval():
    assert describe_scores([0.4])["iqm_low"] is None
    assert describe_scores([0.4, 0.4])["iqm_low"] == 0.4


def test_seeds_are_summed_up_at_the_steps_at_which_their_evaluations_were_due():
    runs = [run_of(3, [0.0, 1.0, 1.0], 2004), run_of(0, [0.5, 0.9, 0.9]), run_of(1, [0.0, 0.0, 1.0], 3004)]
    summary = summarise(runs)
    assert [run["seed"] for run in summary["runs"]] == [0, 1, 3]
    assert summary["score"] == "success_rate"
    assert [(point["env_steps"], point["seeds"]) for point in summary["curve"]] == [(1000, 3), (2000, 3), (3000, 3)]
    assert summary["curve"][1]["iqm"] == pytest.approx((0.0 + 0.9 + 1.0) / 3)  # of three none is trimmed
    good = summary["good_seeds"]
    assert (good["count"], good["seeds"]) == (2, 3) and 0.2 < good["low"] < 2 / 3 < good["high"] < 0.95
    heads, rows = seeds_table(summary)
    assert heads[:4] == ["seed", "1,000", "2,000", "3,000"]
    assert rows[0] == ["0", "50%", "90%", "90%", "90% [80%, 100%]", "-", "-", "1,500", "31"]
    assert rows[2][5:7] == ["2,004", "20"]
    assert len({len(line) for line in aligned(heads, rows).split("\n")}) == 1
    assert "2 of 3 at 95% or more" in describe_summary(summary)


def test_seeds_that_end_at_steps_of_their_own_have_a_curve_where_all_were_evaluated():
    runs = [run_of(seed, [rate] * 3) for seed, rate in enumerate((0.2, 0.2, 0.2, 1.0))]
    for run, end in zip(runs, (2502, 2550, 2600, 2600), strict=True):  # as by --episodes
        run["evaluations"][-1]["due"] = end
    summary = summarise(runs)
    assert [(point["env_steps"], point["seeds"]) for point in summary["curve"]] == [(1000, 4), (2000, 4)]
    assert {point["iqm"] for point in summary["curve"]} == {0.2} and summary["final"]["seeds"] == 4
    heads, rows = seeds_table(summary)
    assert heads[:4] == ["seed", "1,000", "2,000", "final, 95 % interval"] and rows[3][1:3] == ["100%", "100%"]


def test_where_nothing_tells_of_success_returns_are_summed_up():
    runs = [run_of(seed, [0.0, 0.0]) for seed in (0, 1)]
    for run in runs:
        run["evaluations"] = [
            {key: e[key] for key in ("due", "env_steps", "episodes", "mean_return")} for e in run["evaluations"]
        ]
    summary = summarise(runs)
    assert summary["score"] == "mean_return" and summary["good_seeds"] is None
    assert summary["final"]["iqm"] == 499.5
    heads, rows = seeds_table(summary)
    assert heads == ["seed", "1,000", "2,000", "final return", "updates", "seconds"] and rows[1][3] == "499"
    assert describe_summary(summary).startswith("return at the end: interquartile mean 499.5 [499, 500] of 2 seeds")


def test_a_long_run_has_columns_for_some_evaluations_and_for_the_last():
    summary = summarise([run_of(0, [0.1] * 37), run_of(1, [0.2] * 37)])
    heads, rows = seeds_table(summary)
    assert len(heads) == len(rows[0]) == 1 + 10 + 5 and heads[10] == "37,000"
    assert len(summary["curve"]) == 37


def test_returns_may_be_of_any_size():
    evaluation = {"env_steps": 10, "episodes": 1, "mean_return": -3e15}
    EVALUATIONS([evaluation], "")
    with pytest.raises(ValueError, match="mean_return is inf"):
        EVALUATIONS([{**evaluation, "mean_return": float("inf")}], "")
