"""What training needs to know of a dataset as a whole: the scene's extent, and how often a pixel shows what."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position, pixel_directions
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import ANCHORS, PretrainConfig
from nerf_rl.pretrain.data.anchors import (
    Anchors,
    Middles,
    choose_anchors,
    countable_labels,
    visible_middles,
    visible_sizes,
)
from nerf_rl.pretrain.data.looked_at import FARTHEST, NEAREST, distances_to_what_is_looked_at
from nerf_rl.pretrain.model.field import FieldBounds

_FRAMES = 200
_FRAMES_AT_ONCE = 8
_MOST_PIXELS = 1_000_000  # whose depth is looked at
_PIXELS_PER_POINT = 7  # of them
_HIT = 0.999  # of the far plane: what is nearer was hit by a ray, not missed by all
_NEAREST = 0.8  # of the nearest depth that is hit
_BACKDROP = FARTHEST  # in median depths of what is hit
_BACKDROP_OF_THINGS = 10.0  # in median depths of what is not background
_BOX_MARGIN = 0.05  # of its longest edge: not all frames are looked at
_BACKGROUND = 0  # class id


class Statistics(NamedTuple):
    """What training needs to know of a dataset as a whole."""

    bounds: FieldBounds
    distance: float
    """from the encoder's cameras to the things that they see [m], the unit of the lengths in a recipe: a hand is seen
    from thirty centimetres away, a robot that runs from three metres"""
    class_weights: Float[ndarray, "C"]
    """of a pixel by its class, when rays are drawn"""
    pixel_weights: Float[ndarray, "V H W"]
    """of a pixel by its place, for encoder and supervision cameras"""
    anchors: Anchors
    """classes that move, as the encoder's cameras see them"""


class _Pixels(NamedTuple):
    """Some pixels of some frames."""

    frame: Int[ndarray, "M"]
    """position among the frames"""
    view: Int[ndarray, "M"]
    """position among the views"""
    row: Int[ndarray, "M"]
    column: Int[ndarray, "M"]
    depth: Float[ndarray, "M"]
    """planar [m]"""
    is_background: ndarray


def measure(dataset: MultiViewDataset, config: PretrainConfig) -> Statistics:
    """Measure the scene's extent and the classes' frequencies on some training frames.

    Raises:
        UserError: the encoder's cameras see nothing, or the limits of the recipe contradict what they see.
    """
    train = dataset.split("train")
    frames = train[np.linspace(0, len(train) - 1, min(_FRAMES, len(train))).astype(int)]
    views = dataset.views("encoder", "supervision")
    intrinsics, poses = dataset.tracked_cameras(frames)
    pixels, shown = _look(dataset, frames, views)
    counts = shown.sum((1, 2, 3))
    frequency = np.maximum(counts, 1) / counts.sum()
    moving = np.abs(poses[:, views] - poses[:1, views]).max((0, 2, 3)) > 1e-9
    change = np.where(moving[:, None, None], 0.0, class_change(shown))
    change[moving] = change[~moving].mean() if not moving.all() else 0.0
    if DEPTH in dataset.absent:
        pixels = _as_if_looked_at(pixels, poses[:, views], config)
    seen = _is_hit(pixels, dataset) & np.isin(views, dataset.views("encoder"))[pixels.view]
    distance = _distance(dataset, config, pixels, seen)
    bounds = _bounds(dataset, config, pixels, seen, distance, intrinsics[views], poses[:, views])
    weights = frequency**-config.class_balance, 1.0 + config.change_boost * change
    follows = (config.losses.anchor or config.objective == ANCHORS) and DEPTH not in dataset.absent
    anchors = choose_anchors(*_things(dataset, frames), frequency, distance) if follows else Anchors.of_nothing()
    return Statistics(bounds, distance, *weights, anchors)


