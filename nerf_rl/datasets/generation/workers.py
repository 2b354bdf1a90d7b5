"""Rendering shards in worker processes, which may die or hang without harm to what is finished."""

import contextlib
import functools
from collections.abc import Callable, Collection, Generator
from pathlib import Path

import mujoco

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.shard_episodes import render_shard
from nerf_rl.datasets.generation.watchdog import alarm, lookout
from nerf_rl.datasets.storage.finished_shards import FinishedShard
from nerf_rl.datasets.storage.plan import Plan, plan_of
from nerf_rl.datasets.storage.shards import partial_files, partial_path, shard_path
from nerf_rl.errors import FailureError
from nerf_rl.machine.backends import RAY
from nerf_rl.machine.gl import use_one_software_thread
from nerf_rl.machine.processes import start_server
from nerf_rl.machine.worker_pools import MOST_DEATHS, LocalProcesses, Pool, RayProcesses, through_deaths
from nerf_rl.scenes.make import scene_modules


def begin_workers(config: GenDatasetConfig) -> None:
    """Begin the imports of render processes of this machine, which take seconds, beside what this process does."""
    if config.backend != RAY:
        start_server(_modules(config))


def render_shards(
    config: GenDatasetConfig,
    shards: Collection[int],
    say: Callable[[str], None] = print,
    plan: Plan | None = None,
) -> Generator[FinishedShard, None, None]:
    """Render shards in worker processes; yields each when it is on disk.

    A process that dies, or hangs and is therefore ended, costs the shards that were being rendered, which are begun
    anew after all others. Close the iterator to end early: processes are ended and what is not whole is removed.

    Args:
        config: with an absolute ``out``, a folder that all workers see.
        shards: which.
        say: called with a line when workers were lost.
        plan: that the dataset was begun with; by default the configuration's own.

    Raises:
        FailureError: workers keep dying without finishing a shard, or a frame is unusable.
        UserError: the backend cannot be had.
    """
    pool: Pool = RayProcesses() if config.backend == RAY else LocalProcesses(_modules(config))
    folder, missing, plan = Path(config.out), list(shards), plan or plan_of(config)

    def after_death(in_a_row: int) -> None:
        lost = sorted({shard for shard, _ in partial_files(folder, missing).values()})
        names = f"shard{'s' * (len(lost) != 1)} {', '.join(map(str, lost))}" if lost else "shards"
        if in_a_row >= MOST_DEATHS:
            raise FailureError(
                f"render workers died or hung {in_a_row} times in a row at {names}; finished shards are kept: "
                "go on with --resume true, with fewer --workers if memory ran out or OpenGL hung, "
                "or a longer --worker_timeout if the scene is slow"
            )
        say(f"a render worker died or hung; {names} will be rendered anew")
        missing[:] = [shard for shard in missing if shard not in lost] + lost
        _remove_partial_files(folder, missing)

    def attempt(shards: list[int]) -> Generator[FinishedShard, None, None]:
        return _render_once(config, shards, pool, plan)

    try:
        yield from through_deaths(missing, attempt, lambda rendered: rendered.shard, pool.deaths, after_death)
    finally:
        _remove_partial_files(folder, missing)


def _modules(config: GenDatasetConfig) -> list[str]:
    return [__name__, *scene_modules(config.scene)]


def _render_once(
    config: GenDatasetConfig, shards: list[int], pool: Pool, plan: Plan
) -> Generator[FinishedShard, None, None]:
    watch = lookout(Path(config.out), shards, config.worker_timeout) if config.backend != RAY else None
    calls = (functools.partial(_render_watched, config, shard, plan) for shard in shards)
    workers = min(config.workers, len(shards))
    with watch or contextlib.nullcontext(), contextlib.closing(pool.as_they_end(calls, workers)) as rendered:
        yield from rendered


def _render_watched(config: GenDatasetConfig, shard: int, plan: Plan) -> FinishedShard:
    """Render a shard; runs in a worker process."""
    use_one_software_thread()
    mujoco.set_mju_user_warning(lambda message: None)  # told here; it would write MUJOCO_LOG.TXT
    partial = partial_path(shard_path(Path(config.out), shard))
    with alarm(partial, config.worker_timeout) as beat:
        return render_shard(config, shard, beat, plan)


def _remove_partial_files(folder: Path, shards: Collection[int]) -> None:
    for path in partial_files(folder, shards):
        path.unlink(missing_ok=True)
