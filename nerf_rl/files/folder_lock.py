"""One process at a time writes to an output folder, by locks of the system's."""

import contextlib
import fcntl
import os
import time
from pathlib import Path

from nerf_rl.errors import UserError

_PATIENCE = 10.0  # [s]; processes that a killed one has forked hold its folder until they have noticed
_held: dict[tuple[int, int], int] = {}
"""open descriptors of the folders that this process holds, by device and inode"""


def hold_folder(folder: Path) -> None:
    """Keep other processes from writing to a folder until this one releases it or ends, however it ends.

    The lock is the system's, on the folder itself, and leaves no file behind. Where a file system has no locks, nothing
    is held.

    Raises:
        UserError: another process holds it.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    about = os.fstat(descriptor)
    key = (about.st_dev, about.st_ino)
    if key in _held:
        os.close(descriptor)
        return
    try:
        locked = lock(descriptor, _PATIENCE)
    except OSError:  # a file system without locks
        os.close(descriptor)
        return
    if not locked:
        os.close(descriptor)
        raise UserError(f"another process is writing to {folder}; wait until it has ended, or use another --out")
    _held[key] = descriptor


def release_folder(folder: Path) -> None:
    """Let other processes write to a folder that this one holds, if it does."""
    about = folder.stat()
    if (descriptor := _held.pop((about.st_dev, about.st_ino), None)) is not None:
        os.close(descriptor)


def release_folders() -> None:
    """Let other processes write to the folders that this one holds."""
    while _held:
        os.close(_held.popitem()[1])


def lock(descriptor: int, patience: float) -> bool:
    """Lock an open file or folder; return whether that was possible within ``patience`` seconds."""
    start = time.monotonic()
    while True:
        with contextlib.suppress(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        if time.monotonic() - start > patience:
            return False
        time.sleep(0.1)
