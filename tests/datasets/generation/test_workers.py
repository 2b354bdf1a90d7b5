"""Render workers that die: nothing is lost, and one that keeps dying is told of."""

import dataclasses
import os
import signal
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.workers import render_shards
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import SHARDS, partial_files
from nerf_rl.errors import FailureError


@pytest.fixture
def config(tiny_recipe: Path, tmp_path: Path) -> GenDatasetConfig:
    """The tiny dataset, in 4 shards and by one worker."""
    (tmp_path / SHARDS).mkdir()
    config = cli.parse("gen-dataset", ["--config", str(tiny_recipe), "--out", str(tmp_path)])
    return dataclasses.replace(config, episodes_per_shard=1)


def kill_workers(config: GenDatasetConfig, times: int) -> threading.Thread:
    """Kill the first processes that begin a shard, as soon as they do."""

    def kill() -> None:
        killed: set[int] = set()
        deadline = time.monotonic() + 120
        while len(killed) < times and time.monotonic() < deadline:
            for _, pid in partial_files(Path(config.out), range(4)).values():
                if pid not in killed:
                    os.kill(pid, signal.SIGKILL)
                    killed.add(pid)
            time.sleep(0.001)

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


def test_the_shard_of_a_killed_worker_is_rendered_by_another(config: GenDatasetConfig, tiny_dataset: Path):
    killer, lines = kill_workers(config, times=1), []
    rendered = [shard.shard for shard in render_shards(config, range(4), lines.append)]
    killer.join()
    assert sorted(rendered) == [0, 1, 2, 3] and rendered[-1] == 0  # what was lost comes last
    assert lines == ["a render worker died or hung; shard 0 will be rendered anew"]
    assert sorted(path.name for path in (Path(config.out) / SHARDS).iterdir()) == [f"{i:06d}.h5" for i in range(4)]
    expected = MultiViewDataset(tiny_dataset).read("rgb")
    np.testing.assert_array_equal(np.concatenate([rgb_of(config, shard) for shard in range(4)]), expected)


def test_a_worker_that_keeps_dying_is_told_of_with_its_shard(config: GenDatasetConfig):
    killer = kill_workers(config, times=3)
    with pytest.raises(FailureError, match=r"died or hung 3 times in a row at shard 2; finished shards are kept"):
        list(render_shards(config, [2], lambda line: None))
    killer.join()
    assert list((Path(config.out) / SHARDS).iterdir()) == []


def rgb_of(config: GenDatasetConfig, shard: int) -> np.ndarray:
    with h5py.File(Path(config.out) / SHARDS / f"{shard:06d}.h5") as file:
        return file["rgb"][:]
