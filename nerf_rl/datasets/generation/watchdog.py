"""Noticing render processes that hang or whose command has gone.

A process shows that it is alive by beats: it touches the file that its shard is written to, and puts off an alarm
that would end it. The alarm is C code that needs neither Python's lock nor the main thread, so it also ends a process
that is stuck inside an OpenGL driver; the command that started the process watches the file, and ends one that is
stopped altogether.
"""

import contextlib
import faulthandler
import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from nerf_rl.datasets.storage.shards import partial_files

_SECONDS_BETWEEN_BEATS = 1.0
_PATIENCE = 1.25  # the command waits longer than the process's own alarm, which shows where it hung


@contextlib.contextmanager
def alarm(partial: Path, timeout: float) -> Iterator[Callable[[], None]]:
    """End this process if there is no beat for ``timeout`` seconds; yields the function to call for a beat.

    Args:
        partial: the file to touch; it is removed at the end if it is still there.
        timeout: longest time between two beats [s].
    """
    last = -float("inf")

    def beat() -> None:
        nonlocal last
        if time.monotonic() - last >= min(_SECONDS_BETWEEN_BEATS, timeout / 4):
            last = time.monotonic()
            partial.touch()
            faulthandler.dump_traceback_later(timeout, exit=True, file=2)

    beat()
    try:
        yield beat
    finally:
        faulthandler.cancel_dump_traceback_later()
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def lookout(folder: Path, shards: Collection[int], timeout: float) -> Iterator[None]:
    """Meanwhile, kill processes of this one whose shard has seen no beat for somewhat more than ``timeout`` seconds."""
    stop = threading.Event()
    thread = threading.Thread(target=_look_out, args=(folder, shards, timeout * _PATIENCE, stop), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _look_out(folder: Path, shards: Collection[int], timeout: float, stop: threading.Event) -> None:
    seen: dict[Path, tuple[int, float]] = {}  # file to the time it was last touched, and when that was first seen
    while not stop.wait(min(1.0, timeout / 4)):
        now = time.monotonic()
        current = {}
        for path, (_, pid) in partial_files(folder, shards).items():
            with contextlib.suppress(OSError):  # the shard was finished meanwhile
                touched = path.stat().st_mtime_ns
                before, since = seen.get(path, (None, now))
                current[path] = (touched, since if touched == before else now)
                if now - current[path][1] > timeout and _is_ours(pid):
                    os.kill(pid, signal.SIGKILL)
        seen = current


def _is_ours(pid: int) -> bool:
    """Tell whether this process started another one, or a server of its own did."""
    while pid > 1:
        try:
            status = Path(f"/proc/{pid}/stat").read_text()
        except OSError:
            return False
        pid = int(status.rpartition(")")[2].split()[1])
        if pid == os.getpid():
            return True
    return False
