"""What a trial reports, costs and is worth, with a training that only says what it was asked to do."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.pruners import ThresholdPruner
from optuna.trial import TrialState

from nerf_rl import cli
from nerf_rl.errors import DivergedError, UserError
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.tuning.objective import TrainingObjective, runs_of
from nerf_rl.tuning.recipe import distributions
from nerf_rl.tuning.results import env_steps, trials_table

SPACE = "{learner.gamma: {low: 0.5, high: 1.0}, network.normalisation: {choices: [layer, none]}}"


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[TrainRLConfig]:
    """Replace training by one whose return is 100 gamma + seed at the end, and half of that half way."""
    asked = []

    def train(config: TrainRLConfig, on_evaluation: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        asked.append(config)
        Path(config.out).mkdir(parents=True)
        worth, evaluations = 100 * config.learner.gamma + config.seed, []
        for share in (0.5, 1.0):
            steps = int(share * config.env_steps)
            evaluations.append({"env_steps": steps, "mean_return": share * worth, "success_rate": share})
            on_evaluation(evaluations[-1])
        return {"env_steps": config.env_steps, "evaluations": evaluations}

    monkeypatch.setattr("nerf_rl.rl.train.train_rl", train)
    return asked


def search(out: Path, *arguments: str) -> TrainingObjective:
    config = cli.parse("tune", ["--out", str(out), "--space", SPACE, "--overrides", "{env_steps: 4000}", *arguments])
    return TrainingObjective(config)


def run(study: optuna.Study, objective: TrainingObjective, gamma: float) -> None:
    """Run one trial at a given gamma."""
    study.enqueue_trial({"learner.gamma": gamma, "network.normalisation": "none"})

    def with_space(trial: optuna.Trial) -> float:
        for name, distribution in distributions(objective.config.space).items():
            trial._suggest(name, distribution)
        return objective(trial)

    study.optimize(with_space, 1)


def test_the_fitness_is_the_mean_of_the_last_evaluations_over_seeds(runs: list[TrainRLConfig], tmp_path: Path) -> None:
    objective = search(tmp_path, "--seeds", "3")
    study = optuna.create_study(direction="maximize")
    run(study, objective, 0.75)
    trial = study.get_trials()[0]
    assert trial.value == pytest.approx(75 + (0 + 1 + 2) / 3)
    assert trial.intermediate_values == {2000: 37.5, 4000: 75.0}, "of the first seed"
    assert env_steps(trial) == 3 * 4000
    assert [(config.seed, config.envs, config.network.normalisation) for config in runs] == [
        (seed, 1, "none") for seed in range(3)
    ]
    assert all(config.evaluation_to_end for config in runs)
    assert not any(runs_of(str(tmp_path)).iterdir())


def test_the_fitness_may_be_the_success_rate_and_runs_may_be_kept(runs: list[TrainRLConfig], tmp_path: Path) -> None:
    objective = search(tmp_path, "--fitness", "success_rate", "--keep_runs", "true")
    study = optuna.create_study(direction="maximize")
    run(study, objective, 0.75)
    assert study.best_value == 1.0 and not runs[0].evaluation_to_end
    assert [path.name for path in runs_of(str(tmp_path)).iterdir()] == ["00000-0"]


def test_a_search_for_success_in_a_scene_that_tells_of_none_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def train(config: TrainRLConfig, on_evaluation: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        on_evaluation({"env_steps": config.env_steps, "mean_return": 1.0})
        raise AssertionError("it went on")

    monkeypatch.setattr("nerf_rl.rl.train.train_rl", train)
    objective = search(tmp_path, "--fitness", "success_rate")
    with pytest.raises(UserError, match="does not tell of success; search with --fitness mean_return"):
        run(optuna.create_study(), objective, 0.75)


def test_a_run_that_diverges_is_worth_no_number_and_no_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def train(config: TrainRLConfig, on_evaluation: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        on_evaluation({"env_steps": 2000, "mean_return": 1.0})
        if config.seed == 0:
            return {"env_steps": 4000, "evaluations": [{"mean_return": 1.0}]}
        raise DivergedError(3000, "a weight")

    monkeypatch.setattr("nerf_rl.rl.train.train_rl", train)
    study = optuna.create_study(direction="maximize")
    trial = study.ask()
    trial.suggest_float("learner.gamma", 0.5, 1.0)
    assert math.isnan(search(tmp_path, "--seeds", "3")(trial))
    assert env_steps(study.get_trials()[0]) == 4000 + 3000
    assert not any(runs_of(str(tmp_path)).glob("*"))


@pytest.mark.parametrize("late", [0, 3])
def test_what_is_reported_can_be_compared_however_late_it_came(
    late: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Where episodes end within a held action, environments are not in step with the evaluations."""

    def train(config: TrainRLConfig, on_evaluation: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
        assert config.envs * config.action_repeat == 4
        for steps in (1500 + late, 3000 + late, 4000 + late):
            on_evaluation({"env_steps": steps, "mean_return": 1.0})
        return {"env_steps": 4000 + late, "evaluations": [{"mean_return": 1.0}]}

    monkeypatch.setattr("nerf_rl.rl.train.train_rl", train)
    objective = search(tmp_path, "--overrides", "{env_steps: 4000, evaluation_every: 1500, envs: 2, action_repeat: 2}")
    study = optuna.create_study(direction="maximize")
    run(study, objective, 0.75)
    assert list(study.get_trials()[0].intermediate_values) == [1500, 3000, 4000]
    assert env_steps(study.get_trials()[0]) == 4000 + late


def test_parameters_that_were_tried_before_are_not_trained_again(runs: list[TrainRLConfig], tmp_path: Path) -> None:
    objective = search(tmp_path)
    study = optuna.create_study(direction="maximize")
    for gamma in (0.75, 0.5, 0.75):
        run(study, objective, gamma)
    assert [trial.value for trial in study.get_trials()] == [75.0, 50.0, 75.0]
    assert [env_steps(trial) for trial in study.get_trials()] == [4000, 4000, 0] and len(runs) == 2
    first, _, again = study.get_trials()
    assert again.intermediate_values == first.intermediate_values == {2000: 37.5, 4000: 75.0}


def test_a_pruned_trial_ends_at_once_and_what_it_cost_is_counted(runs: list[TrainRLConfig], tmp_path: Path) -> None:
    objective = search(tmp_path, "--seeds", "2")
    study = optuna.create_study(direction="maximize", pruner=ThresholdPruner(lower=30.0))
    run(study, objective, 0.5)
    run(study, objective, 0.9)
    poor, good = study.get_trials()
    assert (poor.state, env_steps(poor), len(runs)) == (TrialState.PRUNED, 2000, 1 + 2)
    assert (good.state, env_steps(good)) == (TrialState.COMPLETE, 8000)
    lines = trials_table([poor, good]).splitlines()
    assert lines[0] == "number,state,value,seconds,env_steps,learner.gamma,network.normalisation"
    assert lines[1].startswith("0,pruned,,") and lines[1].endswith(",2000,0.5,none")


def test_the_last_evaluation_of_a_run_prunes_nothing(runs: list[TrainRLConfig], tmp_path: Path) -> None:
    objective = search(tmp_path)
    study = optuna.create_study(direction="maximize", pruner=ThresholdPruner(upper=60.0, n_warmup_steps=3000))
    run(study, objective, 0.9)
    assert study.get_trials()[0].state == TrialState.COMPLETE
