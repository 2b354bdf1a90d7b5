"""Mending a dataset: damaged shards are rendered anew and must come out as recorded, byte for byte."""

import contextlib
import dataclasses
import json
import shutil
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from nerf_rl.arguments.parsing import config_of
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.manifest import describe
from nerf_rl.datasets.generation.shard_episodes import open_render_context, shard_count, shard_frames
from nerf_rl.datasets.generation.workers import render_shards
from nerf_rl.datasets.storage.disk import bytes_needed, explain_full_disk, require_space
from nerf_rl.datasets.storage.finished_shards import FinishedShard, finished_shard, shard_entry, with_shards
from nerf_rl.datasets.storage.plan import PLAN, Plan, command_keys, plan_of, same_content
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS, read_manifest, shard_file, shard_path
from nerf_rl.datasets.storage.stored_manifest import IMPORTED_FROM
from nerf_rl.datasets.upkeep.problems import IMPORT_AGAIN, Problem, shard_problems
from nerf_rl.errors import FailureError, MissingFileError, UserError
from nerf_rl.files.atomic import rename_durably
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.progress import Progress

_ASIDE = ".repair"


def repair(folder: Path, problems: Iterable[Problem], workers: int) -> None:
    """Mend what a check has found.

    Args:
        folder: of the dataset.
        problems: found by a check.
        workers: render processes.

    Raises:
        FailureError: a shard came out otherwise than recorded, or the disk is full.
        UserError: nothing whole is left to tell what the dataset was, or something else has a shard's name.
    """
    files = dict.fromkeys(problem.file for problem in problems)
    try:
        with _explain_paths(folder), explain_full_disk(folder, remedy="free some space and run the same command again"):
            if MANIFEST in files:
                _rebuild_manifest(folder, workers)
                files = dict.fromkeys(problem.file for problem in shard_problems(folder, read_manifest(folder)))
            manifest = read_manifest(folder)
            write_json(folder / PLAN, manifest["config"])
            numbers = {shard_file(number): number for number in range(len(manifest["shards"]))}
            damaged = [numbers[file] for file in files if file in numbers]
            if damaged:
                _restore(folder, manifest, damaged, workers)
    finally:
        shutil.rmtree(folder / _ASIDE, ignore_errors=True)


@contextlib.contextmanager
def _explain_paths(folder: Path) -> Iterator[None]:
    """Say where to repair what was made from a file that is not found, in place of keys that this command lacks."""
    try:
        yield
    except MissingFileError as error:
        what, _, _ = str(error).rpartition("; ")
        raise UserError(
            f"{folder} cannot be rendered anew here: {what}; run the command in the folder in which gen-dataset ran, "
            "where its paths begin"
        ) from error


def _restore(folder: Path, manifest: dict[str, Any], damaged: list[int], workers: int) -> None:
    """Render shards anew and put them in their places if they are what the manifest says."""
    config = _config(folder, manifest["config"], workers)
    recorded = {entry["file"]: entry["sha256"] for entry in manifest["shards"]}
    rendered = _render(folder, config, damaged, manifest["config"])
    other = [shard for shard in rendered if shard.sha256 != recorded[shard_file(shard.shard)]]
    for shard in rendered:
        if shard not in other:
            rename_durably(shard_path(folder / _ASIDE, shard.shard), shard_path(folder, shard.shard))
    if other:
        names = ", ".join(shard_file(shard.shard) for shard in other)
        here, there = other[0].renderer, manifest["renderer"]
        reason = f"here {here} renders, it was made by {there}" if here != there else "package versions may differ"
        if not same_content(plan_of(config), manifest["config"]):
            reason = f"{config.behaviour.states} holds other states than it did"
        raise FailureError(
            f"{folder}: {names} came out otherwise than recorded and was left as it was: {reason}; repair it where it "
            "was made, or make such shards anew with gen-dataset --resume true"
        )


def _rebuild_manifest(folder: Path, workers: int) -> None:
    """Write the manifest again from the plan and the shards.

    A shard whose digest stands in the damaged manifest is what was recorded; all others are rendered anew.
    """
    try:
        plan = read_json(folder / PLAN)
    except (OSError, ValueError) as error:
        raise UserError(f"{folder}: {MANIFEST} and {PLAN} are both damaged; make the dataset again") from error
    config = _config(folder, plan, workers)
    damaged_text = (folder / MANIFEST).read_bytes().decode(errors="replace")
    context = open_render_context(config)
    context.renderer.close()
    description = describe(config, context, plan)
    found = (
        finished_shard(folder, number, shard_frames(config, number), description["scene"], plan)
        for number in range(shard_count(config))
    )
    trusted = {shard.shard: shard for shard in found if shard is not None and shard.sha256 in damaged_text}
    doubtful = [number for number in range(shard_count(config)) if number not in trusted]
    rendered = _render(folder, config, doubtful, plan) if doubtful else []
    with contextlib.suppress(ValueError, KeyError):  # where it can still be read, it knows what the shards were made by
        description["packages"] = json.loads(damaged_text)["packages"]
    for shard in rendered:
        rename_durably(shard_path(folder / _ASIDE, shard.shard), shard_path(folder, shard.shard))
    shards = [*trusted.values(), *rendered]
    manifest = with_shards(description, map(shard_entry, shards), (shard.renderer for shard in shards))
    write_checksummed(folder / MANIFEST, manifest)


def _render(folder: Path, config: GenDatasetConfig, shards: Collection[int], plan: Plan) -> list[FinishedShard]:
    """Render shards in a folder beside the dataset's own ones, once there is place for them.

    Raises:
        UserError: something else has the name of a shard or of their folder.
    """
    _make_place(folder, shards)
    aside = folder / _ASIDE
    shutil.rmtree(aside, ignore_errors=True)
    context = open_render_context(config)
    context.renderer.close()
    frames = len(shards) * config.episodes_per_shard * config.frames_per_episode
    require_space(folder, bytes_needed(context.layout, frames, len(shards)))
    elsewhere = dataclasses.replace(config, out=str(aside.absolute()))
    with Progress(len(shards), "shards") as progress:
        (aside / SHARDS).mkdir(parents=True)
        rendered = []
        with contextlib.closing(render_shards(elsewhere, shards, progress.say, plan)) as finished:
            for shard in finished:
                rendered.append(shard)
                progress.advance()
    return rendered


def _make_place(folder: Path, shards: Iterable[int]) -> None:
    try:
        (folder / SHARDS).mkdir(exist_ok=True)
    except FileExistsError as error:
        raise UserError(f"{folder / SHARDS} is no folder, and shards belong there; move it away") from error
    for path in (shard_path(folder, shard) for shard in shards):
        if path.is_dir():
            raise UserError(f"{path} is a folder, and a shard belongs there; move it away")


def _config(folder: Path, content: dict[str, Any], workers: int) -> GenDatasetConfig:
    if IMPORTED_FROM in content:
        raise UserError(f"{folder} was imported, so there is no simulator to render its shards again; {IMPORT_AGAIN}")
    try:
        return config_of(GenDatasetConfig, {**command_keys(content), "out": str(folder), "workers": workers})
    except UserError as error:
        raise UserError(f"{folder} was made by another version of nerf-rl ({error}); make it again") from error
