"""Studies in worker processes: killed workers, resumption, interruption, failures, storages."""

import dataclasses
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, Trial, TrialState

from nerf_rl.errors import FailureError
from nerf_rl.tuning import heartbeat
from nerf_rl.tuning.heartbeat import HEARTBEAT, LOST, Heart, LostTrials
from nerf_rl.tuning.pruner import EarlierMedianPruner
from nerf_rl.tuning.sampler import SLOT, WhaleSampler, slot_of
from nerf_rl.tuning.search import Search
from nerf_rl.tuning.storage import open_storage
from nerf_rl.tuning.supervisor import supervise
from nerf_rl.tuning.worker import Task

SPACE: dict[str, BaseDistribution] = {"x": FloatDistribution(1e-4, 1.0, log=True), "n": IntDistribution(0, 20)}
SEARCH = Search(SPACE, population=3, iterations=4, start={"x": 0.01, "n": 10})
optuna.logging.set_verbosity(optuna.logging.WARNING)


def value(params: dict[str, Any]) -> float:
    return -((params["n"] - 7) ** 2) - (params["x"] - 0.3) ** 2


@dataclasses.dataclass(frozen=True)
class Objective:
    """A cheap function; it hangs, raises or dies in chosen trials."""

    folder: str
    hang: tuple[int, ...] = ()
    raise_from: int = 1_000
    die_from: int = 1_000

    def _hang(self, held: object) -> None:
        """Hold what is to be tidied up once this process has ended, as a training run does, and wait for that."""
        time.sleep(600)

    def __call__(self, trial: Trial) -> float:
        if trial.number in self.hang:
            aside = Path(self.folder, f"{trial.number}.partial")
            aside.write_text(str(os.getpid()))
            held = multiprocessing.Lock()
            aside.rename(Path(self.folder, f"{trial.number}.pid"))
            self._hang(held)
        if trial.number >= self.raise_from:
            raise OSError("no such gripper")
        if trial.number >= self.die_from:
            os._exit(7)
        return value(trial.params)


def start_study(folder: Path, trials: int, search: Search = SEARCH, storage: str = "", **keys: Any) -> Task:
    """Create a study in a folder and return what its workers are to do."""
    optuna.create_study(storage=open_storage(storage, folder), study_name="s", direction="maximize")
    return Task(Objective(str(folder), **keys), search, str(folder), storage, "s", trials)


def slots(study: optuna.Study) -> dict[tuple[int, int], tuple[dict[str, Any], float | None]]:
    """Return parameters and value of every slot."""
    held = [trial for trial in study.get_trials() if trial.state == TrialState.COMPLETE]
    found = {slot: (trial.params, trial.value) for trial in held if (slot := slot_of(trial)) is not None}
    assert len(found) == len(held), "two trials hold one slot"
    return found


def undisturbed(trials: int) -> dict[tuple[int, int], tuple[dict[str, Any], float | None]]:
    """Return the slots of a study in this process, one trial after another."""
    sampler = WhaleSampler(3, 4, start=SEARCH.start, space=SPACE)
    study = optuna.create_study(sampler=sampler, direction="maximize")
    for _ in range(trials):
        trial = study.ask(SPACE)
        study.tell(trial, value(trial.params))
    return slots(study)


def wait_for(path: Path, alive: Callable[[], bool] = lambda: True) -> None:
    while not path.exists():
        assert alive()
        time.sleep(0.02)


