"""Rendering shards in worker processes, which may die or hang without harm to what is finished."""

import contextlib
import warnings
from collections.abc import Callable, Collection, Generator
from pathlib import Path

import mujoco
from joblib import Parallel, delayed

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.shard_episodes import RenderedShard, render_shard
from nerf_rl.datasets.generation.watchdog import alarm, lookout
from nerf_rl.datasets.storage.plan import Plan, plan_of
from nerf_rl.datasets.storage.shards import partial_files, partial_path, shard_path
from nerf_rl.errors import FailureError
from nerf_rl.machine.gl import use_one_software_thread
from nerf_rl.machine.worker_pools import open_backend

_MOST_DEATHS = 3  # in a row, without a finished shard in between


def render_shards(
    config: GenDatasetConfig,
    shards: Collection[int],
    say: Callable[[str], None] = print,
    plan: Plan | None = None,
) -> Generator[RenderedShard, None, None]:
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
    backend, deaths = open_backend(config.backend)
    folder, missing, in_a_row = Path(config.out), list(shards), 0
    try:
        while missing:
            try:
                with contextlib.closing(
                    _render_once(config, list(missing), backend, plan or plan_of(config))
                ) as rendered:
                    for shard in rendered:
                        missing.remove(shard.shard)
                        in_a_row = 0
                        yield shard
            except deaths as error:
                in_a_row += 1
                lost = sorted({shard for shard, _ in partial_files(folder, missing).values()})
                names = f"shard{'s' * (len(lost) != 1)} {', '.join(map(str, lost))}" if lost else "shards"
                if in_a_row >= _MOST_DEATHS:
                    raise FailureError(
                        f"render workers died or hung {in_a_row} times in a row at {names}; finished shards are kept: "
                        "go on with --resume true, with fewer --workers if memory ran out or OpenGL hung"
                    ) from error
                say(f"a render worker died or hung; {names} will be rendered anew")
                missing = [shard for shard in missing if shard not in lost] + lost
                _remove_partial_files(folder, missing)
    finally:
        _remove_partial_files(folder, missing)


def _render_once(
    config: GenDatasetConfig, shards: list[int], backend: object, plan: Plan
) -> Generator[RenderedShard, None, None]:
    workers = min(config.workers, len(shards))
    if config.backend == "ray":
        workers = max(workers, 2)  # for one job joblib would start no process
    parallel = Parallel(
        workers, backend=backend, return_as="generator_unordered", batch_size=1, pre_dispatch=2 * workers
    )
    watch = lookout(Path(config.out), shards, config.worker_timeout) if config.backend == "loky" else None
    with watch or contextlib.nullcontext(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(tasks|worker)")  # joblib and loky tell of an early end
        with contextlib.closing(
            parallel(delayed(_render_watched)(config, shard, plan) for shard in shards)
        ) as rendered:
            yield from rendered


def _render_watched(config: GenDatasetConfig, shard: int, plan: Plan) -> RenderedShard:
    """Render a shard; runs in a worker process."""
    use_one_software_thread()
    mujoco.set_mju_user_warning(lambda message: None)  # told here; it would write MUJOCO_LOG.TXT
    partial = partial_path(shard_path(Path(config.out), shard))
    with alarm(partial, config.worker_timeout) as beat:
        return render_shard(config, shard, beat, plan)


def _remove_partial_files(folder: Path, shards: Collection[int]) -> None:
    for path in partial_files(folder, shards):
        path.unlink(missing_ok=True)
