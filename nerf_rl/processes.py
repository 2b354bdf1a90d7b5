"""Child processes, and who of them hears Ctrl-C."""

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def unmoved_by_interrupts() -> Iterator[None]:
    """Let processes that are started here ignore Ctrl-C from their first instruction on; this one does so meanwhile.

    A handler that a process sets itself comes seconds late, after its imports. Only the main thread can tell the
    children to ignore it; in another one nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