def kill_hanging(folder: Path, numbers: tuple[int, ...], signal_number: int = signal.SIGKILL) -> threading.Thread:
    """Kill the workers of trials that hang, each as soon as it does."""

    def kill() -> None:
        for number in numbers:
            wait_for(folder / f"{number}.pid")
            os.kill(int((folder / f"{number}.pid").read_text()), signal_number)

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize("storage", ["journal", "sqlite"])
def test_a_study_whose_workers_are_killed_three_times_ends_like_an_undisturbed_one(
    storage: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    hang = (1, 4, 8)
    place = "" if storage == "journal" else f"sqlite:///{tmp_path}/study.db"
    task = start_study(tmp_path, 12, storage=place, hang=hang)
    killer = kill_hanging(tmp_path, hang)
    study = supervise(task, workers=2)
    killer.join()
    assert slots(study) == undisturbed(12)
    failed = [trial for trial in study.get_trials() if trial.state == TrialState.FAIL and LOST in trial.user_attrs]
    assert [trial.number for trial in failed] == list(hang)
    assert not study.get_trials(states=(TrialState.RUNNING,))
    assert "is gone" in capfd.readouterr().out


def test_a_study_resumed_in_new_processes_proposes_what_an_uninterrupted_one_does(tmp_path: Path) -> None:
    task = start_study(tmp_path, 4)
    supervise(task, workers=1)
    supervise(dataclasses.replace(task, trials=8), workers=2)
    assert slots(supervise(dataclasses.replace(task, trials=12), workers=2)) == undisturbed(12)


INTERRUPTED = """
import sys
from pathlib import Path
from nerf_rl.tuning.supervisor import supervise
from test_tuning_study import start_study

if __name__ == "__main__":
    supervise(start_study(Path(sys.argv[1]), 12, hang=(4,)), workers=2)
"""


def test_an_interrupted_study_leaves_nothing_running_and_goes_on(tmp_path: Path) -> None:
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED)
    paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)], stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": paths}
    )
    wait_for(tmp_path / "4.pid", alive=lambda: process.poll() is None)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode != 0 and b"KeyboardInterrupt" in errors and b"leaked" not in errors
    study = optuna.load_study(study_name="s", storage=open_storage("", tmp_path))
    assert not study.get_trials(states=(TrialState.RUNNING,))
    task = Task(Objective(str(tmp_path)), SEARCH, str(tmp_path), "", "s", 12, len(study.get_trials()))
    assert slots(supervise(task, workers=1)) == undisturbed(12)


def test_workers_end_when_their_supervisor_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "orphans.py"
    script.write_text(INTERRUPTED)
    paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen([sys.executable, str(script), str(tmp_path)], env={**os.environ, "PYTHONPATH": paths})
    wait_for(tmp_path / "4.pid", alive=lambda: process.poll() is None)
    process.kill()
    process.wait()
    worker = int((tmp_path / "4.pid").read_text())
    deadline = time.monotonic() + 30
    while heartbeat._born(worker):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_three_errors_in_a_row_end_a_study_with_the_reason(tmp_path: Path) -> None:
    task = start_study(tmp_path, 12, raise_from=2)
    with pytest.raises(FailureError, match="3 trials in a row failed, the last one with OSError: no such gripper"):
        supervise(task, workers=2)
    task = dataclasses.replace(task, objective=Objective(str(tmp_path)), first=100)
    assert slots(supervise(task, workers=1)) == undisturbed(12)  # once the reason is mended, the study goes on


def test_workers_that_keep_dying_end_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nerf_rl.tuning.supervisor._MOST_DEATHS", 2)
    with pytest.raises(FailureError, match="workers died 3 times and finished nothing meanwhile"):
        supervise(start_study(tmp_path, 12, die_from=0), workers=1)


@pytest.mark.parametrize("sampler", ["tpe", "cmaes", "random"])
def test_other_samplers_finish_a_study_too(sampler: str, tmp_path: Path) -> None:
    search = dataclasses.replace(SEARCH, sampler=sampler, prune=True)
    study = supervise(start_study(tmp_path, 6, search), workers=1)
    values = [trial.params["x"] for trial in study.get_trials(states=(TrialState.COMPLETE,))]
    assert len(values) == len(set(values)) == 6


def test_trials_of_silent_workers_elsewhere_are_failed_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage = open_storage("", tmp_path)
    study = optuna.create_study(storage=storage)
    now = 0.0
    monkeypatch.setattr(heartbeat, "time", types.SimpleNamespace(monotonic=lambda: now))
    elsewhere = {"host": "far", "machine": "far 1", "pid": 1, "born": "1", "beat": 1}
    silent, beating, never_began, ours = (study.ask() for _ in range(4))
    for trial in (silent, beating):
        trial.set_user_attr(HEARTBEAT, elsewhere)
    Heart(storage).beat(ours)
    lost = LostTrials(storage)
    assert lost.fail(study) == []
    now = 30.0
    assert lost.fail(study) == [never_began.number]
    now = 170.0
    beating.set_user_attr(HEARTBEAT, {**elsewhere, "beat": 2})
    assert lost.fail(study) == []
    now = 200.0
    assert lost.fail(study) == [silent.number]
    assert study.get_trials()[0].user_attrs[LOST] == "nothing heard from far for 200 s"
    assert [trial.state.name for trial in study.get_trials()] == ["FAIL", "RUNNING", "FAIL", "RUNNING"]


