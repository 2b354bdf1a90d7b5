"""What a trial is worth: the deterministic policy's evaluation at the end of training."""

import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import Trial, TrialState

from nerf_rl.errors import DivergedError, UserError
from nerf_rl.files.folder_lock import release_folders
from nerf_rl.rl.training.evaluation_results import due
from nerf_rl.tuning.config import TuneConfig
from nerf_rl.tuning.recipe import trial_config

ENV_STEPS = "env_steps"


@dataclass(frozen=True)
class TrainingObjective:
    """Trains with a trial's parameters and returns the last evaluation, averaged over training seeds.

    Evaluations of the first seed are reported to the study, at the environment steps at which they were due, as others
    came a little sooner or later; they may end the trial. The other seeds run to their end. The
    environment steps spent so far are kept with the trial, so those of pruned and failed ones are counted too. Training
    is a function of its parameters, so parameters that were tried before are not trained again.
    """

    config: TuneConfig
    """of the search"""

    def __call__(self, trial: Trial) -> float:
        """Return the fitness, which is no number if a run diverged.

        Raises:
            TrialPruned: the evaluations are poor.
        """
        for other in trial.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)):
            if other.params == trial.params and other.value is not None:
                for step, value in other.intermediate_values.items():  # whoever is compared with this trial sees them
                    trial.report(value, step)
                return other.value
        values, spent = [], 0
        for seed in range(self.config.seeds):
            out = runs_of(self.config.out) / f"{trial.number:05d}-{seed}"
            try:
                summary = self._train(trial, out, seed, spent)
            except DivergedError as error:
                trial.set_user_attr(ENV_STEPS, spent + error.env_steps)
                return math.nan
            finally:
                if not self.config.keep_runs:
                    shutil.rmtree(out, ignore_errors=True)
            spent += summary["env_steps"]
            values.append(float(summary["evaluations"][-1][self.config.fitness]))
        return sum(values) / len(values)

    def _train(self, trial: Trial, out: Path, seed: int, spent: int) -> dict[str, Any]:
        from nerf_rl.rl.train import train_rl  # it takes seconds to import

        run = trial_config(self.config, trial.params, str(out), seed)
        run.overwrite = True  # whatever is there is a killed trial's

        def report(evaluation: dict[str, Any]) -> None:
            if self.config.fitness not in evaluation:
                raise UserError(f"{run.scene} does not tell of success; search with --fitness mean_return")
            trial.set_user_attr(ENV_STEPS, spent + evaluation["env_steps"])
            if seed == 0:
                trial.report(evaluation[self.config.fitness], due(evaluation["env_steps"], vars(run)))
                if evaluation["env_steps"] < run.env_steps and trial.should_prune():
                    raise optuna.TrialPruned

        try:
            return train_rl(run, report)
        finally:
            release_folders()


def trial_of(folder: Path) -> int:
    """Return the number of the trial that a run folder belongs to."""
    return int(folder.name.partition("-")[0])


def runs_of(out: str) -> Path:
    """Return the folder of the trials' run folders."""
    return Path(out) / "trials"