def class_change(shown: Int[ndarray, "C V H W"]) -> Float[ndarray, "V H W"]:
    """Return the share of images in which a pixel does not show its most frequent class.

    Where something may be and is not, the background tells as much as the thing itself does where it is.

    Args:
        shown: in how many images a pixel shows a class; one that never counts, in none.
    """
    return np.where(shown.any(0), 1.0 - shown.max(0) / np.maximum(shown.sum(0), 1), 0.0)


def _look(dataset: MultiViewDataset, frames: ndarray, views: list[int]) -> tuple[_Pixels, Int[ndarray, "C V H W"]]:
    """Return pixels that count, spread over the frames and views, and how often each pixel shows each class.

    A few frames at a time: memory does not grow with their number or size, but for the pixels that are kept.
    """
    height, width = dataset.manifest["height"], dataset.manifest["width"]
    size = len(views) * height * width
    shown = np.zeros((len(dataset.class_names), len(views), height, width), np.int64)
    rng, parts = np.random.default_rng(0), []
    for first in range(0, len(frames), _FRAMES_AT_ONCE):
        chunk = frames[first : first + _FRAMES_AT_ONCE]
        depth, semantic = dataset.read("depth", chunk)[:, views], dataset.read_labels(chunk)[:, views]
        valid = dataset.read_valid(chunk)
        countable = None if valid is None else valid[:, views]
        for label in range(len(shown)):
            shown[label] += (semantic == label if countable is None else (semantic == label) & countable).sum(0)
        counting = None if countable is None else np.flatnonzero(countable)
        count = depth.size if counting is None else len(counting)
        kept = min(count, _MOST_PIXELS * len(chunk) // len(frames))
        index = np.sort(rng.choice(count, kept, replace=False)) if kept < count else np.arange(count)
        index = index if counting is None else counting[index]
        frame, rest = np.divmod(index.astype(np.int32), size)
        view, row, column = np.unravel_index(rest, (len(views), height, width))
        is_background = semantic.ravel()[index] == _BACKGROUND
        parts.append(_Pixels(frame + first, view, row, column, depth.ravel()[index], is_background))
    return _Pixels(*(np.concatenate(column) for column in zip(*parts, strict=True))), shown


def _things(dataset: MultiViewDataset, frames: ndarray) -> tuple[Middles, Float[ndarray, "N C"]]:
    """Return where the encoder's cameras see each class, and how large it looks [m]."""
    views, parts, sizes = dataset.views("encoder"), [], []
    for first in range(0, len(frames), _FRAMES_AT_ONCE):
        chunk = frames[first : first + _FRAMES_AT_ONCE]
        intrinsics, poses = dataset.tracked_cameras(chunk)
        depth, semantic = dataset.read("depth", chunk)[:, views], dataset.read_labels(chunk)
        labels = countable_labels(semantic, dataset.read_valid(chunk))[:, views]
        seen = depth, labels, intrinsics[views], poses[:, views]
        parts.append(visible_middles(*seen, len(dataset.class_names)))
        sizes.append(visible_sizes(*seen, parts[-1]))
    return Middles(*(np.concatenate(column) for column in zip(*parts, strict=True))), np.concatenate(sizes)


def _as_if_looked_at(pixels: _Pixels, poses: Float[ndarray, "N V 4 4"], config: PretrainConfig) -> _Pixels:
    """Return pixels with the depth of what their cameras look at, where no true depth is known.

    Args:
        pixels: of these frames and views.
        poses: ``camera_from_world`` of the views.
        config: of the run.

    Raises:
        UserError: the cameras do not look at one point, and the limits are not given.
    """
    near, far = config.sampling.near, config.sampling.far
    if near is not None and far is not None:
        depth = np.full(poses.shape[:2], (near + far) / 2)
    else:
        depth = distances_to_what_is_looked_at(poses)
    return pixels._replace(depth=depth[pixels.frame, pixels.view])


def _is_hit(pixels: _Pixels, dataset: MultiViewDataset) -> Bool[ndarray, "M"]:
    """Tell which pixels show anything: where nothing is, depth is that of the renderer's far plane.

    Where depth is made up, pictures do not tell that anything is not there.
    """
    if DEPTH in dataset.absent:
        return np.ones(len(pixels.depth), np.bool_)
    return pixels.depth < _HIT * dataset.manifest["far"]


def _distance(dataset: MultiViewDataset, config: PretrainConfig, pixels: _Pixels, seen: Bool[ndarray, "M"]) -> float:
    """Return the median depth [m] of what is not background in the encoder's pictures, or of all if nothing is.

    Args:
        dataset, config: of the run.
        pixels: of all cameras.
        seen: which of them encoder cameras see, and something in them.

    Raises:
        UserError: they see nothing, and the recipe does not say where things would be.
    """
    near, far = config.sampling.near, config.sampling.far
    things = seen & ~pixels.is_background
    if seen.any():
        return float(np.median(pixels.depth[things if things.any() else seen]))
    if near is None or far is None:
        raise UserError(f"{dataset.folder}: the encoder's cameras see nothing at all; look at it with nerf-rl view")
    return (near + far) / 2


def _bounds(
    dataset: MultiViewDataset,
    config: PretrainConfig,
    pixels: _Pixels,
    seen: Bool[ndarray, "M"],
    distance: float,
    intrinsics: Float[ndarray, "V 3 3"],
    poses: Float[ndarray, "N V 4 4"],
) -> FieldBounds:
    """Return where the field lives, from what is hit.

    Args:
        dataset, config: of the run.
        pixels: of all cameras.
        seen: which of them encoder cameras see, and something in them.
        distance: of the things there [m].
        intrinsics, poses: of the cameras.

    Raises:
        UserError: the limits of the recipe contradict what is hit.
    """
    hit = _is_hit(pixels, dataset)
    sampling = config.sampling
    nearest = NEAREST if DEPTH in dataset.absent else _NEAREST
    near = sampling.near  # of all cameras: one that moves may come close to what others see from afar
    if near is None:
        near = nearest * float(np.quantile(pixels.depth[hit], 0.001))
    far = sampling.far
    if far is None:
        far = min(_BACKDROP * float(np.median(pixels.depth[seen])), _BACKDROP_OF_THINGS * distance)
        if DEPTH not in dataset.absent:
            far = min(far, _HIT * float(dataset.manifest["far"]))  # where nothing is hit, or nothing is known
    if not 0 < near < far:
        raise UserError(f"sampling needs 0 < near < far, got near {near:.3f} and far {far:.3f}")

    chosen = np.flatnonzero(hit & (pixels.depth < far))[::_PIXELS_PER_POINT]
    if not len(chosen):
        raise UserError(f"{dataset.folder}: nothing is nearer than --sampling.far {far:.3f}")
    frame, view, row, column, depth = (values[chosen] for values in pixels[:5])
    centres = np.stack([column, row], axis=-1)[:, None] + 0.5
    directions = pixel_directions(intrinsics[view], poses[frame, view], centres)[:, 0]
    surface = camera_position(poses)[frame, view] + depth[:, None] * directions
    low, high = np.quantile(surface, [0.05, 0.95], axis=0)
    centre = [float(value) for value in 0.5 * (low + high)]
    boxed = sampling.scene_box and DEPTH not in dataset.absent
    corners = _corners(surface) if boxed else (None, None)
    return FieldBounds(near, far, (centre[0], centre[1], centre[2]), float((high - low).max() / 2), *corners)


def _corners(surface: Float[ndarray, "M 3"]) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return the low and the high corner of the box of all points [m] of surfaces."""
    low, high = surface.min(axis=0), surface.max(axis=0)
    margin = _BOX_MARGIN * (high - low).max()
    (a, b, c), (d, e, f) = (low - margin).tolist(), (high + margin).tolist()
    return (a, b, c), (d, e, f)
