"""Frames to H.264 in an mp4, which browsers play."""

from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.files.atomic import atomic_write


def write_mp4(path: Path, frames: UInt8[ndarray, "T H W 3"], frames_per_second: float) -> None:
    """Write a video, whole or not at all; odd sizes are padded by a black row or column, as H.264 needs even ones."""
    import imageio_ffmpeg

    padding = [(0, 0), (0, frames.shape[1] % 2), (0, frames.shape[2] % 2), (0, 0)]
    even = np.ascontiguousarray(np.pad(frames, padding))
    size = (even.shape[2], even.shape[1])
    with atomic_write(path) as aside:
        writer = imageio_ffmpeg.write_frames(
            str(aside), size, fps=frames_per_second, codec="libx264", macro_block_size=1, quality=None,
            output_params=["-crf", "20", "-preset", "veryfast", "-movflags", "+faststart"],
        )  # fmt: skip
        writer.send(None)
        for frame in even:
            writer.send(frame)
        writer.close()
