"""Training seeds side by side: each in a process of its own, on this machine or on a Ray cluster."""

import functools
import os
import signal
from collections.abc import Callable, Collection, Generator
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

from nerf_rl.errors import FailureError
from nerf_rl.machine.backends import RAY
from nerf_rl.machine.cores import usable_cores
from nerf_rl.machine.processes import delay_interrupts, start_server, worker_context
from nerf_rl.machine.worker_pools import MOST_DEATHS, RayProcesses, through_deaths
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.sweeps.seed_process import STILL_TRAINED, Train, train_seed

_SIGNALS = {int(known): known.name for known in signal.Signals}


@dataclass(frozen=True)
class SeedEnd:
    """How the process of a seed ended."""

    seed: int
    error: str
    """what befell it; nothing if it is finished"""


def training_modules(device: str) -> tuple[str, ...]:
    """Return the modules that the server of processes which train on a device is to have imported.

    With a GPU there are none: TorchRL asks for GPUs when it is imported, which may start a runtime that survives no
    fork.
    """
    if device != "cpu":
        return ()
    return ("nerf_rl.rl.train", "nerf_rl.rl.training.loop", "nerf_rl.rl.environments.make")


def begin_seeds(config: TrainRLConfig) -> None:
    """Begin the imports of the processes that train seeds here, which take seconds, beside what this process does."""
    if config.backend != RAY:
        start_server(training_modules(config.device))


def train_seeds_apart(
    train: Train, config: TrainRLConfig, seeds: Collection[int], say: Callable[[str], None] = print
) -> Generator[SeedEnd, None, None]:
    """Train seeds, as many at a time as ``config.workers`` says; yields each when its process has ended.

    Runs that were begun go on from their last checkpoint. Close the iterator to end early: all processes are ended.

    Args:
        train: from a run's configuration to its run folder; can be pickled.
        config: of the sweep; its ``out`` holds ``config.yaml``.
        seeds: which.
        say: called with a line when processes of a cluster that wait for seeds were lost.

    Raises:
        FailureError: those processes keep dying.
        UserError: the cluster cannot be had.
    """
    if config.backend == RAY:
        yield from _train_on_a_cluster(train, config, seeds, say)
    else:
        yield from _train_here(train, config, seeds, config.workers or max(1, usable_cores() // config.threads))


def _train_here(
    train: Train, config: TrainRLConfig, seeds: Collection[int], workers: int
) -> Generator[SeedEnd, None, None]:
    context = worker_context(training_modules(config.device))
    left, running = list(seeds), dict[Any, tuple[int, BaseProcess]]()  # by what becomes ready when a process ends
    try:
        while left or running:
            while left and len(running) < workers:
                seed = left.pop(0)
                process = context.Process(
                    target=train_seed, args=(train, config, seed, os.getcwd()), name=f"seed-{seed}"
                )
                with delay_interrupts():
                    process.start()
                    running[process.sentinel] = seed, process
            for sentinel in wait(list(running)):
                seed, process = running.pop(sentinel)
                process.join()
                yield SeedEnd(seed, _error(process.exitcode))
    finally:
        for _, process in running.values():
            process.kill()
            process.join()


def _train_on_a_cluster(
    train: Train, config: TrainRLConfig, seeds: Collection[int], say: Callable[[str], None]
) -> Generator[SeedEnd, None, None]:
    pool = RayProcesses()
    workers = config.workers or max(1, pool.processors() // config.threads)

    def after_death(in_a_row: int) -> None:
        if in_a_row >= MOST_DEATHS:
            raise FailureError(
                f"the processes that wait for seeds died {in_a_row} times in a row; go on with --resume true"
            )
        say("a process that waited for a seed died; seeds go on from their last checkpoints")

    def attempt(seeds: list[int]) -> Generator[SeedEnd, None, None]:
        calls = (functools.partial(_train_one, train, config, seed, os.getcwd()) for seed in seeds)
        return pool.as_they_end(calls, workers)

    yield from through_deaths(list(seeds), attempt, lambda end: end.seed, pool.deaths, after_death)


def _train_one(train: Train, config: TrainRLConfig, seed: int, folder: str) -> SeedEnd:
    """Train a seed in a process of its own and wait for its end; runs in a process of Ray's."""
    os.chdir(folder)  # what relative paths begin in
    return next(_train_here(train, config, [seed], 1))


def _error(code: int | None) -> str:
    """Return what befell a process that ended with this code, or nothing if it did its work."""
    if code is None or code == 0:
        return ""
    if code == STILL_TRAINED:
        return "another process still trains it"
    return f"ended by {_SIGNALS.get(-code, f'signal {-code}')}" if code < 0 else f"exit code {code}"
