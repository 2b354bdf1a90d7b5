"""Pictures of an episode out of a LeRobotDataset's videos, decoded one by one."""

from collections.abc import Generator
from pathlib import Path

from numpy import ndarray

from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.machine.extras import import_extra

COLOURS, LABELS, DEPTH = "rgb24", "gray", "gray12le"
"""FFmpeg's formats of the pictures that are asked for"""
_CODECS = frozenset({"h264", "hevc", "av1", "libdav1d", "ffv1"})
_CONTAINER = "mp4"  # and no other, whatever the file says: some formats name other files to be opened


def read_pictures(
    path: Path, pixels: str, size: tuple[int, int], begin: float, count: int, fps: float
) -> Generator[ndarray, None, None]:
    """Yield neighbouring pictures of a video, [H, W, ...].

    Args:
        path: of the video.
        pixels: :data:`COLOURS`, :data:`LABELS` or :data:`DEPTH`.
        size: height and width that they must have [pixels].
        begin: time of the first one [s].
        count: of pictures.
        fps: pictures a second.

    Raises:
        SourceError: the file is no such video, or has no such pictures.
        UserError: PyAV is not installed.
    """
    av = import_extra("av", "lerobot", "an import from LeRobot")
    av.logging.set_level(av.logging.PANIC)
    next_one, last = round(begin * fps), round(begin * fps) + count
    try:
        with av.open(str(path), format=_CONTAINER) as container:
            if not container.streams.video:
                raise SourceError(path, "it holds no video")
            stream = container.streams.video[0]
            codec = stream.codec_context
            if codec.name not in _CODECS:
                raise SourceError(path, f"its codec is {codec.name}, and {', '.join(sorted(_CODECS))} are read")
            if (codec.height, codec.width) != size:
                _refuse_size(path, codec, size)
            container.seek(int(begin / stream.time_base), stream=stream)
            for frame in container.decode(stream):
                number = -1 if frame.time is None else round(frame.time * fps)
                if number < next_one:
                    continue
                if number > next_one:
                    break
                if (frame.height, frame.width) != size:
                    _refuse_size(path, frame, size)
                yield frame.to_ndarray(format=pixels)
                next_one += 1
                if next_one == last:
                    return
    except (av.FFmpegError, OSError, ValueError) as error:
        raise SourceError(path, f"it cannot be decoded ({' '.join(str(error).split())[:200]})") from error
    raise SourceError(path, f"it has no picture at {next_one / fps:.3f} s")


def _refuse_size(path: Path, found: object, size: tuple[int, int]) -> None:
    width, height = getattr(found, "width", 0), getattr(found, "height", 0)
    raise SourceError(path, f"its pictures are {width} x {height} pixels large instead of {size[1]} x {size[0]}")
