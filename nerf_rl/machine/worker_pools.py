"""The processes that joblib hands work to: on this machine by loky, on a cluster by Ray.

Both are processes even if there is one worker only, because a process can be ended and replaced when it hangs, and this
one cannot. OpenGL contexts do not survive a fork; loky and Ray start processes afresh.
"""

import contextlib
import os
import warnings
from collections.abc import Callable, Generator, Iterable
from typing import Any, TypeAlias, TypeVar

from joblib import Parallel
from joblib._parallel_backends import LokyBackend, ParallelBackendBase
from joblib.executor import get_memmapping_executor
from joblib.externals.loky.process_executor import BrokenProcessPool

from nerf_rl.errors import UserError
from nerf_rl.machine.extras import import_extra
from nerf_rl.machine.processes import ignore_sigint, start_worker

MOST_DEATHS = 3
"""in a row, without a finished piece of work in between, after which to give up"""
Backend: TypeAlias = ParallelBackendBase
"""of joblib; its class is public in all but its module's name"""
Result = TypeVar("Result")


class LocalProcesses(LokyBackend):
    """joblib's loky backend, whose processes are ended with the work and are not left to idle."""

    def configure(
        self, n_jobs: int = 1, parallel: Any = None, prefer: Any = None, require: Any = None, **options: Any
    ) -> int:
        """Prepare to start ``n_jobs`` processes."""
        self._workers = get_memmapping_executor(
            n_jobs, env=self._prepare_worker_env(n_jobs), initializer=start_worker, context_id=parallel._id
        )
        self._started = False
        self.parallel = parallel
        return max(n_jobs, 2)  # joblib would take one job as none of its own process

    def submit(self, func: Callable[[], Any], callback: Callable[[Any], Any] | None = None) -> Any:
        """Hand work over; the first piece is what starts the processes.

        Nothing is handed over before it to start them sooner: loky compares a process's memory with what it was after
        its first piece of work, and replaces one that has 300 MB more by another, which begins with its imports again.
        """
        starts, self._started = not self._started, True
        with ignore_sigint() if starts else contextlib.nullcontext():
            return super().submit(func, callback)

    def terminate(self) -> None:
        """End the processes."""
        if self._workers is not None:
            self._workers.terminate()
            self._workers = None
        self.reset_batch_stats()


def open_backend(name: str) -> tuple[Backend, tuple[type[Exception], ...]]:
    """Return the joblib backend, and the errors by which it tells that a process died.

    Args:
        name: ``loky`` or ``ray``.

    Raises:
        UserError: Ray is not installed or no cluster answers.
    """
    if name == "loky":
        return LocalProcesses(), (BrokenProcessPool,)
    return _connect_to_ray()


def as_they_end(calls: Iterable[Any], workers: int, backend: Backend) -> Generator[Any, None, None]:
    """Yield the results of ``joblib.delayed`` calls in the order in which they end, ``workers`` running at a time.

    Close the iterator to end early: all processes are ended.
    """
    parallel = Parallel(
        workers, backend=backend, return_as="generator_unordered", batch_size=1, pre_dispatch=2 * workers
    )
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(tasks|worker)")  # joblib and loky tell of an early end
        with contextlib.closing(parallel(calls)) as results:
            yield from results


def through_deaths(
    missing: list[int],
    attempt: Callable[[list[int]], Generator[Result, None, None]],
    number: Callable[[Result], int],
    deaths: tuple[type[Exception], ...],
    after_death: Callable[[int], None],
) -> Generator[Result, None, None]:
    """Attempt numbered pieces of work again, as processes die, until none is missing; yields the result of each.

    Args:
        missing: numbers of the pieces; those that are done leave it.
        attempt: begins work on the pieces that it is given.
        number: tells which piece a result is of.
        deaths: errors by which an attempt tells that a process died.
        after_death: called with the deaths in a row so far; may change the order of ``missing``, and raises an error if
            there were too many of them (``MOST_DEATHS``).
    """
    in_a_row = 0
    while missing:
        try:
            with contextlib.closing(attempt(list(missing))) as results:
                for result in results:
                    missing.remove(number(result))
                    in_a_row = 0
                    yield result
        except deaths:
            in_a_row += 1
            after_death(in_a_row)


def _connect_to_ray() -> tuple[Backend, tuple[type[Exception], ...]]:
    ray = import_extra("ray", "ray", "--backend ray")
    from ray.util.joblib.ray_backend import RayBackend

    class RayProcesses(RayBackend):
        """Ray's joblib backend, which hands results over as they come."""

        supports_return_generator = True

    if not ray.is_initialized():
        address = os.environ.get("RAY_ADDRESS", "auto")
        try:
            ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        except ConnectionError as error:
            raise UserError(
                f"no Ray cluster answers at '{address}'; start one with ray start --head, or set RAY_ADDRESS"
            ) from error
    return RayProcesses(), (ray.exceptions.RayError,)
