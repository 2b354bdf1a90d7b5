"""Where studies are kept: a journal file that outlives killed writers, or any URL that Optuna knows."""

import fcntl
import os
from pathlib import Path

from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import BaseJournalBackend, JournalFileBackend, JournalRedisBackend

from nerf_rl.errors import UserError

JOURNAL = "study.journal"
_FIRST_WORDS = b'{"op_code":'


class KernelLock:
    """An exclusive lock on a journal, which the kernel takes back when its holder dies.

    Optuna's own locks are files; one that is left by a killed process stops all others for half a minute. A killed
    process may also leave an unfinished last line, which the next line would be appended to, and which would make the
    journal unreadable; so whoever takes the lock removes it.

    Args:
        journal: the journal file.
    """

    def __init__(self, journal: Path):
        self._journal, self._file = journal, -1

    def acquire(self) -> bool:
        """Wait for the lock."""
        self._file = os.open(self._journal, os.O_RDWR | os.O_CREAT, 0o666)
        fcntl.flock(self._file, fcntl.LOCK_EX)
        _drop_unfinished_line(self._file)
        return True

    def release(self) -> None:
        """Give the lock back."""
        os.close(self._file)
        self._file = -1


def open_storage(storage: str, out: Path) -> BaseStorage:
    """Open, or create, the storage of a study.

    Args:
        storage: empty for a journal in the output folder, a journal's path, or a URL of Optuna's.
        out: the output folder.

    Raises:
        UserError: it cannot be opened, say because a database driver or the journal's folder is missing, or because the
            file is something else, which is left as it is.
    """
    path = Path(storage) if storage else out / JOURNAL
    if "://" not in storage:
        _require_journal(path)
    try:
        if "://" not in storage:
            backend: BaseJournalBackend = JournalFileBackend(str(path), lock_obj=KernelLock(path))  # type: ignore[arg-type]
            return JournalStorage(backend)
        if storage.startswith("redis"):
            return JournalStorage(JournalRedisBackend(storage))
        patience = {"connect_args": {"timeout": 60}} if storage.startswith("sqlite") else {}
        return RDBStorage(storage, engine_kwargs=patience)
    except Exception as error:  # each database driver has errors of its own
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"--storage {storage or path} cannot be opened: {reason}") from error


def _require_journal(path: Path) -> None:
    """Raise UserError if there can be no journal, or if there is something else, by the beginning of its first line."""
    if not path.parent.is_dir():
        raise UserError(f"--storage {path} cannot be opened: there is no folder {path.parent}")
    if not path.exists():
        return
    begins = b""
    if path.is_file():
        with open(path, "rb") as file:
            begins = file.read(len(_FIRST_WORDS))
    if not path.is_file() or not _FIRST_WORDS.startswith(begins):  # a killed writer may have left less than all of it
        raise UserError(f"--storage {path} is no journal of Optuna's; a database has a URL, such as sqlite:///study.db")


def _drop_unfinished_line(file: int) -> None:
    """Cut off what follows the last line end."""
    end = size = os.fstat(file).st_size
    while end > 0:
        start = max(0, end - 4096)
        found = os.pread(file, end - start, start).rfind(b"\n")
        if found >= 0:
            end = start + found + 1
            break
        end = start
    if end < size:
        os.ftruncate(file, end)
