"""Who works on a trial, and whether they still live.

A worker writes its machine and process beside its running trial, and a new beat every half minute. On the same machine
whoever looks finds a dead process at once; another machine's worker is given up when its beat has stood still for long,
by the clock of whoever looks, so clocks need not agree.
"""

import contextlib
import os
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from optuna import Study
from optuna.exceptions import UpdateFinishedTrialError
from optuna.storages import BaseStorage
from optuna.trial import FrozenTrial, TrialState

from nerf_rl.tuning.trial_notes import AnyTrial, write_note

HEARTBEAT = "heartbeat"
LOST = "lost"
_INTERVAL = 30.0  # [s]
_REMOTE_PATIENCE = 180.0  # [s] without a beat from another machine
_START_PATIENCE = 10.0  # [s] without a first beat


class Heart:
    """Writes the beats of this process.

    Args:
        storage: of the study.
    """

    def __init__(self, storage: BaseStorage):
        self._storage = storage
        self._beats, self._last = 0, -_INTERVAL
        self._trial = -1

    def beat(self, trial: AnyTrial) -> None:
        """Write a beat beside a running trial, unless the last one was just now."""
        if trial.number == self._trial and time.monotonic() - self._last < _INTERVAL:
            return
        self._trial, self._last, self._beats = trial.number, time.monotonic(), self._beats + 1
        pid = os.getpid()
        who = {"host": socket.gethostname(), "machine": _machine(), "pid": pid, "born": _born(pid), "beat": self._beats}
        write_note(self._storage, trial, HEARTBEAT, who)

    @contextlib.contextmanager
    def beating(self, trial: AnyTrial) -> Iterator[None]:
        """Beat on while a trial runs; a trial that others have given up is beaten for no more."""
        stop = threading.Event()

        def go_on() -> None:
            while not stop.wait(_INTERVAL):
                try:
                    self.beat(trial)
                except UpdateFinishedTrialError:  # given up
                    return
                except Exception:  # a storage that is busy or out of reach, for a while perhaps
                    self._trial = -1

        self.beat(trial)
        thread = threading.Thread(target=go_on, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()


class LostTrials:
    """Fails running trials whose worker is gone.

    Args:
        storage: of the study.
    """

    def __init__(self, storage: BaseStorage):
        self._storage = storage
        self._seen: dict[int, tuple[int, float]] = {}

    def fail(self, study: Study) -> list[int]:
        """Fail the trials that are lost now; return their numbers."""
        lost = []
        for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
            reason = self._reason(trial)
            if reason:
                with contextlib.suppress(Exception):  # someone else was faster
                    write_note(self._storage, trial, LOST, reason)
                    study.tell(trial.number, state=TrialState.FAIL, skip_if_finished=True)
                    lost.append(trial.number)
        return lost

    def settle(self, study: Study) -> None:
        """Fail the trials that are lost, also those whose worker ended between drawing them and its first beat.

        Takes as long as a living worker may take to its first beat, if there is such a trial, and no time otherwise.
        """
        while True:
            self.fail(study)
            running = study.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
            if all(HEARTBEAT in trial.user_attrs for trial in running):
                return
            time.sleep(0.1)

    def _reason(self, trial: FrozenTrial) -> str:
        """Return why a trial is lost, or nothing."""
        who: dict[str, Any] = trial.user_attrs.get(HEARTBEAT, {})
        if who and who["machine"] == _machine():
            return "" if _born(who["pid"]) == who["born"] else f"its worker, process {who['pid']}, is gone"
        beat = who.get("beat", 0)
        last, since = self._seen.get(trial.number, (-1, 0.0))
        if beat != last:
            self._seen[trial.number] = beat, time.monotonic()
            return ""
        silent = time.monotonic() - since
        if not who:
            return "its worker was gone before it began" if silent > _START_PATIENCE else ""
        return f"nothing heard from {who['host']} for {silent:.0f} s" if silent > _REMOTE_PATIENCE else ""


def _machine() -> str:
    """Return a name that is the same for processes which see each other, and changes when the machine starts anew."""
    with contextlib.suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{socket.gethostname()} {boot} {os.readlink('/proc/self/ns/pid')}"
    return socket.gethostname()


def _born(pid: int) -> str:
    """Return when a process was started, in the kernel's ticks, or nothing if it is gone or a zombie."""
    try:
        state, *fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if state in "ZX" else fields[18]
