"""Output folders: what may be written where, and the record of how each result was made."""

import contextlib
import dataclasses
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from nerf_rl import __version__
from nerf_rl.errors import OutputExistsError, UserError
from nerf_rl.files.atomic import is_partial, write_text
from nerf_rl.files.folder_lock import hold_folder, release_folder
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.versions import git_revision, package_versions, processor

PROVENANCE = "provenance.json"
SUMMARY = "summary.json"


def check_output(
    folder: Path, overwrite: bool, resume: bool = False, can_resume: bool = False, command: str = ""
) -> None:
    """Check, without touching it, that an output folder is free or may be resumed or overwritten.

    Only a folder that a command of ours wrote (it holds ``provenance.json``, or nothing but what one had not finished
    writing) is ever overwritten.

    Args:
        folder: the output folder.
        overwrite, resume: what the user asked for.
        can_resume: whether the folder holds something to resume from.
        command: the sub-command; what it left when it was cut off too early to resume may be begun anew by ``resume``.

    Raises:
        OutputExistsError: the folder holds something and neither applies.
        UserError: it, or a folder above it, is a link to what there is not.
    """
    broken = next((path for path in (folder, *folder.parents) if path.is_symlink() and not path.exists()), None)
    if broken is not None:
        raise UserError(f"{broken} is a link to {broken.readlink()}, which there is not; make it, or use another --out")
    if folder.exists() and not folder.is_dir():
        raise OutputExistsError(folder, "a folder is what is written; use another --out")
    unfinished = folder.is_dir() and all(map(is_partial, folder.iterdir()))  # by a process that was killed
    if not _in_use(folder) or (resume and (can_resume or unfinished or _cut_off_early(folder, command))):
        return
    ours = unfinished or (folder / PROVENANCE).is_file()
    if not overwrite:
        resuming = "--resume true, " if can_resume and ours else ""
        raise OutputExistsError(folder, f"use {resuming}--overwrite true or another --out")
    if not ours:
        raise OutputExistsError(folder, f"it holds no {PROVENANCE}, so it is not overwritten; use another --out")


def require_outside(folder: Path, *sources: str | Path) -> None:
    """Check that nothing which a command reads lies in its output folder, where overwriting would delete it.

    Raises:
        UserError: something does.
    """
    for source in sources:
        path = Path(source)
        if path.exists() and path.resolve().is_relative_to(folder.resolve()):
            raise UserError(f"{source} lies in the output folder {folder}; use another --out")


def require_place(path: Path) -> Path:
    """Check, without touching it, that a path can be written to; return the nearest folder that there is, or itself.

    Raises:
        UserError: something that should be a folder above it is a file.
    """
    there = next(above for above in (path.absolute(), *path.absolute().parents) if above.exists())
    if not there.is_dir() and there != path.absolute():
        raise UserError(f"{path} cannot be written, since {there} is a file and no folder; choose another name")
    return there


def require_file_place(path: Path) -> None:
    """Check, without touching it, that a file can be written or replaced.

    Raises:
        UserError: a folder has its name, or something that should be a folder above it is a file.
    """
    require_place(path)
    if path.is_dir():
        raise UserError(f"{path} cannot be written, since it is a folder and no file; choose another name")


@contextlib.contextmanager
def making(path: Path) -> Iterator[None]:
    """Tell in a sentence why the system does not let a folder be made, or a file be written.

    Raises:
        UserError: instead of the system's OSError, whether it is of permissions, of the file system or of the name.
    """
    try:
        yield
    except OSError as error:
        raise UserError(f"{path} cannot be written ({error.strerror or error}); choose another name") from error


def prepare_output(
    folder: Path, overwrite: bool, resume: bool = False, can_resume: bool = False, command: str = ""
) -> None:
    """Create an output folder, or empty or keep an existing one, after :func:`check_output`, and hold it.

    Raises:
        UserError: another process writes to it, or it cannot be made.
    """
    check_output(folder, overwrite, resume, can_resume, command)
    was_free = not _in_use(folder)
    with making(folder):
        folder.mkdir(parents=True, exist_ok=True)
    hold_folder(folder)
    if was_free and _in_use(folder):  # by a process that has ended since: what it wrote has not been asked about
        release_folder(folder)
        raise OutputExistsError(folder, "another process has just written it; use another --out")
    if _in_use(folder) and not (resume and can_resume):
        _empty(folder)


def _in_use(folder: Path) -> bool:
    return folder.exists() and any(folder.iterdir())


def _empty(folder: Path) -> None:
    """Delete what a folder holds; its provenance goes last, so that one cut off meanwhile may be overwritten again."""
    for path in sorted(folder.iterdir(), key=lambda path: path.name == PROVENANCE):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _cut_off_early(folder: Path, command: str) -> bool:
    """Tell whether a run of the command was begun in the folder and left no result."""
    return not (folder / SUMMARY).exists() and command_of(folder) == command


def command_of(folder: Path) -> str | None:
    """Return the sub-command that wrote a folder; None if it is none of ours, or what says so is damaged."""
    try:
        content = read_json(folder / PROVENANCE)
    except (OSError, ValueError):
        return None
    return content.get("command") if isinstance(content, dict) else None


def write_provenance(folder: Path, command: str, config: Any) -> None:
    """Write the versions behind a run and its resolved configuration: ``provenance.json`` and ``config.yaml``.

    Provenance comes first, since without it a folder that was cut off here would be taken for somebody else's.

    Args:
        folder: the output folder.
        command: the sub-command's name.
        config: its configuration, a dataclass.
    """
    record = {
        "command": command,
        "arguments": sys.argv[1:],
        "seed": getattr(config, "seed", None),
        "nerf_rl": __version__,
        "git_revision": git_revision(),
        "python": sys.version.split()[0],
        "packages": package_versions(),
        "processor": processor(),
    }
    write_json(folder / PROVENANCE, record)
    write_text(folder / "config.yaml", yaml.safe_dump(plain(config), sort_keys=False))


def plain(value: Any) -> Any:
    """Turn dataclasses, paths and tuples into what YAML and JSON can say."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value
