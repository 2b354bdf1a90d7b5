"""Room on the disk: how much a dataset needs, how much there is, and what to say when it runs out."""

import contextlib
import errno
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from nerf_rl.datasets.storage.shards import Layout, bytes_of_a_frame
from nerf_rl.errors import FailureError

_OVERHEAD_OF_A_SHARD = 32 * 1024  # HDF5's own structures [bytes]
_FULL = (errno.ENOSPC, errno.EDQUOT)
_RESUME = "finished shards are kept: free some space and run the same command with --resume true"


def bytes_needed(layout: Layout, frames: int, shards: int) -> int:
    """Return the size of some shards with ``frames`` frames in all [bytes]."""
    return frames * bytes_of_a_frame(layout) + shards * _OVERHEAD_OF_A_SHARD


def bytes_free(folder: Path) -> int:
    """Return the free space [bytes] of the disk that a folder is on, or will be."""
    folder = folder.absolute()
    return shutil.disk_usage(next(path for path in (folder, *folder.parents) if path.exists())).free


def readable(size: int) -> str:
    """Return a number of bytes in words."""
    units = iter(("bytes", "kB", "MB", "GB", "TB"))
    number, unit = float(size), next(units)
    while number >= 1000 and unit != "TB":
        number, unit = number / 1000, next(units)
    return f"{number:.0f} {unit}" if unit == "bytes" or number >= 100 else f"{number:.1f} {unit}"


def require_space(folder: Path, needed: int, less: str = "fewer --episodes or a smaller --size") -> None:
    """Check that there is room for ``needed`` more bytes.

    Args:
        folder: that they are for.
        needed: [bytes].
        less: what makes a dataset smaller, in words.

    Raises:
        FailureError: there is not.
    """
    free = bytes_free(folder)
    if needed > free:
        raise FailureError(
            f"{folder} needs {readable(needed)} and its disk has {readable(free)} free; free some space, choose "
            f"another --out, or {less}"
        )


@contextlib.contextmanager
def explain_full_disk(folder: Path, missing: Callable[[], int] | None = None, remedy: str = _RESUME) -> Iterator[None]:
    """Turn the error of a full disk into a sentence that tells what is needed.

    Args:
        folder: that is written to.
        missing: tells how many bytes are still to be written; None if nobody knows.
        remedy: what was kept and how to go on, in words.

    Raises:
        FailureError: the disk became full.
    """
    try:
        yield
    except Exception as error:
        if not _tells_of_a_full_disk(error):
            raise
        needed = f"{readable(missing())} are still to be written and " if missing is not None else ""
        free = f"{readable(bytes_free(folder))} are free"
        raise FailureError(f"the disk of {folder} is full: {needed}{free}; {remedy}") from error


def _tells_of_a_full_disk(error: BaseException | None) -> bool:
    while error is not None:
        written = re.search(r"errno = (\d+)", str(error))  # HDF5's own words, which may come without the number
        if getattr(error, "errno", None) in _FULL or (written and int(written[1]) in _FULL):
            return True
        error = error.__cause__ or error.__context__
    return False
