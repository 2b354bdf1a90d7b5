"""Child processes: who of them hears Ctrl-C, and that none outlives the process that started it."""

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any

from nerf_rl.machine.gl import use_one_software_thread

FORK_SERVER = "forkserver"


@contextlib.contextmanager
def delay_interrupts() -> Iterator[None]:
    """Hold Ctrl-C, and SIGTERM where it is handled, back until the end of what is done here, and raise them then.

    A process that is begun waits for the imports of the server that it is a fork of; whoever begins it would not know
    of it if that was interrupted. Handlers are the main thread's; in another one nothing is changed.
    """
    held = list[int]()

    def hold(number: int, frame: object) -> None:
        held.append(number)

    with contextlib.ExitStack() as handlers:
        for handled in (signal.SIGINT, signal.SIGTERM):
            if callable(signal.getsignal(handled)):
                handlers.enter_context(_handler(handled, hold))
        yield
    for number in held:
        signal.raise_signal(number)


@contextlib.contextmanager
def _handler(number: int, handler: Any) -> Iterator[None]:
    """Let a handler have a signal meanwhile, if this is the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def start_method(modules: Sequence[str]) -> str:
    """Return how to start worker processes that need ``modules``: as forks of a server that has imported them.

    The server is a fresh process without OpenGL, CUDA and threads of Python's (those of libraries for matrices know of
    forks), so that its forks are as clean as spawned processes are; but imports are paid for once and their memory is
    shared. Whoever asks first decides what the server imports; a fork imports what else it needs. Forks have the
    environment variables that this process had when it first asked for one.

    Args:
        modules: by their full names; their imports must start nothing.
    """
    if FORK_SERVER not in multiprocessing.get_all_start_methods():  # Windows
        return "spawn"
    multiprocessing.set_forkserver_preload(list(modules))
    return FORK_SERVER


def worker_context(modules: Sequence[str]) -> Any:
    """Return multiprocessing's context whose processes are forks of :func:`start_server`'s server if there can be one.

    Start them within :func:`delay_interrupts`; they ignore Ctrl-C.
    """
    start_server(modules)
    return multiprocessing.get_context(start_method(modules))


def start_server(modules: Sequence[str]) -> None:
    """Let the server of :func:`start_method` begin its imports, while this process goes on with its own.

    It ignores Ctrl-C from its first instruction on, and so do its forks: a handler that a process sets itself comes
    seconds late, after its imports.

    Args:
        modules: as there; they are those that the server has if it is running already.
    """
    if start_method(modules) == FORK_SERVER:
        from multiprocessing import forkserver  # Windows has none

        with _handler(signal.SIGINT, signal.SIG_IGN):  # which a process inherits; starting one takes a moment
            forkserver.ensure_running()


def start_worker() -> None:
    """Prepare a process of this machine: it uses one core, leaves Ctrl-C to its parent, and ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_one_software_thread()
    end_with_parent()


def tidy_up_alone() -> None:
    """Let what this process shares with its children be tidied up by a process of its own once they are gone.

    A fork of a server leaves that to the process which started it, which then complains of what a killed fork has left.
    Nothing public tells multiprocessing so; this was checked with Python 3.11, and where it does nothing, only the
    complaint is back.
    """
    resource_tracker._resource_tracker._fd = None  # type: ignore[attr-defined]


def end_with_parent() -> None:
    """End this process soon after the one that started it has gone, however it went."""
    started_by = multiprocessing.parent_process()
    target, arguments = (_end_after, (started_by,)) if started_by else (_end_with, (os.getppid(),))
    threading.Thread(target=target, args=arguments, daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    parent.join()  # not the server that this process may be a fork of, which lives as long as its forks do
    os._exit(1)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)
