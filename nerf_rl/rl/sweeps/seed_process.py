"""The process that trains one seed of a sweep: it has a folder and a log of its own, and concerns no other seed."""

import dataclasses
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nerf_rl.errors import FailureError, UserError
from nerf_rl.files.folder_lock import lock
from nerf_rl.machine.processes import start_worker, tidy_up_alone
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.sweeps.runs import run_folder

Train = Callable[[TrainRLConfig], Any]
STILL_TRAINED = 75
"""exit code of a process whose seed another one trains (EX_TEMPFAIL)"""
_PATIENCE = 60.0  # [s] for which a seed waits for processes that an interrupted sweep left


def log_of(out: Path, seed: int) -> Path:
    """Return the file that holds what a seed's process said."""
    return out / "logs" / f"seed-{seed}.log"


def train_seed(train: Train, sweep: TrainRLConfig, seed: int, folder: str) -> None:
    """Train a seed, from its last checkpoint if it was begun; the entry of a process, which it ends.

    It exits with what ``nerf-rl train-rl`` would exit with.

    Args:
        train: from a run's configuration to its run folder.
        sweep: configuration of the sweep.
        seed: which.
        folder: what relative paths begin in.
    """
    start_worker()
    os.chdir(folder)
    try:
        file = _open_log(log_of(Path(sweep.out), seed))
    except OSError as error:
        sys.exit(f"nerf-rl train-rl: seed {seed} cannot be started ({error})")
    for output in (1, 2):
        os.dup2(file, output)
    tidy_up_alone()
    os.environ["OMP_NUM_THREADS"] = str(sweep.threads)
    out = str(run_folder(Path(sweep.out), seed))
    sys.exit(_exit_code(train, dataclasses.replace(sweep, out=out, seed=seed, seeds="", resume=True, overwrite=False)))


def _open_log(path: Path) -> int:
    """Return the descriptor of a seed's log, once no other process writes to it; end this one if that never comes.

    The processes of its environments write to the same open file, and the lock is held until the last of them has gone:
    so none is left of an earlier sweep, however that one ended.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    if not lock(file, _PATIENCE):
        sys.exit(STILL_TRAINED)
    return file


def _exit_code(train: Train, config: TrainRLConfig) -> int:
    try:
        train(config)
    except (UserError, FailureError) as error:
        print(f"nerf-rl train-rl: {error}", file=sys.stderr)
        return 2 if isinstance(error, UserError) else 1
    return 0
