"""Training seeds side by side: each in a process of its own, on this machine or on a Ray cluster."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Collection, Generator
from dataclasses import dataclass
from pathlib import Path

import joblib
from joblib import delayed

from nerf_rl.errors import FailureError
from nerf_rl.files.folder_lock import lock
from nerf_rl.machine.worker_pools import MOST_DEATHS, Backend, as_they_end, open_backend, through_deaths
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.sweeps.runs import run_folder

_PATIENCE = 60.0  # [s] for which a seed waits for processes that an interrupted sweep left

_SIGNALS = {int(known): known.name for known in signal.Signals}


@dataclass(frozen=True)
class SeedEnd:
    """How the process of a seed ended."""

    seed: int
    error: str
    """what befell it; nothing if it is finished"""


def log_of(out: Path, seed: int) -> Path:
    """Return the file that holds what a seed's process said."""
    return out / "logs" / f"seed-{seed}.log"


def train_seeds_apart(
    config: TrainRLConfig, seeds: Collection[int], say: Callable[[str], None] = print
) -> Generator[SeedEnd, None, None]:
    """Train seeds, as many at a time as ``config.workers`` says; yields each when its process has ended.

    Runs that were begun go on from their last checkpoint. Close the iterator to end early: all processes are ended.

    Args:
        config: of the sweep; its ``out`` holds ``config.yaml``.
        seeds: which.
        say: called with a line when the processes that wait for seeds were lost.

    Raises:
        FailureError: those processes keep dying.
        UserError: the backend cannot be had.
    """
    backend, deaths = open_backend(config.backend)

    def after_death(in_a_row: int) -> None:
        if in_a_row >= MOST_DEATHS:
            raise FailureError(
                f"the processes that wait for seeds died {in_a_row} times in a row; go on with --resume true"
            )
        say("a process that waited for a seed died; seeds go on from their last checkpoints")

    def attempt(seeds: list[int]) -> Generator[SeedEnd, None, None]:
        calls = (delayed(train_seed)(config.out, seed, config.threads, os.getcwd()) for seed in seeds)
        return as_they_end(calls, _workers(config, len(seeds), backend), backend)

    yield from through_deaths(list(seeds), attempt, lambda end: end.seed, deaths, after_death)


def _workers(config: TrainRLConfig, seeds: int, backend: Backend) -> int:
    """Return how many seeds are trained at a time."""
    if config.backend == "ray":  # for one job joblib would start no process
        return max(2, min(config.workers or backend.effective_n_jobs(-1) // config.threads, seeds))
    return max(1, min(config.workers or joblib.cpu_count() // config.threads, seeds))


def train_seed(out: str, seed: int, threads: int, folder: str) -> SeedEnd:
    """Train a seed in a process of its own and wait for its end; runs in a process of joblib's.

    Args:
        out: folder of the sweep.
        seed: which.
        threads: that a process may use for a computation.
        folder: what relative paths begin in.
    """
    try:
        os.chdir(folder)
        log = log_of(Path(out), seed)
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "ab") as file:
            # the seed's process, and those of its environments, write to the same open file, and the lock is held until
            # the last of them has gone: so none is left of an earlier sweep, however that one ended
            if not lock(file.fileno(), _PATIENCE):
                return SeedEnd(seed, "another process still trains it")
            return SeedEnd(seed, _ended(_start(out, seed, threads, file.fileno())))
    except OSError as error:
        return SeedEnd(seed, f"it could not be started ({error})")


def _start(out: str, seed: int, threads: int, log: int) -> subprocess.Popen:
    program = [sys.executable, "-P", "-m", "nerf_rl.rl.sweeps.seed_process", "--config", str(Path(out) / "config.yaml")]
    keys = {"out": run_folder(Path(out), seed), "seed": seed, "seeds": "", "resume": "true", "overwrite": "false"}
    words = [f"--{key}={value}" for key, value in keys.items()]
    modules = os.pathsep.join(path or os.getcwd() for path in sys.path)  # what this process finds, that one finds too
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads), "PYTHONPATH": modules}
    return subprocess.Popen(
        [*program, *words], stdin=subprocess.PIPE, stdout=log, stderr=subprocess.STDOUT, env=environment
    )


def _ended(process: subprocess.Popen) -> str:
    """Wait for a process; return what befell it, or nothing if it did its work."""
    with process:  # keeps its standard input open
        code = process.wait()
    if code < 0:
        return f"ended by {_SIGNALS.get(-code, f'signal {-code}')}"
    return f"exit code {code}" if code else ""