def test_a_study_that_ends_leaves_no_trial_that_never_had_a_first_beat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heartbeat, "_START_PATIENCE", 0.2)
    storage = open_storage("", tmp_path)
    study = optuna.create_study(storage=storage)
    study.ask()
    Heart(storage).beat(study.ask())
    LostTrials(storage).settle(study)
    assert [trial.state.name for trial in study.get_trials()] == ["FAIL", "RUNNING"]


def test_a_pid_that_another_process_has_taken_over_is_not_the_worker(tmp_path: Path) -> None:
    storage = open_storage("", tmp_path)
    study = optuna.create_study(storage=storage)
    trial = study.ask()
    Heart(storage).beat(trial)
    who = study.get_trials()[0].user_attrs[HEARTBEAT]
    trial.set_user_attr(HEARTBEAT, {**who, "born": "17"})
    assert LostTrials(storage).fail(study) == [0]


def reported(study: optuna.Study, slot: tuple[int, int], values: list[float], state: TrialState) -> FrozenTrial:
    """Add a trial with intermediate values at steps 1, 2, ..."""
    steps = dict(enumerate(values, 1))
    final = values[-1] if state == TrialState.COMPLETE else None
    study.add_trial(
        optuna.trial.create_trial(state=state, value=final, intermediate_values=steps, system_attrs={SLOT: list(slot)})
    )
    return study.get_trials()[-1]


def test_whales_below_the_median_of_earlier_generations_are_pruned() -> None:
    study, pruner = optuna.create_study(direction="maximize"), EarlierMedianPruner(warmup_steps=2)
    for whale, last in enumerate((1.0, 2.0, 3.0, 4.0)):
        reported(study, (0, whale), [0.0, last], TrialState.COMPLETE)
    reported(study, (1, 0), [0.0, 100.0], TrialState.COMPLETE)  # of the same generation: does not count
    poor = reported(study, (1, 1), [0.0, 2.4], TrialState.RUNNING)
    good = reported(study, (1, 2), [0.0, 2.6], TrialState.RUNNING)
    early = reported(study, (1, 3), [-9.0], TrialState.RUNNING)
    was_good = reported(study, (1, 4), [2.6, 0.0], TrialState.RUNNING)
    diverged = reported(study, (1, 5), [float("nan"), float("nan")], TrialState.RUNNING)
    pruned = [pruner.prune(study, trial) for trial in (poor, good, early, was_good, diverged)]
    assert pruned == [True, False, False, False, True]
    first = reported(study, (0, 7), [0.0, -9.0], TrialState.RUNNING)
    assert not pruner.prune(study, first)


def test_workers_of_sessions_that_share_a_storage_draw_apart_and_those_of_one_folder_alike(tmp_path: Path) -> None:
    drawn = []
    for name in ("a", "b", "c", "d"):
        folder = tmp_path / name
        folder.mkdir()
        storage = "" if name in "ab" else f"sqlite:///{folder}/study.db"
        task = start_study(folder, 2, dataclasses.replace(SEARCH, sampler="random"), storage)
        drawn.append([trial.params for trial in supervise(task, workers=1).get_trials()])
    assert drawn[0] == drawn[1] and drawn[2] != drawn[3]


def test_a_storage_that_is_busy_for_a_moment_does_not_end_the_heartbeat(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heartbeat, "_INTERVAL", 0.01)
    beats = []

    def write(storage: object, trial: object, name: str, content: dict[str, Any]) -> None:
        beats.append(content["beat"])
        if len(beats) == 3:
            raise OSError("database is locked")

    monkeypatch.setattr(heartbeat, "write_note", write)
    study = optuna.create_study()
    with heartbeat.Heart(study._storage).beating(study.ask()):
        while len(beats) < 6:
            time.sleep(0.01)
    assert beats == sorted(set(beats))
