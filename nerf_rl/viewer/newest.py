"""Work whose newest order is the only one that matters."""

import threading
import time
import traceback
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class NewestOnly(Generic[T]):
    """Runs a function in a thread of its own, with the newest argument; what it had no time for is forgotten.

    Args:
        function: takes an argument, and a function that tells whether a newer one has arrived meanwhile.
        pause: shortest time between two runs [s].
    """

    def __init__(self, function: Callable[[T, Callable[[], bool]], None], pause: float = 0.0):
        self._function, self._pause = function, pause
        self._changed = threading.Condition()
        self._waiting: list[T] = []
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def order(self, argument: T) -> None:
        """Ask for a run; returns at once."""
        with self._changed:
            self._waiting = [argument]
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until nothing is left to do; return whether that came within ``timeout`` [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: self._closed or not (self._busy or self._waiting), timeout)

    def close(self) -> None:
        """Take no more orders and wait a little for the one under way."""
        with self._changed:
            self._closed = True
            self._waiting = []
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)

    def _stale(self) -> bool:
        return self._closed or bool(self._waiting)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or bool(self._waiting))
                if self._closed:
                    return
                argument, self._busy = self._waiting.pop(), True
            begun = time.monotonic()
            try:
                self._function(argument, self._stale)
            except Exception:  # a picture that fails must not end the viewer
                traceback.print_exc()
            with self._changed:
                self._changed.wait_for(lambda: self._closed, max(0.0, begun + self._pause - time.monotonic()))
