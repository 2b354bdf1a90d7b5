"""Frames to H.264 in an mp4, which browsers play."""

import contextlib
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.errors import FailureError
from nerf_rl.files.atomic import atomic_write


def write_mp4(path: Path, frames: UInt8[ndarray, "T H W 3"], frames_per_second: float) -> None:
    """Write a video, whole or not at all; odd sizes are padded by a black row or column, as H.264 needs even ones.

    Raises:
        FailureError: not all of it could be written, for want of space, say.
    """
    import imageio_ffmpeg

    padding = [(0, 0), (0, frames.shape[1] % 2), (0, frames.shape[2] % 2), (0, 0)]
    even = np.ascontiguousarray(np.pad(frames, padding))
    size = (even.shape[2], even.shape[1])
    with atomic_write(path) as aside:
        writer = imageio_ffmpeg.write_frames(
            str(aside), size, fps=frames_per_second, codec="libx264", macro_block_size=1, quality=None,
            output_params=["-crf", "20", "-preset", "veryfast", "-movflags", "+faststart"],
        )  # fmt: skip
        with contextlib.suppress(OSError):  # ffmpeg ended early; its exit status is not told
            writer.send(None)
            for frame in even:
                writer.send(frame)
        writer.close()
        if _frames_in(aside) != len(even):
            raise FailureError(f"{path} could not be written whole; is its disk full?")


def _frames_in(path: Path) -> int:
    """Return how many frames a video has, 0 if it is none."""
    import imageio_ffmpeg

    try:
        return int(imageio_ffmpeg.count_frames_and_secs(str(path))[0])
    except RuntimeError:
        return 0
