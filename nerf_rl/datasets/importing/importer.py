"""``nerf-rl import``: read posed pictures shard by shard; the manifest is written last."""

import time
from pathlib import Path

import numpy as np

from nerf_rl.datasets.importing.config import ImportConfig
from nerf_rl.datasets.importing.content import Content, decide_content
from nerf_rl.datasets.importing.frame_rows import episode_rows
from nerf_rl.datasets.importing.open_source import open_source
from nerf_rl.datasets.storage.blind_cameras import warn_of_blind_cameras
from nerf_rl.datasets.storage.disk import explain_full_disk, require_space
from nerf_rl.datasets.storage.finished_shards import FinishedShard, shard_attributes, shard_entry, with_shards
from nerf_rl.datasets.storage.output_record import DatasetRecord
from nerf_rl.datasets.storage.shards import ShardWriter, sha256_of, shard_path
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, require_outside
from nerf_rl.machine.memory import peak_rss_mb
from nerf_rl.progress import Progress

NO_RENDERER = "none: imported pictures"


def import_dataset(config: ImportConfig) -> None:
    """Make a dataset of posed pictures in ``config.out``; sources and format are described in datasets/README.md.

    Raises:
        UserError: a source that is none, damaged or without camera poses, or an output folder in use.
        FailureError: too little disk space, or pictures that show nothing.
    """
    started = time.monotonic()
    require_outside(Path(config.out), config.source)
    content = decide_content(open_source(config), config)
    record = DatasetRecord(Path(config.out), "import", config, content.plan, content.shard_frames())
    record.check()
    done, layout = record.finished_shards(content.scene), content.layout()
    if record.is_complete(done):
        return
    if not config.overwrite:
        require_space(record.dataset, record.bytes_missing(done, layout), "a larger --shrink")
    total, views = sum(record.frames.values()), len(content.roles)
    with explain_full_disk(record.dataset, lambda: record.bytes_missing(done, layout)):
        description = content.describe()
        record.begin(done, description)
        lacking = f", which have no {' and no '.join(content.source.absent)}" if content.source.absent else ""
        print(f"importing {total} frames x {views} views from {config.source}{lacking}; writing to {record.dataset}")
        kept = sum(shard.frames for shard in done.values())
        with Progress(total, "frames", done=kept) as progress:
            for shard in record.shards:
                if shard not in done:
                    done[shard] = _write_shard(content, record, shard, progress)
        seconds = time.monotonic() - started
        entries = [shard_entry(shard) for shard in done.values()]
        record.end(with_shards(description, entries, {NO_RENDERER}))
        rate = (total - kept) * views / seconds
        summary = {
            "frames": total,
            "views": total * views,
            "seconds": round(seconds, 2),
            "views_per_second": round(rate, 1),
            "absent": list(content.source.absent),
            "peak_rss_mb": round(peak_rss_mb(), 1),
        }
        write_json(record.folder / SUMMARY, summary | warn_of_blind_cameras(record.dataset))
    print(f"{record.dataset}: {total} frames, {total * views} views, {rate:.1f} views/s")


def _write_shard(content: Content, record: DatasetRecord, shard: int, progress: Progress) -> FinishedShard:
    path, frames, layout = shard_path(record.dataset, shard), record.frames[shard], content.layout()
    attributes = shard_attributes(record.plan, content.scene, NO_RENDERER)
    with ShardWriter(path, frames, layout, content.constant(), attributes) as writer:
        for episode in content.shard_episodes(shard):
            for row in episode_rows(content, episode):
                writer.append({name: np.asarray(row[name])[None] for name in layout})
                progress.advance()
    return FinishedShard(shard, frames, sha256_of(path), NO_RENDERER)
