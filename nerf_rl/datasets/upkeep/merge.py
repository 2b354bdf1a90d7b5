"""Putting the parts of a dataset, rendered by several jobs or machines, together into the dataset of a single run."""

import contextlib
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from nerf_rl.datasets.storage.blind_cameras import warn_of_blind_cameras
from nerf_rl.datasets.storage.disk import explain_full_disk, require_space
from nerf_rl.datasets.storage.finished_shards import renderers_in, with_shards
from nerf_rl.datasets.storage.plan import PLAN, begun_plan, same_content
from nerf_rl.datasets.storage.shards import MANIFEST, PARTS, SHARDS, sha256_of, shard_file
from nerf_rl.datasets.upkeep.config import MergeConfig
from nerf_rl.errors import FailureError, MissingFileError, UserError
from nerf_rl.files.atomic import atomic_write
from nerf_rl.files.checksummed_json import CHECKSUM, is_whole, write_checksummed
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, require_outside, write_provenance
from nerf_rl.progress import Progress

_OF_SHARDS = ("shards", "frames", "renderer")  # keys of a manifest in which parts differ


def merge(config: MergeConfig) -> None:
    """Put parts together; shards and manifest are, byte for byte, those of the dataset made in one run.

    Raises:
        UserError: a folder holds no parts, parts are of different datasets, or the output folder is in use.
        FailureError: a part is missing, unfinished or damaged, or the disk is full.
    """
    folders = list({Path(folder).resolve(): Path(folder) for folder in config.parts}.values())
    out = Path(config.out) if config.out else folders[0]
    parts = [part for folder in folders for part in _finished_parts(folder)]
    manifests = {part: read_json(part / MANIFEST) for part in parts}
    description = _common_description(manifests)
    sources = _sources(manifests, description["config"])
    if out.resolve() not in (folder.resolve() for folder in folders):
        require_outside(out, *folders)
        begun = (out / PLAN).is_file()
        check_output(out, config.overwrite, config.resume, begun)
        if config.resume and begun and begun_plan([out / PLAN], description["config"]) is None:
            raise UserError(f"{out} was begun with another configuration; use another --out, or --overwrite true")
        missing = [path for path, entry in sources if not (out / entry["file"]).exists()]
        size = sum(path.stat().st_size for path in missing if path.is_file())
        if not config.overwrite:
            require_space(out, size)
        prepare_output(out, config.overwrite, config.resume, begun)
    else:
        size = 0
    with explain_full_disk(out, lambda: size):
        write_json(out / PLAN, description["config"])
        write_provenance(out, "merge", config)
        _gather(out, sources)
        for part in parts:
            if not (out / PARTS / part.name).exists():
                shutil.copytree(part, out / PARTS / part.name)
        named = [manifest["renderer"] for manifest in manifests.values()]
        renderers = {name for names in named for name in renderers_in(names)}  # several in one; none in an empty part
        manifest = with_shards(description, (entry for _, entry in sources), renderers)
        write_checksummed(out / MANIFEST, manifest)
        views = manifest["frames"] * len(manifest["cameras"])
        once = {part.name: part for part in parts}.values()  # of a part that lies in several folders
        seconds = sum(_measured(part, "seconds") for part in once)
        summary = {
            "frames": manifest["frames"],
            "views": views,
            "seconds": round(seconds, 2),
            "views_per_second": round(views / max(seconds, 0.01), 1),
            "renderer": manifest["renderer"],
            "worker_peak_rss_mb": max(_measured(part, "worker_peak_rss_mb") for part in once),
        }
        summary |= warn_of_blind_cameras(out)
        write_json(out / SUMMARY, summary)
    print(f"{out}: {summary['frames']} frames, {summary['views']} views of {len(once)} parts")


