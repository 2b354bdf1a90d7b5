"""Dataset generation: plan shards, render them in worker processes, write the manifest last."""

import multiprocessing
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.semantics import palette
from nerf_rl.datasets.shard_rendering import (
    Studio,
    open_studio,
    render_shard,
    shard_episodes,
    shard_path,
    start_worker,
)
from nerf_rl.datasets.shards import MANIFEST, SCHEMA_VERSION, SHARDS, sha256_of
from nerf_rl.errors import UserError
from nerf_rl.progress import Progress
from nerf_rl.runs import (
    SUMMARY,
    check_output,
    package_versions,
    plain,
    prepare_output,
    read_json,
    write_json,
    write_provenance,
)

_PLAN = "plan.json"


def generate_dataset(config: GenDatasetConfig) -> None:
    """Render a dataset into ``config.out``; the format is described in datasets/README.md.

    Raises:
        UserError: an unknown scene or camera, behaviour that the scene does not have, or an output folder in use.
    """
    started = time.monotonic()
    folder = Path(config.out)
    _check(folder, config)
    studio = open_studio(config)
    _prepare(folder, config)
    print(f"writing {config.episodes * config.frames_per_episode} frames x {len(studio.rig.names)} views to {folder}")
    gl_renderer = studio.renderer.gl_renderer
    studio.renderer.close()

    shards = range(-(-config.episodes // config.episodes_per_shard))
    missing = [shard for shard in shards if not shard_path(folder, shard).exists()]
    per_shard = [len(shard_episodes(config, shard)) * config.frames_per_episode for shard in shards]
    rendered = _render(config, missing, sum(per_shard))
    seconds = time.monotonic() - started

    entries = []
    for shard in shards:
        path = shard_path(folder, shard)
        entries.append({"file": f"{SHARDS}/{path.name}", "frames": per_shard[shard], "sha256": sha256_of(path)})
    write_json(folder / MANIFEST, _manifest(config, studio, entries, gl_renderer))
    views = rendered * len(studio.rig.names)
    summary = {
        "frames": sum(per_shard),
        "views": sum(per_shard) * len(studio.rig.names),
        "seconds": round(seconds, 2),
        "views_per_second": round(views / seconds, 1),
        "renderer": gl_renderer,
    }
    write_json(folder / SUMMARY, summary)
    print(f"{folder}: {summary['frames']} frames, {summary['views']} views, {summary['views_per_second']} views/s")


def _check(folder: Path, config: GenDatasetConfig) -> None:
    """Refuse a folder in use, unless it is that of an interrupted run with the same plan, before anything slow."""
    begun = (folder / _PLAN).is_file()
    check_output(folder, config.overwrite, config.resume, begun)
    if config.resume and begun and read_json(folder / _PLAN) != plain(config.content()):
        raise UserError(f"{folder} was begun with another configuration; use the same one, or --overwrite true")


def _prepare(folder: Path, config: GenDatasetConfig) -> None:
    """Create the output folder, or keep that of an interrupted run."""
    prepare_output(folder, config.overwrite, config.resume, (folder / _PLAN).is_file())
    write_json(folder / _PLAN, plain(config.content()))
    write_provenance(folder, "gen-dataset", config)
    (folder / SHARDS).mkdir(exist_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)  # of a dataset that lost a shard since
    for partial in (folder / SHARDS).glob(".*.partial"):
        partial.unlink()


def _render(config: GenDatasetConfig, shards: list[int], total: int) -> int:
    """Render shards in worker processes; return the number of frames rendered."""
    frames = sum(len(shard_episodes(config, shard)) for shard in shards) * config.frames_per_episode
    if not shards:
        return 0
    context = multiprocessing.get_context("spawn")  # OpenGL contexts do not survive a fork
    workers = min(config.workers, len(shards))
    with (
        ProcessPoolExecutor(workers, context, start_worker) as pool,
        Progress(total, "frames", done=total - frames) as progress,
    ):
        futures = [pool.submit(render_shard, config, shard) for shard in shards]
        try:
            for future in as_completed(futures):
                progress.advance(future.result())
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)  # a shard being written is finished and kept
            raise
    return frames


def _manifest(config: GenDatasetConfig, studio: Studio, shards: list[dict], gl_renderer: str) -> dict[str, Any]:
    names = studio.classes.names
    scene, rig = studio.scene, studio.rig
    action_names = [f"action_{i}" for i in range(studio.layout["state/action"][0][0])]
    return {
        "schema_version": SCHEMA_VERSION,
        "config": plain(config.content()),
        "scene": scene.provenance(),
        "renderer": gl_renderer,
        "packages": package_versions(),
        "height": config.size,
        "width": config.size,
        "far": studio.renderer.far,
        "detail": studio.renderer.detail,
        "cameras": [{"name": name, "role": role} for name, role in zip(rig.names, rig.roles, strict=True)],
        "classes": [
            {"name": name, "colour": colour.tolist()} for name, colour in zip(names, palette(len(names)), strict=True)
        ],
        "columns": {
            "proprio": list(scene.proprio_names),
            "privileged": list(scene.privileged_names),
            "action": action_names,
        },
        "bodies": [scene.model.body(i).name for i in range(scene.model.nbody)],
        "frames": sum(shard["frames"] for shard in shards),
        "shards": shards,
    }
