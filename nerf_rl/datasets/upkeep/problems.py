"""Finding what is wrong with a dataset on disk: any changed byte, and frames that show nothing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py

from nerf_rl.datasets.storage.frame_checks import array_faults, view_faults
from nerf_rl.datasets.storage.plan import PLAN
from nerf_rl.datasets.storage.shard_layout import known_arrays, locate_arrays
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS, read_manifest, sha256_of
from nerf_rl.datasets.storage.stored_manifest import total_frames
from nerf_rl.files.checksummed_json import is_whole
from nerf_rl.files.json_files import json_text
from nerf_rl.progress import Progress

_FRAMES_AT_ONCE = 16
IMPORT_AGAIN = "nerf-rl import with the same keys and --resume true writes what is damaged anew"
"""what mends a dataset of imported pictures"""


class Problem(NamedTuple):
    """Something wrong with a file of a dataset."""

    file: str
    """its path below the dataset's folder"""
    fault: str


def find_problems(folder: Path) -> list[Problem]:
    """Return what is wrong with a dataset; of one with a damaged manifest, only that.

    Raises:
        MissingFileError: the folder holds no finished dataset.
    """
    problems = [*record_problems(folder)]
    if not any(problem.file == MANIFEST for problem in problems):
        problems += shard_problems(folder, read_manifest(folder))
    return problems


def record_problems(folder: Path) -> Iterator[Problem]:
    """Yield what is wrong with the manifest and the plan.

    Raises:
        MissingFileError: the folder holds no finished dataset.
    """
    if not (folder / MANIFEST).is_file():
        read_manifest(folder)
    if not is_whole(folder / MANIFEST):
        yield Problem(MANIFEST, "its content does not match its checksum")
        return
    plan = json_text(read_manifest(folder)["config"]).encode()
    if not (folder / PLAN).is_file() or (folder / PLAN).read_bytes() != plan:
        yield Problem(PLAN, f"it is not what {MANIFEST} has as configuration")


def shard_problems(folder: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    """Yield what is wrong with the shards.

    Args:
        folder: of the dataset.
        manifest: an undamaged one.
    """
    entries = {entry["file"]: entry for entry in manifest["shards"]}
    expected = total_frames(manifest["config"])
    if sum(entry["frames"] for entry in entries.values()) != expected:
        yield Problem(MANIFEST, f"it counts other than {expected} frames")
    for path in sorted((folder / SHARDS).iterdir()) if (folder / SHARDS).is_dir() else []:
        if f"{SHARDS}/{path.name}" not in entries:
            yield Problem(f"{SHARDS}/{path.name}", f"{MANIFEST} does not name it")
    with Progress(len(entries), "shards") as progress:
        for file, entry in entries.items():
            fault = _shard_fault(folder / file, entry, manifest)
            if fault:
                yield Problem(file, fault)
            progress.advance()


def _shard_fault(path: Path, entry: dict[str, Any], manifest: dict[str, Any]) -> str | None:
    if not path.is_file():
        return "it is a folder" if path.is_dir() else "it is missing"
    if sha256_of(path) != entry.get("sha256"):
        return "its content has changed since it was made"
    cameras = [camera["name"] for camera in manifest["cameras"]]
    try:
        with h5py.File(path, "r") as file:
            frames = len(file["rgb"])
        if frames != entry["frames"]:
            return f"it has {frames} frames instead of {entry['frames']}"
        locate_arrays(path, frames, known_arrays(manifest))
        with h5py.File(path, "r") as file:
            return next(_content_faults(file, frames, cameras, len(manifest["classes"])), None)
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        return f"it cannot be read ({error})"


def _content_faults(file: h5py.File, frames: int, cameras: list[str], classes: int) -> Iterator[str]:
    """Yield what is wrong with a shard's frames."""
    episodes, steps = file["episode"][:], file["step"][:]
    for first in range(0, frames, _FRAMES_AT_ONCE):
        part = slice(first, first + _FRAMES_AT_ONCE)
        for index, fault in view_faults(file["rgb"][part], file["depth"][part]):
            frame, camera = first + index[0], cameras[index[1]]
            yield f"episode {episodes[frame]}, step {steps[frame]}: camera {camera} {fault}"
        if file["semantic"][part].max() >= classes:
            yield f"it has semantic classes beyond the {classes} that there are"
    for group in ("state", "cameras"):
        for name, array in file[group].items():
            yield from (f"{group}/{name} {fault}" for fault in array_faults(array[:]))
    yield from (f"reward {fault}" for fault in array_faults(file["reward"][:]))
