"""Files of a source, which somebody else wrote: none outside its folder is read, and none without end."""

import hashlib
from pathlib import Path, PurePosixPath
from typing import Any

from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.files.json_files import parse_json
from nerf_rl.files.structure import Checker

_MOST_JSON = 1 << 26  # [bytes]


def file_inside(folder: Path, name: str, named_by: Path) -> Path:
    """Return a file's path that a description names.

    Args:
        folder: that the file must lie in.
        name: its path below the folder, with slashes.
        named_by: the description, to be told of.

    Raises:
        SourceError: there is no such file, or it lies outside the folder, be it by a link.
    """
    parts = PurePosixPath(name).parts
    if not parts or PurePosixPath(name).is_absolute() or ".." in parts or not name.isprintable() or "\\" in name:
        raise SourceError(named_by, f"it names {name!r}, which is no path below its folder")
    path = folder / name
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise SourceError(named_by, f"it names {name}, a link that leads out of its folder (cp -rL makes a copy)")
        if not path.is_file():
            raise SourceError(named_by, f"it names {name}, which is not there")
    except (OSError, RuntimeError, ValueError) as error:  # too long a name, links in a circle
        reason = getattr(error, "strerror", None) or "its links lead in a circle"
        raise SourceError(named_by, f"it names {name[:200]}, which cannot be read ({reason})") from error
    return path


def read_description(path: Path, structure: Checker) -> Any:
    """Return the content of a JSON file.

    Raises:
        SourceError: it is too large, no JSON, or of another structure.
    """
    try:
        if path.stat().st_size > _MOST_JSON:
            raise ValueError(f"it is larger than {_MOST_JSON} bytes")
        content = parse_json(path.read_bytes())
        structure(content, "")
    except (OSError, ValueError) as error:
        raise SourceError(path, str(error)) from error
    return content


class SourceDigest:
    """Tells one source from another: by what its descriptions say, and by the names and sizes of its other files."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def describe(self, path: Path) -> None:
        """Count in a file's content."""
        self._digest.update(path.read_bytes())

    def name(self, path: Path) -> None:
        """Count in a file's name and size."""
        self._digest.update(f"{path.name} {path.stat().st_size}\n".encode())

    def text(self) -> str:
        """Return the SHA-256 in hexadecimal."""
        return self._digest.hexdigest()
