"""A worker process of a study: one trial after another, until the study has as many as it is to have."""

import math
import os
import secrets
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.trial import FrozenTrial, Trial, TrialState

from nerf_rl.machine.processes import end_with_parent, tidy_up_alone
from nerf_rl.tuning.heartbeat import Heart, LostTrials
from nerf_rl.tuning.search import Search
from nerf_rl.tuning.storage import open_storage
from nerf_rl.tuning.trial_notes import write_note

ERROR = "error"
FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)
ERRORS_IN_A_ROW = 3
_PAUSE, _DATABASE_PAUSE = 0.1, 0.5  # [s] between two looks at what others do

Objective = Callable[[Trial], float]


@dataclass(frozen=True)
class Task:
    """What the workers of a study do; picklable."""

    objective: Objective
    """of a trial whose parameters have been drawn; may raise TrialPruned"""
    search: Search
    """how the study proposes"""
    out: str
    """output folder"""
    storage: str
    """as in :func:`~nerf_rl.tuning.storage.open_storage`"""
    study: str
    """name of the study in it"""
    trials: int
    """finished trials that the study is to have"""
    first: int = 0
    """number of the first trial of this session; errors of earlier ones are forgiven"""
    modules: tuple[str, ...] = ()
    """that the objective needs beyond its own; workers have them imported from the start"""


def work(task: Task, number: int) -> None:
    """Run trials of a study until it is finished or has failed; the entry of a worker process.

    Args:
        task: of all workers.
        number: of this one.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the supervisor's to handle
    end_with_parent()
    tidy_up_alone()
    _write_to(log_of(task.out, number))
    os.environ["OMP_NUM_THREADS"] = "1"
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage = open_storage(task.storage, Path(task.out))
    heart, lost = Heart(storage), LostTrials(storage)
    pause = _DATABASE_PAUSE if "://" in task.storage else _PAUSE

    def wait(study: optuna.Study, trial: FrozenTrial) -> None:
        heart.beat(trial)
        lost.fail(study)
        time.sleep(pause)

    study = optuna.load_study(study_name=task.study, storage=storage)
    # others that share the study have workers of these numbers, too
    session = secrets.randbits(32) if task.storage else 0
    study.sampler = task.search.make_sampler((number, len(study.get_trials(deepcopy=False)), session), wait)
    study.pruner = task.search.make_pruner()
    while True:
        trials = study.get_trials(deepcopy=False)
        if finished(trials) >= task.trials or last_errors(trials, task.first):
            return
        if _held(trials) < task.trials:
            _run_trial(study, task, heart, storage)
        else:
            lost.fail(study)
            time.sleep(pause)


def _run_trial(study: optuna.Study, task: Task, heart: Heart, storage: optuna.storages.BaseStorage) -> None:
    """Draw a trial, run it and record how it ended."""
    trial = study.ask(task.search.space)
    if _held(study.get_trials(deepcopy=False)[: trial.number]) >= task.trials:
        study.tell(trial, state=TrialState.FAIL)  # another worker drew the last one at the same time
        return
    try:
        with heart.beating(trial):
            value = task.objective(trial)
    except UpdateFinishedTrialError:
        return  # the others took this worker for dead and drew the trial again
    except optuna.TrialPruned:
        study.tell(trial, state=TrialState.PRUNED, skip_if_finished=True)
    except Exception as error:
        traceback.print_exc()
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        write_note(storage, trial, ERROR, reason)
        study.tell(trial, state=TrialState.FAIL, skip_if_finished=True)
    else:
        # a run that diverged is worth nothing; like a pruned one it keeps its slot and is not followed
        diverged = {"state": TrialState.PRUNED} if not math.isfinite(value) else {"values": value}
        study.tell(trial, **diverged, skip_if_finished=True)


def finished(trials: list[FrozenTrial]) -> int:
    """Return the number of trials that count."""
    return sum(trial.state in FINISHED for trial in trials)


def last_errors(trials: list[FrozenTrial], first: int) -> list[str]:
    """Return the errors that the last trials ended with, if there were too many in a row, or nothing.

    Args:
        trials: of the study.
        first: number of the first trial that is looked at.
    """
    ended = [trial for trial in trials[first:] if trial.state in FINISHED or ERROR in trial.user_attrs]
    ended = [trial for trial in ended if trial.datetime_complete is not None]
    ended.sort(key=lambda trial: trial.datetime_complete)  # type: ignore[arg-type,return-value]
    errors = [trial.user_attrs.get(ERROR, "") for trial in ended[-ERRORS_IN_A_ROW:]]
    return errors if len(errors) == ERRORS_IN_A_ROW and all(errors) else []


def log_of(out: str, number: int) -> Path:
    """Return the file that a worker's output goes to."""
    return Path(out) / "logs" / f"worker-{number}.log"


def _held(trials: list[FrozenTrial]) -> int:
    return sum(trial.state != TrialState.FAIL for trial in trials)


def _write_to(log: Path) -> None:
    """Send all output of this process and its children to a file."""
    log.parent.mkdir(parents=True, exist_ok=True)
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    sys.stdout.flush()
    sys.stderr.flush()
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.close(file)
