"""The processes that calls are handed to: on this machine forks of a clean server, on a cluster Ray's.

Both are processes even if there is one worker only, because a process can be ended and replaced when it hangs, and this
one cannot. OpenGL contexts do not survive a fork; the server that local processes are forks of has none.
"""

import contextlib
import itertools
import multiprocessing
import os
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, Protocol, TypeVar, runtime_checkable

from nerf_rl.errors import UserError
from nerf_rl.machine.extras import import_extra
from nerf_rl.machine.processes import delay_interrupts, start_worker, worker_context

MOST_DEATHS = 3
"""in a row, without a finished call in between, after which to give up"""
_WAITING = 2  # calls that are handed out for each worker, so that none waits for its next one
Result = TypeVar("Result")
Call = Callable[[], Result]
"""Can be pickled, as can its result."""


@runtime_checkable
class Pool(Protocol):
    """Processes that calls are handed to."""

    deaths: tuple[type[Exception], ...]
    """errors by which it tells that a process died"""

    def as_they_end(self, calls: Iterable[Call[Result]], workers: int) -> Generator[Result, None, None]:
        """Yield the results of calls in the order in which they end, ``workers`` running at a time.

        Close the iterator to end early: what still runs is ended. An error of a call is raised here.
        """
        ...


class LocalProcesses:
    """Processes of this machine: forks of a server that has imported what they need, ended with the work."""

    deaths: tuple[type[Exception], ...] = (BrokenProcessPool,)

    def __init__(self, modules: Sequence[str]):
        self._modules = modules

    def as_they_end(self, calls: Iterable[Call[Result]], workers: int) -> Generator[Result, None, None]:
        """See :class:`Pool`; if a process dies, all end."""
        context = worker_context(self._modules)
        others = set(multiprocessing.active_children())
        pool = ProcessPoolExecutor(workers, context, initializer=start_worker)
        left, running = iter(calls), set[Future[Result]]()
        try:
            while True:
                with delay_interrupts():  # handing a call over may start a process
                    running |= {pool.submit(call) for call in itertools.islice(left, _WAITING * workers - len(running))}
                if not running:
                    return
                ended, running = wait(running, return_when=FIRST_COMPLETED)
                for future in ended:
                    yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
            pool.shutdown()


class RayProcesses:
    """Processes of the Ray cluster that ``RAY_ADDRESS`` names, or of the one that this machine is part of.

    Raises:
        UserError: Ray is not installed or no cluster answers.
    """

    def __init__(self) -> None:
        self._ray = ray = import_extra("ray", "ray", "--backend ray")
        self.deaths: tuple[type[Exception], ...] = (ray.exceptions.RayError,)
        if not ray.is_initialized():
            address = os.environ.get("RAY_ADDRESS", "auto")
            try:
                ray.init(address=address, log_to_driver=False, logging_level="ERROR")
            except ConnectionError as error:
                raise UserError(
                    f"no Ray cluster answers at '{address}'; start one with ray start --head, or set RAY_ADDRESS"
                ) from error

    def processors(self) -> int:
        """Return how many processors the cluster has."""
        return int(self._ray.cluster_resources().get("CPU", 1))

    def as_they_end(self, calls: Iterable[Call[Result]], workers: int) -> Generator[Result, None, None]:
        """See :class:`Pool`; if a process dies, the others are ended."""
        remote = self._ray.remote(max_retries=0)(_do)
        left, running = iter(calls), list[Any]()
        try:
            while True:
                running += [remote.remote(call) for call in itertools.islice(left, workers - len(running))]
                if not running:
                    return
                ended, running = self._ray.wait(running)
                yield self._result(ended[0])
        finally:
            for reference in running:
                self._ray.cancel(reference, force=True)

    def _result(self, reference: Any) -> Any:
        try:
            return self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:  # the call's own error, which is no death
            raise error.cause from error


def _do(call: Call[Result]) -> Result:
    return call()


def through_deaths(
    missing: list[int],
    attempt: Callable[[list[int]], Generator[Result, None, None]],
    number: Callable[[Result], int],
    deaths: tuple[type[Exception], ...],
    after_death: Callable[[int], None],
) -> Generator[Result, None, None]:
    """Attempt numbered calls again, as processes die, until none is missing; yields the result of each.

    Args:
        missing: numbers of the calls; those that are done leave it.
        attempt: begins the calls whose numbers it is given.
        number: tells which call a result is of.
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
