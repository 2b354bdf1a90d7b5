"""Environments in processes of their own: stepped, reset and closed, and what goes wrong there told in a sentence."""

from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import TimeoutError as SilentError
from typing import Any

import gymnasium
import numpy as np
from numpy import ndarray

from nerf_rl.errors import FailureError

OVERTIME = "overtime"
"""of the options of a reset: steps for which an episode goes on after its first success, beyond the time limit"""
TIMEOUT = 300.0
"""[s] a process that is silent for so long has hung"""


def step_all(envs: Any, action: ndarray) -> tuple[ndarray, ndarray, ndarray, ndarray, dict[str, Any]]:
    """Take an action [E, A] in all environments, as their ``step`` does, which would wait for ever.

    Raises:
        FailureError: an environment cannot step, or its process has ended or hangs.
    """
    begin_step(envs, action)
    return finish_step(envs)


def begin_step(envs: Any, action: ndarray) -> None:
    """Begin to take an action [E, A] in all environments; raise as :func:`step_all` does."""
    with told():
        envs.step_async(action)


def finish_step(envs: Any) -> tuple[ndarray, ndarray, ndarray, ndarray, dict[str, Any]]:
    """Wait for what :func:`begin_step` began; raise as :func:`step_all` does."""
    with told():
        return envs.step_wait(timeout=TIMEOUT)


def reset_some(envs: Any, which: ndarray, seeds: list[int], overtime: int = 0) -> ndarray:
    """Start new episodes in the environments where ``which`` [E] is true; return all observations [E, O].

    Args:
        envs: with autoreset disabled.
        which: environments.
        seeds: one for each environment; those of the others are not used.
        overtime: environment steps for which the episodes go on after their first success, even beyond the time limit.

    Raises:
        FailureError: an environment cannot reset, or its process has ended or hangs.
    """
    mask = np.asarray(which, dtype=np.bool_)
    with told():
        envs.reset_async(seed=list(seeds), options={"reset_mask": mask, OVERTIME: overtime})
        observations, _ = envs.reset_wait(timeout=TIMEOUT)
    return observations


def call_all(envs: Any, name: str) -> tuple[Any, ...]:
    """Return what a method of each environment returns; raise as :func:`step_all` does."""
    with told():
        envs.call_async(name)
        return envs.call_wait(timeout=TIMEOUT)


def close_all(envs: Any) -> None:
    """End the processes, also those that are in the midst of something, or have ended."""
    with _without_gymnasiums_words():
        try:
            envs.close(terminate=True)
        except (EOFError, OSError):  # it waits for a step that is under way, of a process that is no more
            for process in envs.processes:
                process.terminate()
                process.join()
            envs.closed = True


@contextmanager
def told(
    remedy: str = "training goes on from its last checkpoint with --resume true",
    cause: str = "something killed it, such as want of memory",
) -> Iterator[None]:
    """Say in a sentence that a process has ended or hangs; what an environment itself tells is a sentence already.

    Args:
        remedy: how to go on.
        cause: of an end.
    """
    try:
        with _without_gymnasiums_words():
            yield
    except SilentError as error:
        raise FailureError(
            f"the process of an environment has not answered for {TIMEOUT:g} s: it hangs; {remedy}"
        ) from error
    except (EOFError, BrokenPipeError, ConnectionResetError) as error:
        raise FailureError(f"the process of an environment has ended: {cause}; {remedy}") from error


@contextmanager
def _without_gymnasiums_words() -> Iterator[None]:
    """Keep Gymnasium from printing a traceback, which fails at a per cent sign in it, before it raises the error."""
    level = gymnasium.logger.min_level
    gymnasium.logger.min_level = gymnasium.logger.ERROR + 1
    try:
        yield
    finally:
        gymnasium.logger.min_level = level
