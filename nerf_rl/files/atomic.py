"""Files that exist whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

_PARTIAL = ".partial-"


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Give a place to write a file to, so that the file exists whole or not at all.

    What was written there is flushed to disk and renamed; if writing fails, it is removed, and an older file stays. The
    place has the file's suffix, since some writers choose the format by it. The file gets the permissions that the
    user's umask gives to new files, whatever those are that its writer creates it with.
    """
    aside = path.with_name(f"{_PARTIAL}{path.name}")
    aside.unlink(missing_ok=True)
    aside.touch()
    permissions = aside.stat().st_mode & 0o777
    try:
        yield aside
        aside.chmod(permissions)
        rename_durably(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def is_partial(path: Path) -> bool:
    """Tell whether a file is what a process that was killed had not finished writing."""
    return path.name.startswith(_PARTIAL)


def rename_durably(aside: Path, path: Path) -> None:
    """Flush a file to disk and give it its name, which is on disk too when this returns."""
    _flush(aside)
    os.replace(aside, path)
    _flush(path.parent)


def _flush(path: Path) -> None:
    """Wait until a file's content, or a folder's list of names, is on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")
