"""Videos as LeRobot keeps them: H.264 for colours, 12-bit lossless HEVC for depth; FFV1 for labels, lossless too.

Every second picture is a key frame, as in LeRobot's own recordings, so that any picture is read by decoding two. Each
encoder has one thread: there are more videos than processors, and what they hold is then the same on every machine.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy import ndarray

from nerf_rl.files.atomic import atomic_write
from nerf_rl.machine.extras import import_extra

_KEY_FRAME_EVERY = 2


@dataclass(frozen=True)
class Codec:
    """How pictures become a video."""

    encoder: str
    """FFmpeg's name"""
    name: str
    """of what it writes"""
    pixels: str
    """FFmpeg's pixel format of the video"""
    given: str
    """FFmpeg's pixel format of the pictures"""
    options: dict[str, str] = field(default_factory=dict)

    def described(self) -> dict[str, Any]:
        """Return what LeRobot's ``info`` of a video says of its encoding."""
        return {
            "video.codec": self.name,
            "video.pix_fmt": self.pixels,
            "video.g": _KEY_FRAME_EVERY,
            "video.crf": int(self.options["crf"]) if "crf" in self.options else None,
            "video.preset": self.options["preset"],
            "video.fast_decode": 0,
            "video.video_backend": "pyav",
            "video.extra_options": {k: v for k, v in self.options.items() if k not in ("crf", "preset")},
        }


def colours(height: int, width: int) -> Codec:
    """Return the codec of RGB pictures [H, W, 3]; colour is halved in both directions unless a size is odd."""
    pixels = "yuv444p" if height % 2 or width % 2 else "yuv420p"
    return Codec("libx264", "h264", pixels, "rgb24", {"crf": "12", "preset": "veryfast", "bf": "0"})


DEPTH = Codec(
    "libx265", "hevc", "gray12le", "gray12le",
    # the smallest coding units are the fastest of all that is lossless
    {"preset": "ultrafast", "x265-params": "lossless=1:ctu=16:bframes=0:pools=none:frame-threads=1:log-level=error"},
)  # fmt: skip
"""of codes u16 [H, W] below 4096"""
SMALLEST_DEPTH = 16
"""edge of a coding unit, and so of the smallest picture [pixels]"""
LABELS = Codec("ffv1", "ffv1", "gray", "gray")
"""of class ids u8 [H, W]"""


class Video:
    """A video that is being written; its picture i is shown at i / fps seconds, exactly."""

    def __init__(self, av: ModuleType, container: Any, codec: Codec, height: int, width: int, fps: int):
        self._av, self._container, self._codec = av, container, codec
        self._tick, self._written = Fraction(1, fps), 0
        self.size = 0
        """of what the encoder has given out [bytes]"""
        self._stream = container.add_stream(codec.encoder, fps, options={"g": str(_KEY_FRAME_EVERY), **codec.options})
        self._stream.height, self._stream.width, self._stream.pix_fmt = height, width, codec.pixels
        self._stream.codec_context.time_base = self._tick
        self._stream.codec_context.thread_count = 1

    def append(self, pictures: ndarray) -> None:
        """Add pictures [T, H, W, ...]."""
        for picture in pictures:
            frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format=self._codec.given)
            frame.pts, frame.time_base = self._written, self._tick
            self._mux(self._stream.encode(frame))
            self._written += 1

    def finish(self) -> None:
        """Write what the encoder still holds."""
        self._mux(self._stream.encode(None))

    def _mux(self, packets: list[Any]) -> None:
        self.size += sum(packet.size for packet in packets)
        self._container.mux(packets)


@contextlib.contextmanager
def open_video(path: Path, codec: Codec, height: int, width: int, fps: int) -> Iterator[Video]:
    """Give a video to append pictures to; its file exists whole or not at all."""
    av = load_av()
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as aside, av.open(str(aside), "w") as container:
        video = Video(av, container, codec, height, width, fps)
        yield video
        video.finish()


def load_av() -> ModuleType:
    """Import PyAV; raise UserError if it is not installed."""
    av = import_extra("av", "lerobot", "--format lerobot")
    av.logging.set_level(av.logging.ERROR)
    return av
