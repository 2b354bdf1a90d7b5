"""nerf-rl tune from end to end on a tiny search, and its mistakes by the words of their answers."""

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import NoReturn

import optuna
import pytest
from optuna.distributions import BaseDistribution
from optuna.trial import TrialState

from nerf_rl import cli
from nerf_rl.tuning.recipe import check_space, start_values, trial_config
from nerf_rl.tuning.tune import _remove_lost_runs, trials_of
from nerf_rl.tuning.worker import Task

ROOT = Path(__file__).parents[2]

TINY = """
overrides:
  env_steps: 160
  warmup_steps: 40
  episode_steps: 20
  learner.batch_size: 8
  evaluation_every: 80
  evaluation_episodes: 2
  final_evaluation_episodes: 2
  replay.capacity: 500
  network.hidden: [16, 16]
space:
  learner.actor_rate: {low: 1.0e-5, high: 1.0e-2, log: true}
  network.hidden.1: {low: 8, high: 32, integer: true}
  network.normalisation: {choices: [layer, none]}
whale: {population: 2}
trials: 2
"""


@pytest.fixture(scope="module")
def recipe(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("recipe") / "tune.yaml"
    path.write_text(TINY)
    return str(path)


def test_a_search_leaves_what_it_promises_and_goes_on(
    recipe: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tune"
    assert cli.main(["tune", "--config", recipe, "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "trial 0 (generation 0, whale 0): " in shown and "2/2 trials" in shown
    names = {path.name for path in out.iterdir()}
    promised = {"config.yaml", "provenance.json", "study.journal", "trials.csv", "best.yaml", "history.png"}
    assert names == promised | {"summary.json", "logs"}
    summary = json.loads((out / "summary.json").read_text())
    assert summary["trials"] == {"complete": 2, "pruned": 0, "failed": 0} and summary["env_steps"] == 320
    with open(out / "trials.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert (rows[0]["learner.actor_rate"], rows[0]["network.hidden.1"]) == ("0.0003", "16")
    assert [row["env_steps"] for row in rows] == ["160", "160"]
    assert float(rows[summary["best_trial"]]["value"]) == summary["best_value"]

    assert cli.main(["tune", "--config", recipe, "--out", str(out)]) == 2
    assert "--resume true" in capsys.readouterr().err
    assert cli.main(["tune", "--config", recipe, "--out", str(out), "--resume", "true", "--seed", "3"]) == 2
    assert "was begun with another --seed" in capsys.readouterr().err
    elsewhere = tmp_path / "elsewhere.yaml"
    elsewhere.write_text("seed: 0\n")
    goes_on = ["tune", "--config", recipe, "--out", str(out), "--resume", "true", "--recipe", str(elsewhere)]
    assert cli.main([*goes_on, "--workers", "1"]) == 0
    elsewhere.write_text("replay: {alpha: 0.3}\n")
    assert cli.main(goes_on) == 2
    assert "was begun with another train-rl's replay" in capsys.readouterr().err
    assert json.loads((out / "summary.json").read_text())["best_params"] == summary["best_params"]

    best = cli.parse("train-rl", ["--config", str(out / "best.yaml"), "--out", "x"])
    row = rows[summary["best_trial"]]
    assert best.learner.actor_rate == float(row["learner.actor_rate"])
    assert best.network.hidden == [16, int(row["network.hidden.1"])]
    assert best.network.normalisation == row["network.normalisation"]
    assert best.env_steps == 160

    again = tmp_path / "again"
    assert cli.main(["train-rl", "--config", str(out / "best.yaml"), "--out", str(again)]) == 0
    repeated = json.loads((again / "summary.json").read_text())["evaluations"][-1]["mean_return"]
    assert repeated == pytest.approx(float(row["value"]), rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--space", "{}"], "--space names nothing to search"),
        (
            ["--space", "{learner.actr_rate: {low: 1, high: 2}}"],
            "unknown key 'learner.actr_rate' (did you mean learner.actor_rate",
        ),
        (["--space", "{learner.tau: {low: 0.1, high: 1.5}}"], "--learner.tau must be in (0, 1], got 1.5"),
        (["--space", "{learner.tau: {low: 1, high: 0.5}}"], "--space: learner.tau's low 1 is above its high 0.5"),
        (["--space", "{learner.tau: {low: 0.5}}"], "--space: learner.tau needs low and high, or choices"),
        (["--space", "{learner.tau: {low: 0, high: 1, log: true}}"], "learner.tau has a logarithmic scale, so its low"),
        (
            ["--space", "{learner.n_step: {low: 1, high: .inf, integer: true}}"],
            "must be finite numbers, got",
        ),
        (["--space", "{learner.tau: {low: 0.1, high: 0.2, step: 1}}"], "learner.tau's step 1 is larger than what lies"),
        (["--space", "{learner.n_step: {low: 0.5, high: 3, integer: true}}"], "learner.n_step is an integer, so low"),
        (["--space", "{learner.n_step: {low: 1, high: 3}}"], "learner.n_step"),
        (
            ["--space", "{network.normalisation: {choices: [layr]}}"],
            "unknown network.normalisation 'layr' (did you mean layer",
        ),
        (["--space", "{network.normalisation: {choices: [[1]]}}"], "network.normalisation's choices must be words"),
        (
            ["--space", "{network.hidden.7: {low: 8, high: 16, integer: true}}"],
            "is beyond the 2 elements of network.hidden",
        ),
        (["--space", "{learner.gamma.0: {low: 0, high: 1}}"], "learner.gamma.0 is an element of learner.gamma, which"),
        (["--space", "{scene.0: {choices: [a]}}"], "scene.0 is an element of scene, which is no list"),
        (
            ["--space", "{netwrok.hidden.0: {low: 8, high: 16}}"],
            "netwrok.hidden.0 is an element of netwrok.hidden",
        ),
        (["--space", "{'5': {low: 8, high: 16}}"], "5 is an element of nothing, which is no list of train-rl's"),
        (["--space", "{network.hidden.²: {low: 8, high: 16}}"], "unknown key 'network.hidden.²'"),
        (["--overrides.seed", "4294967295", "--seeds", "2"], "--seed must be at most 4294967295, got 4294967296"),
        (["--space", "{out: {choices: [a, b]}}"], "out is set for each trial by tune"),
        (["--space", "{print_config: {choices: [a]}}"], "print_config is set for each trial by tune"),
        (["--space", "{seed: {low: 0, high: 3, integer: true}}"], "seed cannot be searched"),
        (["--overrides", "{env_stps: 100}"], "unknown key 'env_stps' (did you mean env_steps"),
        (["--recipe", "no/such.yaml"], "no/such.yaml"),
        (["--sampler", "wale"], "unknown sampler 'wale' (did you mean whale?); available: cmaes, random, tpe, whale"),
        (["--whale.mode", "faithfull"], "unknown whale.mode 'faithfull' (did you mean faithful?)"),
        (["--whale.population", "1"], "--whale.population must be at least 2, got 1"),
        (["--fitness", "reward"], "unknown fitness 'reward'; available: mean_return, success_rate"),
        (["--trials", "0"], "--trials must be at least 1, got 0"),
        (["--env_steps_total", "10"], "--env_steps_total 10 is less than one trial of 1 x 160 environment steps"),
        (["--storage", "mysql+nodriver://x/y"], "--storage mysql+nodriver://x/y cannot be opened"),
        (["--storage", "no/such/study.journal"], "cannot be opened: there is no folder no/such"),
        (["--overrides.encoder", "nowhere"], "nowhere is not an encoder: it does not exist"),
    ],
)
def test_a_mistake_is_told_in_a_sentence_and_nothing_is_written(
    arguments: list[str], words: str, recipe: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tune"
    assert cli.main(["tune", "--config", recipe, "--out", str(out), *arguments]) == 2
    message = capsys.readouterr().err
    assert words in message and message.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "content", [b"a line that matters", b'{"a": 1}\n', b"SQLite format 3\0", b'{"op_code":0}\nno line of it\n', None]
)
def test_a_storage_that_is_no_journal_is_refused_and_kept(
    content: bytes | None, recipe: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    storage, out = tmp_path / "storage", tmp_path / "tune"
    if content is None:
        storage.mkdir()
    else:
        storage.write_bytes(content)
    assert cli.main(["tune", "--config", recipe, "--out", str(out), "--storage", str(storage)]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"nerf-rl tune: --storage {storage} ") and message.count("\n") == 1
    assert not out.exists() and (storage.is_dir() if content is None else storage.read_bytes() == content)


def test_a_recipe_that_is_edited_meanwhile_changes_no_trial(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    of_runs, seen = tmp_path / "runs.yaml", []
    of_runs.write_text("env_steps: 4000\n")

    def supervise(task: Task, workers: int) -> NoReturn:
        of_runs.write_text("env_steps: 5000\n")
        seen.append(trial_config(task.objective.config, {}, "x").env_steps)
        raise KeyboardInterrupt

    monkeypatch.setattr("nerf_rl.tuning.tune.supervise", supervise)
    words = ["--recipe", str(of_runs), "--space", "{learner.actor_rate: {low: 0.1, high: 0.2}}"]
    assert cli.main(["tune", *words, "--out", str(tmp_path / "tune")]) == 130
    assert seen == [4000]


def test_a_folder_that_holds_its_own_recipe_or_storage_is_not_emptied(
    recipe: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tune"
    out.mkdir()
    (out / "provenance.json").write_text('{"command": "tune"}')
    (out / "best.yaml").write_text("learner: {tau: 0.5}\n")
    (out / "study.journal").write_text('{"op_code":0')
    for key, name in (("--recipe", "best.yaml"), ("--storage", "study.journal")):
        words = ["--config", recipe, "--out", str(out), key, str(out / name), "--overwrite", "true"]
        assert cli.main(["tune", *words]) == 2
        assert f"{out / name} lies in the output folder {out}" in capsys.readouterr().err
        assert (out / name).is_file()


def test_runs_that_a_session_kept_stay_when_another_goes_on(tmp_path: Path) -> None:
    study = optuna.create_study()
    distributions: dict[str, BaseDistribution] = {}
    for state in (TrialState.COMPLETE, TrialState.FAIL, TrialState.PRUNED):
        value = 1.0 if state == TrialState.COMPLETE else None
        study.add_trial(optuna.create_trial(state=state, value=value, params={}, distributions=distributions))
    for name in ("00000-0", "00000-1", "00001-0", "00002-0", "00003-0"):
        (tmp_path / name).mkdir()
    _remove_lost_runs(study, tmp_path)
    assert {folder.name for folder in tmp_path.iterdir()} == {"00000-0", "00000-1", "00002-0"}


def test_a_search_none_of_whose_trials_ends_well_says_so(
    recipe: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tune"
    words = ["--space", "{learner.actor_rate: {low: 1.0e+30, high: 1.0e+32}}", "--trials", "1", "--workers", "1"]
    assert cli.main(["tune", "--config", recipe, "--out", str(out), *words]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert "every trial was pruned or diverged" in said and said.endswith(f"see {out / 'trials.csv'}")
    assert (out / "trials.csv").is_file() and not (out / "best.yaml").exists()


def test_a_mistake_is_answered_without_importing_torch(recipe: str, tmp_path: Path) -> None:
    arguments = ["tune", "--config", recipe, "--out", "x", "--space", "{lerner.tau: {low: 0, high: 1}}"]
    program = (
        f"import sys; from nerf_rl import cli; assert cli.main({arguments}) == 2; "
        "assert not {'torch', 'mujoco', 'metaworld'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)


def test_a_storage_with_another_search_is_refused_before_anything_is_written(
    recipe: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import optuna

    from nerf_rl.tuning.search import search_of
    from nerf_rl.tuning.storage import open_storage
    from nerf_rl.tuning.tune import _content, open_study

    journal = str(tmp_path / "shared.journal")
    config = cli.parse("tune", ["--config", recipe, "--out", "x", "--storage", journal])
    base = check_space(config)
    open_study(open_storage(journal, tmp_path), config, _content(config, base), search_of(config, 8, 160))
    keys = ["--config", recipe, "--out", str(tmp_path / "other"), "--storage", journal]
    assert cli.main(["tune", *keys, "--overrides.env_steps", "200", "--sampler", "tpe"]) == 2
    assert "the study tune was begun with another sampler, train-rl's env_steps" in capsys.readouterr().err
    optuna.create_study(storage=open_storage(journal, tmp_path), study_name="foreign")
    assert cli.main(["tune", *keys, "--study", "foreign"]) == 2
    assert "the study foreign in --storage was not made by tune" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()
    _, joined = open_study(open_storage(journal, tmp_path), config, _content(config, base), search_of(config, 90, 160))
    assert joined.iterations == 4  # as it was begun, whatever this machine's number of trials


def test_parameters_win_over_overrides_and_these_over_the_recipe(recipe: str) -> None:
    keys = ["--config", recipe, "--recipe", str(ROOT / "rl/drawer-open.yaml"), "--out", "x"]
    config = cli.parse("tune", [*keys, "--overrides.learner.tau", "0.5", "--seeds", "2"])
    run = trial_config(config, {"learner.actor_rate": 1e-4, "network.hidden.1": 9, "learner.gamma": 0.5}, "y", seed=1)
    assert (run.out, run.seed, run.envs, run.evaluation_to_end) == ("y", 1, 1, True)
    assert (run.learner.actor_rate, run.learner.gamma, run.learner.tau) == (1e-4, 0.5, 0.5)
    shipped = cli.parse("train-rl", ["--config", str(ROOT / "rl/drawer-open.yaml"), "--out", "x"])
    assert run.network.hidden == [16, 9] and run.noise == shipped.noise != type(shipped.noise)()
    assert start_values(config) == {
        "learner.actor_rate": 3e-4,
        "network.hidden.1": 16,
        "network.normalisation": "layer",
    }


def test_a_budget_of_environment_steps_gives_the_number_of_trials(recipe: str) -> None:
    config = cli.parse("tune", ["--config", recipe, "--out", "x", "--env_steps_total", "5000", "--seeds", "3"])
    assert trials_of(config, check_space(config)) == 5000 // (3 * 160)


@pytest.mark.parametrize("shipped", sorted((ROOT / "rl").glob("tune*.yaml")), ids=lambda path: path.stem)
def test_shipped_searches_are_valid(shipped: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    config = cli.parse("tune", ["--config", str(shipped), "--out", "x"])
    check_space(config)
    assert start_values(config).keys() == config.space.keys()
