"""Videos are whole or not there."""

import resource
from pathlib import Path

import numpy as np
import pytest

from nerf_rl.errors import FailureError
from nerf_rl.pictures.video import write_mp4


def test_a_video_that_cannot_be_written_whole_is_told_of_and_leaves_the_old_one(tmp_path: Path):
    path, frames = tmp_path / "clip.mp4", np.random.default_rng(0).integers(0, 256, (30, 64, 64, 3), np.uint8)
    write_mp4(path, frames[:2], 8.0)
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, limits[1]))  # as if the disk were full then
    try:
        with pytest.raises(FailureError, match=r"clip.mp4 could not be written whole; is its disk full\?"):
            write_mp4(path, frames, 8.0)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]
