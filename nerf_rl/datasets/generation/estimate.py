"""What a dataset will cost, measured on a few of its frames."""

import time
from pathlib import Path

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.shard_episodes import open_render_context, render_episode, shard_episodes
from nerf_rl.datasets.generation.unfinished import OutputRecord
from nerf_rl.datasets.storage.disk import bytes_free, bytes_needed, readable
from nerf_rl.datasets.storage.shards import TRAIN
from nerf_rl.machine.gl import use_one_software_thread, warn_of_software_rendering
from nerf_rl.rendering.following import warn_of_unnamed_travellers

_SECONDS, _LEAST_EPISODES = 2.0, 2  # of measuring


def print_estimate(config: GenDatasetConfig) -> None:
    """Print frames, bytes, free disk space and minutes; nothing is written.

    The minutes are those of rendering, as if each worker had a core, and of starting once.

    Raises:
        UserError: as the generation itself would.
        FailureError: a frame is unusable.
    """
    use_one_software_thread()  # as in a worker
    started = time.monotonic()
    context = open_render_context(config)
    try:
        renderer = context.renderer.gl_renderer
        warn_of_software_rendering(renderer)
        warn_of_unnamed_travellers(config.rig, context.scene)
        opened = time.monotonic()
        measured = 0
        for episode in range(config.episodes):
            measured += sum(1 for _ in render_episode(context, config, episode, TRAIN))
            if episode + 1 >= _LEAST_EPISODES and time.monotonic() - opened > _SECONDS:
                break
        rate = measured / (time.monotonic() - opened)
    finally:
        context.renderer.close()
    shards = OutputRecord(config).shards
    frames = sum(len(shard_episodes(config, shard)) for shard in shards) * config.frames_per_episode
    needed, free = bytes_needed(context.layout, frames, len(shards)), bytes_free(Path(config.out))
    workers = min(config.workers, len(shards)) or 1
    minutes = (frames / (rate * workers) + opened - started) / 60
    room = "free" if needed <= free else "free: TOO LITTLE"
    print(f"{frames} frames x {len(context.rig.names)} views of {config.size} x {config.size} in {len(shards)} shards")
    print(f"{readable(needed)} to write; {readable(free)} {room} on the disk of {config.out}")
    print(
        f"about {minutes:.1f} minutes with {workers} workers: {rate:.1f} frames/s each, measured on {measured} frames"
    )
    print(f"rendered by {renderer}")
