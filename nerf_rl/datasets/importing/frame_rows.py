"""A source's frame as the rows that a shard takes."""

from collections.abc import Iterator

import numpy as np
from numpy import ndarray

from nerf_rl.cameras.geometry import projection_matrix
from nerf_rl.datasets.importing.content import Content
from nerf_rl.datasets.importing.source import SourceFrame
from nerf_rl.datasets.storage.frame_checks import array_faults, view_faults
from nerf_rl.datasets.storage.shards import TRAIN, VALIDATION
from nerf_rl.errors import FailureError

_HIT = 0.999  # of the far plane: what is farther counts as nothing


def episode_rows(content: Content, episode: int) -> Iterator[dict[str, ndarray]]:
    """Yield the rows of an episode's frames.

    Raises:
        SourceError: a file is not what the source says.
        FailureError: a view shows nothing, or has no pixel that counts.
    """
    split = VALIDATION if episode in content.held_out else TRAIN
    for frame in content.source.frames(episode):
        row = _row(content, frame)
        row |= {"episode": np.array(episode), "step": np.array(frame.step), "split": np.array(split)}
        for fault in _faults(content, row):
            raise FailureError(f"{frame.place}, step {frame.step}: {fault}; take it out of the source")
        yield row


def _row(content: Content, frame: SourceFrame) -> dict[str, ndarray]:
    rgb = shrunk_colours(frame.rgb, content.shrink, frame.valid)
    shape = rgb.shape[:3]
    depth = np.full(shape, np.inf, np.float32) if frame.depth is None else thinned(frame.depth, content.shrink)
    row = {
        "rgb": rgb,
        "depth": np.where(depth < _HIT * content.far, depth, np.float32(content.far)),
        "semantic": np.zeros(shape, np.uint8) if frame.labels is None else thinned(frame.labels, content.shrink),
        **{f"state/{group}": values for group, values in frame.columns.items()},
        "reward": np.array(frame.reward),
        "success": np.array(frame.success),
    }
    if content.source.has_invalid:
        valid = np.ones(frame.rgb.shape[:3], bool) if frame.valid is None else frame.valid
        row["valid"] = thinned(valid, content.shrink)
    if frame.camera_from_world is not None:
        row["cameras/camera_from_world"] = frame.camera_from_world
        row["cameras/projection"] = projection_matrix(content.intrinsics, frame.camera_from_world)
    return row


def _faults(content: Content, row: dict[str, ndarray]) -> Iterator[str]:
    """Yield what makes a frame unusable."""
    names = content.source.camera_names
    for (view,), fault in view_faults(row["rgb"], row["depth"]):
        yield f"camera {names[view]} {fault}"
    if "valid" in row:
        for view in np.flatnonzero(~row["valid"].any((1, 2))).tolist():
            yield f"camera {names[view]} has no pixel that counts: all are masked, or of unknown depth"
    for name, values in row.items():
        yield from (f"{name} {fault}" for fault in array_faults(values))


def shrunk_colours(rgb: ndarray, factor: int, valid: ndarray | None = None) -> ndarray:
    """Return pictures [V, H, W, 3] that are so many times smaller: each pixel the mean of those that it covers.

    Pixels that do not count (``valid`` [V, H, W]) are left out, but where there are no others. Rows and columns that
    are left over at the bottom and on the right are cut off.
    """
    if factor == 1:
        return rgb
    views, height, width = rgb.shape[0], rgb.shape[1] // factor, rgb.shape[2] // factor
    cut = slice(None), slice(height * factor), slice(width * factor)
    blocks = rgb[cut].reshape(views, height, factor, width, factor, 3).astype(np.float32)
    means = blocks.mean((2, 4))
    if valid is not None:
        weights = valid[cut].reshape(views, height, factor, width, factor, 1).astype(np.float32)
        counts = weights.sum((2, 4))
        means = np.where(counts > 0, (blocks * weights).sum((2, 4)) / np.maximum(counts, 1.0), means)
    return np.rint(means).astype(np.uint8)


def thinned(numbers: ndarray, factor: int) -> ndarray:
    """Return numbers [V, H, W] that cannot be averaged, such as labels: of each block one in its middle."""
    if factor == 1:
        return numbers
    height, width = numbers.shape[1] // factor, numbers.shape[2] // factor
    return numbers[:, factor // 2 :: factor, factor // 2 :: factor][:, :height, :width]