def _finished_parts(folder: Path) -> list[Path]:
    """Return the folders of a dataset's parts."""
    parts = sorted((folder / PARTS).glob("*-of-*"))
    if not parts:
        remedy = "make some with: nerf-rl gen-dataset --shard I/N"
        raise MissingFileError("a folder with parts of a dataset", folder, f"it holds no {PARTS}", remedy)
    for part in parts:
        number = part.name.replace("-of-", "/")
        again = f"gen-dataset --shard {number} --resume true"
        if not (part / MANIFEST).is_file() or not (part / SUMMARY).is_file():
            raise FailureError(f"part {number} in {folder} was not finished; finish it with {again}")
        if not is_whole(part / MANIFEST):
            raise FailureError(f"{part / MANIFEST} is damaged; write it again with {again}")
    return parts


def _common_description(manifests: dict[Path, dict[str, Any]]) -> dict[str, Any]:
    """Return what all parts say of their dataset alike."""
    described = {
        part: {key: value for key, value in manifest.items() if key not in (*_OF_SHARDS, CHECKSUM)}
        for part, manifest in manifests.items()
    }
    (first, common), *others = described.items()
    for part, description in others:
        for key in common:
            same = description.get(key) == common[key]
            if not same and not (key == "config" and same_content(description.get(key), common[key])):
                ways = (
                    f"{_shortly(common[key], description.get(key))} and {_shortly(description.get(key), common[key])}"
                )
                raise UserError(f"{first} and {part} are parts of different datasets; they differ in {key}: {ways}")
    return common


def _shortly(value: Any, other: Any) -> str:
    """Return a value in words; of two mappings, what differs."""
    if isinstance(value, dict) and isinstance(other, dict):
        value = {key: item for key, item in value.items() if other.get(key) != item}
    return str(value)


def _sources(manifests: dict[Path, dict[str, Any]], config: dict[str, Any]) -> list[tuple[Path, dict[str, Any]]]:
    """Return each shard's file and its manifest entry, in order."""
    found: dict[str, tuple[Path, dict[str, Any]]] = {}
    for part, manifest in manifests.items():
        for entry in manifest["shards"]:
            other = found.setdefault(entry["file"], (part.parent.parent / entry["file"], entry))
            if other[1] != entry:
                raise FailureError(f"{entry['file']} is in several parts with different content; leave one part out")
    wanted = [shard_file(number) for number in range(-(-config["episodes"] // config["episodes_per_shard"]))]
    missing = [Path(file).stem for file in wanted if file not in found]
    if missing:
        raise FailureError(
            f"{len(missing)} of {len(wanted)} shards are in no part, such as {missing[0]}; "
            "render the missing parts with gen-dataset --shard I/N, or name their folders"
        )
    return [found[file] for file in wanted]


def _measured(part: Path, key: str) -> float:
    """Return a number of a part's summary; 0 if that is damaged, since a summary is not part of the data."""
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        return float(read_json(part / SUMMARY)[key])
    return 0.0


def _gather(out: Path, sources: Iterable[tuple[Path, dict[str, Any]]]) -> None:
    """Bring the shards into the output folder, checking each; the manifest of an earlier merge goes before any changes.

    Raises:
        FailureError: a shard is not what its part says.
    """
    sources = list(sources)
    (out / SHARDS).mkdir(exist_ok=True)
    with Progress(len(sources), "shards") as progress:
        for source, entry in sources:
            target = out / entry["file"]
            if target == source:
                _require_digest(source, source, entry["sha256"])
            elif not target.is_file() or sha256_of(target) != entry["sha256"]:
                with atomic_write(target) as aside:
                    shutil.copyfile(source, aside)
                    _require_digest(aside, source, entry["sha256"])
                    (out / MANIFEST).unlink(missing_ok=True)
            progress.advance()


def _require_digest(path: Path, source: Path, digest: str) -> None:
    if not path.is_file() or sha256_of(path) != digest:
        raise FailureError(f"{source} is not what its part recorded; render that part again with --resume true")
