"""SIGTERM, by which a cluster's scheduler or a container asks a process to end before it is killed."""

import os
import signal
import threading
from types import FrameType


class Termination:
    """While entered, SIGTERM interrupts this process as Ctrl-C does, so that it ends its children and says so.

    A second one ends it at once. Where somebody handles or ignores the signal already, or outside the main thread,
    nothing is changed. Who handles it later and calls this handler, too, as Lightning does, which ends training after a
    step, is left to do so: an interruption in the midst of one may come where Python ignores it.
    """

    def __init__(self) -> None:
        self.asked = False
        """whether the signal came"""
        self._process = os.getpid()
        self._ours = False

    def __enter__(self) -> "Termination":
        in_main_thread = threading.current_thread() is threading.main_thread()
        self._ours = in_main_thread and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        if self._ours:
            signal.signal(signal.SIGTERM, self._interrupt)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if os.getpid() != self._process:  # a fork, which whoever ends it expects to end at once
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGTERM)
        self.asked = True
        if signal.getsignal(signal.SIGTERM) == self._interrupt:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            raise KeyboardInterrupt
