"""Dataset generation: plan shards, render them in worker processes, write the manifest last."""

import contextlib
import dataclasses
import time

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.estimate import print_estimate
from nerf_rl.datasets.generation.manifest import describe
from nerf_rl.datasets.generation.shard_episodes import open_render_context
from nerf_rl.datasets.generation.unfinished import OutputRecord
from nerf_rl.datasets.generation.workers import begin_workers, render_shards
from nerf_rl.datasets.storage.blind_cameras import warn_of_blind_cameras
from nerf_rl.datasets.storage.disk import explain_full_disk, require_space
from nerf_rl.datasets.storage.finished_shards import FinishedShard, shard_entry, with_shards
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.machine.gl import warn_of_software_rendering
from nerf_rl.progress import Progress
from nerf_rl.rendering.following import warn_of_unnamed_travellers


def generate_dataset(config: GenDatasetConfig) -> None:
    """Render a dataset, or a part of one, into ``config.out``; the format is described in datasets/README.md.

    Raises:
        UserError: an unknown scene or camera, behaviour that the scene does not have, or an output folder in use.
        FailureError: too little disk space, workers that keep dying, or frames that show nothing.
    """
    started = time.monotonic()
    if config.estimate:
        print_estimate(config)
        return
    record = OutputRecord(config)
    record.check()
    begin_workers(config)
    context = open_render_context(config)
    try:
        description, gl_renderer = describe(config, context, record.plan), context.renderer.gl_renderer
    finally:
        context.renderer.close()
    warn_of_software_rendering(gl_renderer)
    warn_of_unnamed_travellers(config.rig, context.scene)
    total = sum(record.frames.values())
    done = record.finished_shards(description["scene"])
    if record.is_complete(done):
        return
    if not config.overwrite:
        require_space(record.dataset, record.bytes_missing(done, context.layout))
    with explain_full_disk(record.dataset, lambda: record.bytes_missing(done, context.layout)):
        record.begin(done, description)
        print(f"writing {total} frames x {len(context.rig.names)} views to {record.dataset}")
        kept = sum(shard.frames for shard in done.values())
        _render(config, record, done, total)
        seconds = time.monotonic() - started
        entries = [shard_entry(shard) for shard in done.values()]
        manifest = with_shards(description, entries, (shard.renderer for shard in done.values()))
        record.end(manifest)
        views_per_second = (total - kept) * len(context.rig.names) / seconds
        summary = {
            "frames": total,
            "views": total * len(context.rig.names),
            "seconds": round(seconds, 2),
            "views_per_second": round(views_per_second, 1),
            "renderer": manifest["renderer"],
            "worker_peak_rss_mb": round(max((shard.peak_rss_mb for shard in done.values()), default=0.0), 1),
        }
        if not config.shard:  # shards of a part lie elsewhere; merge tells what they show
            summary |= warn_of_blind_cameras(record.dataset)
        write_json(record.folder / SUMMARY, summary)
    print(f"{record.dataset}: {summary['frames']} frames, {summary['views']} views, {views_per_second:.1f} views/s")


def _render(config: GenDatasetConfig, record: OutputRecord, done: dict[int, FinishedShard], total: int) -> None:
    """Render what is missing and add it to ``done``."""
    missing = [shard for shard in record.shards if shard not in done]
    kept = sum(shard.frames for shard in done.values())
    absolute = dataclasses.replace(config, out=str(record.dataset.absolute()))
    with (
        Progress(total, "frames", done=kept) as progress,
        contextlib.closing(render_shards(absolute, missing, progress.say, record.plan)) as rendered,
    ):
        for shard in rendered:
            done[shard.shard] = shard
            progress.advance(shard.frames)
