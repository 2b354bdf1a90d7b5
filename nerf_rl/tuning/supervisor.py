"""Keeps the worker processes of a study at work: replaces those that die and ends when the study does."""

import contextlib
from multiprocessing.connection import wait as wait_for
from multiprocessing.process import BaseProcess
from pathlib import Path

import optuna
from optuna.trial import FrozenTrial, TrialState

from nerf_rl.errors import FailureError
from nerf_rl.machine.processes import delay_interrupts, worker_context
from nerf_rl.progress import Progress
from nerf_rl.tuning.heartbeat import LOST, LostTrials
from nerf_rl.tuning.sampler import slot_of
from nerf_rl.tuning.storage import open_storage
from nerf_rl.tuning.worker import ERROR, ERRORS_IN_A_ROW, FINISHED, Task, finished, last_errors, log_of, work

_MOST_DEATHS = 10
_PAUSE = 0.3  # [s] between two looks


def supervise(task: Task, workers: int) -> optuna.Study:
    """Run a study in worker processes until it has all its trials; return it.

    A worker that dies has its trial failed and is replaced. An interruption ends the workers, and fails their trials.

    Args:
        task: of the workers.
        workers: how many.

    Raises:
        FailureError: several trials in a row raised an error, or workers die and nothing gets finished.
    """
    storage = open_storage(task.storage, Path(task.out))
    study = optuna.load_study(study_name=task.study, storage=storage)
    lost = LostTrials(storage)
    lost.fail(study)
    trials = study.get_trials(deepcopy=False)
    reported, deaths, done = {t.number for t in trials if t.state.is_finished()}, 0, finished(trials)
    with (
        _Workers(task) as running,
        Progress(task.trials, "trials", done=done) as progress,
    ):
        running.start(min(workers, task.trials - done))
        while finished(trials) < task.trials:
            deaths += running.replace_dead()
            wait_for(running.sentinels, timeout=_PAUSE)
            lost.fail(study)
            trials = study.get_trials(deepcopy=False)
            for trial in trials:
                if trial.state.is_finished() and trial.number not in reported:
                    reported.add(trial.number)
                    progress.say(describe(study, trial))
            if finished(trials) > done:
                progress.advance(finished(trials) - done)
                deaths, done = 0, finished(trials)
            if errors := last_errors(trials, task.first):
                raise FailureError(f"{ERRORS_IN_A_ROW} trials in a row failed, the last one with {errors[-1]}")
            if deaths > _MOST_DEATHS:
                raise FailureError(
                    f"workers died {deaths} times and finished nothing meanwhile; see {log_of(task.out, 0).parent}"
                )
        running.finish()
    return study


class _Workers(contextlib.AbstractContextManager):
    """The worker processes; on leaving, those that still run are ended and their trials failed."""

    def __init__(self, task: Task):
        self._task = task
        self._context = worker_context([work.__module__, type(task.objective).__module__, *task.modules])
        self._processes = list[BaseProcess]()

    def start(self, count: int) -> None:
        """Start so many of them."""
        with delay_interrupts():
            self._processes += map(self._started, range(count))

    @property
    def sentinels(self) -> list[int]:
        """What becomes ready when a worker ends."""
        return [process.sentinel for process in self._processes]

    def replace_dead(self) -> int:
        """Start a worker for each that has died; return how many there were."""
        dead = [number for number, process in enumerate(self._processes) if process.exitcode]  # 0: nothing left to do
        with delay_interrupts():
            for number in dead:
                self._processes[number].join()
                self._processes[number] = self._started(number)
        return len(dead)

    def finish(self) -> None:
        """Wait for workers that have nothing left to do."""
        for process in self._processes:
            process.join(10.0)

    def _started(self, number: int) -> BaseProcess:
        process = self._context.Process(target=work, args=(self._task, number), name=f"tune-{number}")
        process.start()
        return process

    def __exit__(self, *exception: object) -> None:
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join(5.0)
            process.kill()
            process.join()
        storage = open_storage(self._task.storage, Path(self._task.out))
        LostTrials(storage).settle(optuna.load_study(study_name=self._task.study, storage=storage))


def describe(study: optuna.Study, trial: FrozenTrial) -> str:
    """Return a line on a trial that has ended."""
    slot = slot_of(trial)
    name = f"trial {trial.number}" + (f" (generation {slot[0]}, whale {slot[1]})" if slot else "")
    if trial.state not in FINISHED:
        return f"{name}: failed, {trial.user_attrs.get(ERROR) or trial.user_attrs.get(LOST) or 'not needed'}"
    seconds = f"{trial.duration.total_seconds():.0f} s" if trial.duration is not None else ""
    if trial.state == TrialState.PRUNED:
        return f"{name}: pruned after {seconds}"
    return f"{name}: {trial.value:.4g} in {seconds}; best {study.best_value:.4g} (trial {study.best_trial.number})"
