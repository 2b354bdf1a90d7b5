"""What RL Baselines3 Zoo's plot scripts read: ``monitor.csv`` of training episodes and ``evaluations.npz``.

Both have the form that Stable-Baselines3's ``Monitor`` and ``EvalCallback`` give them, so that curves of runs of ours
and of the Zoo can be drawn by the same scripts. A step there is an environment step, action repeats counted. A resumed
run drops what came after its checkpoint and goes on with the rest.
"""

import csv
import io
import json
import time
import zipfile
from pathlib import Path

import numpy as np
from numpy import ndarray

from nerf_rl.files.atomic import atomic_write, write_text
from nerf_rl.rl.training.episodes import Episodes

MONITOR, EVALUATIONS_NPZ = "monitor.csv", "evaluations.npz"
_COLUMNS = ("r", "l", "t", "is_success", "env_steps")  # the first three are the Zoo's; without success it is left empty


class ZooFiles:
    """Writes both files of a run.

    Args:
        run: the run folder.
        scene: its name, for the head of ``monitor.csv``.
        env_steps: where the run goes on; 0 begins both files anew.
    """

    def __init__(self, run: Path, scene: str, env_steps: int = 0):
        self._monitor, self._evaluations = run / MONITOR, run / EVALUATIONS_NPZ
        head, rows = _kept_episodes(self._monitor, env_steps)
        text = io.StringIO()
        text.write(f"#{json.dumps(head or {'t_start': time.time(), 'env_id': scene})}\n")
        writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(self._monitor, text.getvalue())
        self._results = _kept_evaluations(self._evaluations, env_steps)
        if self._results:
            self._write_evaluations()
        else:
            self._evaluations.unlink(missing_ok=True)

    def add_episode(
        self, episode_return: float, length: int, seconds: float, success: bool | None, env_steps: int
    ) -> None:
        """Append a training episode that has ended.

        Args:
            episode_return: sum of its rewards.
            length: environment steps.
            seconds: time of training so far [s].
            success: whether it succeeded; None where the environment does not tell.
            env_steps: of the run so far.
        """
        told = "" if success is None else int(success)
        row = (f"{episode_return:.6f}", length, f"{seconds:.6f}", told, env_steps)
        with open(self._monitor, "a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow(row)

    def add_evaluation(self, env_steps: int, episodes: Episodes) -> None:
        """Add an evaluation, in place of one after as many steps, and write all of them again.

        The arrays have a row for each evaluation, and as many columns as the one with the fewest episodes has: those
        are of the same seeds in all of them.
        """
        new: dict[str, ndarray] = {"results": episodes.returns, "ep_lengths": episodes.length}
        if episodes.success is not None:
            new["successes"] = episodes.success
        steps = self._results.get("timesteps", np.empty(0, np.int64))
        before = steps < env_steps
        held = {name: self._results[name][before] for name in new if name in self._results}
        if not before.any():
            held = {name: np.empty((0, len(row)), row.dtype) for name, row in new.items()}
        fewest = min(len(episodes.returns), held["results"].shape[1])
        rows = {name: np.concatenate([kept[:, :fewest], new[name][None, :fewest]]) for name, kept in held.items()}
        self._results = {"timesteps": np.append(steps[before], env_steps), **rows}
        self._write_evaluations()

    def _write_evaluations(self) -> None:
        with atomic_write(self._evaluations) as aside:
            np.savez(aside, **self._results)  # type: ignore[arg-type]  # numbers alone, so that nothing is pickled


def _kept_episodes(path: Path, env_steps: int) -> tuple[dict, list[dict[str, str]]]:
    """Return the head of ``monitor.csv`` and its rows up to some environment steps; nothing without the file."""
    if not env_steps:
        return {}, []
    try:
        with open(path, newline="", encoding="utf-8") as file:
            head = json.loads(file.readline()[1:])
            rows = list(csv.DictReader(line for line in file if line.endswith("\n")))
        return {name: head[name] for name in ("t_start", "env_id")}, [
            {name: row[name] for name in _COLUMNS} for row in rows if int(row["env_steps"]) <= env_steps
        ]
    except (OSError, ValueError, LookupError, TypeError, AttributeError, csv.Error):
        return {}, []  # it only serves plots: a run is not held up by it


def _kept_evaluations(path: Path, env_steps: int) -> dict[str, ndarray]:
    """Return what ``evaluations.npz`` holds up to some environment steps; nothing where there is no such file."""
    if not env_steps:
        return {}
    try:
        with np.load(path, allow_pickle=False) as file:
            held = {name: file[name] for name in file.files}
        steps = held["timesteps"]
        shape = (len(steps), held["results"].shape[1])
        if any(values.dtype.kind not in "biuf" or values.shape not in (shape, shape[:1]) for values in held.values()):
            return {}
        kept = steps <= env_steps
        return {name: values[kept] for name, values in held.items()} if kept.any() else {}
    except (OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, zipfile.BadZipFile):
        return {}
