"""Output folders: what may be written where, and the record of how each result was made."""

import contextlib
import dataclasses
import importlib.metadata
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from nerf_rl import __version__
from nerf_rl.errors import OutputExistsError

_RECORDED_PACKAGES = ("torch", "torchrl", "lightning", "mujoco", "metaworld", "gymnasium", "h5py", "numpy", "optuna")
PROVENANCE = "provenance.json"
SUMMARY = "summary.json"


def check_output(
    folder: Path, overwrite: bool, resume: bool = False, can_resume: bool = False, command: str = ""
) -> None:
    """Check, without touching it, that an output folder is free or may be resumed or overwritten.

    Only a folder that a command of ours wrote (it holds ``provenance.json``) is ever overwritten.

    Args:
        folder: the output folder.
        overwrite, resume: what the user asked for.
        can_resume: whether the folder holds something to resume from.
        command: the sub-command; what it left when it was cut off too early to resume may be begun anew by ``resume``.

    Raises:
        OutputExistsError: the folder holds something and neither applies.
    """
    if not _in_use(folder) or (resume and (can_resume or _cut_off_early(folder, command))):
        return
    ours = (folder / PROVENANCE).is_file()
    if not overwrite:
        resuming = "--resume true, " if can_resume and ours else ""
        raise OutputExistsError(folder, f"use {resuming}--overwrite true or another --out")
    if not ours:
        raise OutputExistsError(folder, f"it holds no {PROVENANCE}, so it is not overwritten; use another --out")


def prepare_output(
    folder: Path, overwrite: bool, resume: bool = False, can_resume: bool = False, command: str = ""
) -> None:
    """Create an output folder, or empty or keep an existing one, after :func:`check_output`."""
    check_output(folder, overwrite, resume, can_resume, command)
    if _in_use(folder) and not (resume and can_resume):
        _empty(folder)
    folder.mkdir(parents=True, exist_ok=True)


def _in_use(folder: Path) -> bool:
    return folder.exists() and (not folder.is_dir() or any(folder.iterdir()))


def _empty(folder: Path) -> None:
    """Delete what a folder holds; its provenance goes last, so that one cut off meanwhile may be overwritten again."""
    for path in sorted(folder.iterdir(), key=lambda path: path.name == PROVENANCE):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _cut_off_early(folder: Path, command: str) -> bool:
    """Tell whether a run of the command was begun in the folder and left no result."""
    begun = folder / PROVENANCE
    return begun.is_file() and not (folder / SUMMARY).exists() and read_json(begun)["command"] == command


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a place to write a file to, so that the file exists whole or not at all.

    What was written there is flushed to disk and renamed; if writing fails, it is removed, and an older file stays. The
    place has the file's suffix, since some writers choose the format by it. The file gets the permissions that the
    user's umask gives to new files, whatever those are that its writer creates it with.
    """
    aside = path.with_name(f".partial-{path.name}")
    aside.unlink(missing_ok=True)
    aside.touch()
    permissions = aside.stat().st_mode & 0o777
    try:
        yield aside
        aside.chmod(permissions)
        rename_durably(aside, path)
    finally:
        aside.unlink(missing_ok=True)


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
    with written_whole(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write JSON whole or not at all; numbers that JSON has no word for (NaN, infinity) are an error."""
    write_text(path, json_text(content))


def json_text(content: Any) -> str:
    """Return what :func:`write_json` writes; the same content gives the same text."""
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        OSError: it cannot be read.
        ValueError: it holds something else, or numbers that JSON has no word for.
    """
    return parse_json(path.read_bytes())


def parse_json(content: bytes) -> Any:
    """Return what JSON in UTF-8 says; raise ValueError for anything else, and for lists nested without end."""
    try:
        return json.loads(content.decode(), parse_constant=_refuse_constant)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _refuse_constant(name: str) -> None:
    raise ValueError(f"it holds {name}, which is no JSON")


def write_provenance(folder: Path, command: str, config: Any) -> None:
    """Write the resolved configuration and the versions behind a run: ``config.yaml`` and ``provenance.json``.

    Args:
        folder: the output folder.
        command: the sub-command's name.
        config: its configuration, a dataclass.
    """
    write_text(folder / "config.yaml", yaml.safe_dump(plain(config), sort_keys=False))
    write_json(
        folder / PROVENANCE,
        {
            "command": command,
            "arguments": sys.argv[1:],
            "seed": getattr(config, "seed", None),
            "nerf_rl": __version__,
            "git_revision": git_revision(),
            "python": sys.version.split()[0],
            "packages": package_versions(),
        },
    )


def plain(value: Any) -> Any:
    """Turn dataclasses, paths and tuples into what YAML and JSON can say."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def git_revision() -> str | None:
    """Return the revision of the checkout this package runs from, with ``-dirty`` for uncommitted changes, if any."""
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return described.stdout.strip() if described.returncode == 0 else None


def package_versions() -> dict[str, str]:
    """Return the versions of the packages that results depend on."""
    versions = {}
    for name in _RECORDED_PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def peak_rss_mb() -> float:
    """Return the peak resident memory of this process so far [MB]."""
    with contextlib.suppress(OSError):  # on Linux, getrusage's figure begins with that of the process that started this
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)
