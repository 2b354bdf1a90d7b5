"""``nerf-rl tune``: search the keys of train-rl on any number of processes and machines."""

import contextlib
import dataclasses
import json
import shutil
import time
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import BaseStorage
from optuna.trial import TrialState

from nerf_rl.arguments.stored_keys import require_same_keys, with_defaults
from nerf_rl.errors import FailureError, UserError
from nerf_rl.files.atomic import write_text
from nerf_rl.files.outputs import check_output, command_of, plain, prepare_output, require_outside, write_provenance
from nerf_rl.rl.config import NO_ENCODER, TrainRLConfig
from nerf_rl.rl.environments.encoder_match import check_encoder_scene
from nerf_rl.rl.sweeps.workers import training_modules
from nerf_rl.tuning.config import TuneConfig
from nerf_rl.tuning.objective import TrainingObjective, runs_of, trial_of
from nerf_rl.tuning.recipe import check_space
from nerf_rl.tuning.results import BEST, RECIPE, TRIALS, write_results
from nerf_rl.tuning.search import Search, search_of
from nerf_rl.tuning.storage import JOURNAL, open_storage
from nerf_rl.tuning.supervisor import supervise
from nerf_rl.tuning.worker import Task

_CONTENT, _ITERATIONS = "content", "iterations"
_RUN = "train-rl's "
"""before keys of train-rl, beside those of tune"""


def tune(config: TuneConfig) -> dict[str, Any]:
    """Search hyper-parameters into the folder ``config.out``; return the summary.

    Raises:
        UserError: a key or range that train-rl refuses, a storage that cannot be opened or holds another search.
        FailureError: trials or workers keep failing, or no trial ended well.
    """
    start, out = time.monotonic(), Path(config.out)
    base = check_space(config)
    trials = trials_of(config, base)
    if base.encoder != NO_ENCODER:
        check_encoder_scene(base.encoder, base.scene)
        if not config.resume:
            require_outside(out, base.encoder)
    if not config.resume:
        require_outside(out, *(path for path in (config.recipe, config.storage) if path and "://" not in path))
    begun = _is_search(out)
    if begun and config.resume:
        keys = {key: value for key, value in config.content().items() if key != "recipe"}  # its content is compared
        require_same_keys(out, {**keys, "storage": config.storage, "study": config.study}, TuneConfig)
    check_output(out, config.overwrite, config.resume, begun, "tune")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    content = _content(config, base)
    if config.storage:  # a storage that others share is looked at before anything is written
        _join(open_storage(config.storage, out), config, content)
    prepare_output(out, config.overwrite, config.resume, begun, "tune")
    write_provenance(out, "tune", config)
    storage = open_storage(config.storage, out)
    study, search = open_study(storage, config, content, search_of(config, trials, base.env_steps))
    first = len(study.get_trials(deepcopy=False))
    print(f"tune writes to {out}; {trials} trials of {config.seeds * base.env_steps} environment steps", flush=True)
    config = _with_recipe_of_its_own(config, out)
    objective, modules = TrainingObjective(config), training_modules(base.device)
    task = Task(objective, search, config.out, config.storage, config.study, trials, first, modules)
    study = supervise(task, config.workers)
    if not config.keep_runs:
        _remove_lost_runs(study, runs_of(config.out))
    summary = write_results(study, config, time.monotonic() - start)
    spent = f"{summary['env_steps']} environment steps in all"
    if summary["best_trial"] is None:
        raise FailureError(f"every trial was pruned or diverged; {spent}; see {out / TRIALS}")
    print(f"best {config.fitness} {summary['best_value']:.4g}; {spent}; see {out / BEST}", flush=True)
    return summary


def _remove_lost_runs(study: optuna.Study, runs: Path) -> None:
    """Delete what killed trials left; of finished ones only what an earlier session was to keep is still there."""
    finished = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED))
    kept = {trial.number for trial in finished}
    for folder in runs.glob("[0-9]*-*"):
        if trial_of(folder) not in kept:
            shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):  # not empty, or not there
        runs.rmdir()


def _with_recipe_of_its_own(config: TuneConfig, out: Path) -> TuneConfig:
    """Copy the recipe into the output folder, so that whoever edits it meanwhile does not change trials to come."""
    if not config.recipe:
        return config
    write_text(out / RECIPE, Path(config.recipe).read_text(encoding="utf-8"))
    return dataclasses.replace(config, recipe=str(out / RECIPE))


def trials_of(config: TuneConfig, base: TrainRLConfig) -> int:
    """Return how many trials there are to be, from their number or from a budget of environment steps."""
    if not config.env_steps_total:
        return config.trials
    trials = config.env_steps_total // (base.env_steps * config.seeds)
    if trials < 1:
        each = f"{config.seeds} x {base.env_steps} environment steps"
        raise UserError(f"--env_steps_total {config.env_steps_total} is less than one trial of {each}")
    return trials


def open_study(
    storage: BaseStorage, config: TuneConfig, content: dict[str, Any], search: Search
) -> tuple[optuna.Study, Search]:
    """Create or join the study; return it with its search.

    The generations over which whales narrow their search are counted when the study is created, so that a study that is
    resumed or shared with another number of trials proposes what it would have.
    """
    study = _join(storage, config, content)
    if study is None:
        study = optuna.create_study(storage=storage, study_name=config.study, direction="maximize", load_if_exists=True)
        study.set_user_attr(_ITERATIONS, search.iterations)
        study.set_user_attr(_CONTENT, content)
    return study, dataclasses.replace(search, iterations=study.user_attrs[_ITERATIONS])


def _join(storage: BaseStorage, config: TuneConfig, content: dict[str, Any]) -> optuna.Study | None:
    """Return the study if the storage has it; raise UserError if it is another search."""
    if config.study not in [summary.study_name for summary in optuna.get_all_study_summaries(storage)]:
        return None
    study = optuna.load_study(study_name=config.study, storage=storage)
    if _CONTENT not in study.user_attrs:
        raise UserError(f"the study {config.study} in --storage was not made by tune; use another --study")
    stored = study.user_attrs[_CONTENT]
    complete = _with_defaults(stored)
    other = sorted(key for key in {*stored, *content} if complete.get(key) != content.get(key))
    if other:
        raise UserError(f"the study {config.study} was begun with another {', '.join(other)}; use another --study")
    return study


def _content(config: TuneConfig, base: TrainRLConfig) -> dict[str, Any]:
    """Return what machines that share a study must agree on; recipes count by what is in them."""
    run = {key: value for key, value in plain(base).items() if key not in ("out", "resume", "overwrite")}
    keys = {key: value for key, value in config.content().items() if key not in ("recipe", "overrides", "algo")}
    return json.loads(json.dumps({**plain(keys), **{f"{_RUN}{key}": value for key, value in run.items()}}))


def _with_defaults(content: dict[str, Any]) -> dict[str, Any]:
    """Return what a study was begun with, with the keys that there were not yet."""
    own = {key: value for key, value in content.items() if not key.startswith(_RUN)}
    run = {key.removeprefix(_RUN): value for key, value in content.items() if key.startswith(_RUN)}
    complete = with_defaults(run, TrainRLConfig)
    return {**with_defaults(own, TuneConfig), **{f"{_RUN}{key}": value for key, value in complete.items()}}


def _is_search(out: Path) -> bool:
    """Tell whether the folder holds a search, finished or not, which had come as far as to write what it is."""
    return command_of(out) == "tune" and any((out / name).exists() for name in ("config.yaml", JOURNAL))
