"""Training batches: for each step some frames, their encoder images, and rays drawn over their supervising cameras."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray
from torch import Tensor
from torch.utils.data import Dataset

from nerf_rl.cameras.geometry import camera_position, pixel_directions
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.anchors import FollowedMiddles, countable_labels
from nerf_rl.pretrain.data.segmentation import CellShares
from nerf_rl.pretrain.data.statistics import Statistics
from nerf_rl.pretrain.data.teachers import Pixels, Views, teacher_features

_CANDIDATES_PER_RAY = 32
WHOLE = slice(None)


class RayBatch(NamedTuple):
    """B frames with R rays each."""

    images: UInt8[Tensor, "B V H W 3"]
    """what the encoder's cameras see"""
    projections: Float[Tensor, "B V 3 4"]
    """their matrices"""
    origins: Float[Tensor, "B R 3"]
    """of the rays, like all positions in the dataset's tracking frame if it has one [m]"""
    directions: Float[Tensor, "B R 3"]
    """of the rays, of unit planar depth"""
    rgb: Float[Tensor, "B R 3"]
    """true colours in [0, 1]"""
    semantic: Int[Tensor, "B R"]
    """true class ids"""
    depth: Float[Tensor, "B R"]
    """true planar depth, at most that of the backdrop [m]"""
    feature: Float[Tensor, "B R F"]
    """the teachers' features"""
    middles: Float[Tensor, "B A 3"]
    """where the encoder's cameras see the classes that move [m]"""
    seen: Bool[Tensor, "B A"]
    """whether they do"""
    shares: Float[Tensor, "B V C h w"]
    """how much of each cell of the encoder's pictures shows what: something else, or one of those classes; weighted"""


class RayBatches(Dataset):
    """Maps a step's number to its batch, so that a step's content depends on nothing but the seed and the number.

    Args:
        dataset: to draw from.
        config: of the run.
        statistics: of the dataset.
        share: the scenes of a batch to prepare; the others are left to the processes that train on them.
    """

    def __init__(self, dataset: MultiViewDataset, config: PretrainConfig, statistics: Statistics, share: slice = WHOLE):
        self._dataset, self._config, self._statistics, self._share = dataset, config, statistics, share
        self._frames = dataset.split("train")
        self._encoder_views = dataset.views("encoder")
        self._views = dataset.views("encoder", "supervision")
        # a surface in front of where rays begin would be taught behind itself, where there may be nothing
        self._nearest = 0.0 if DEPTH in dataset.absent else statistics.bounds.near
        self._middles = FollowedMiddles(dataset, statistics.anchors)
        self._shares = CellShares(statistics.anchors, config.encoder.patch)

    def __getitem__(self, step: int) -> RayBatch:
        config, far = self._config, self._statistics.bounds.far
        rng = step_random(config, step)
        frames = rng.choice(self._frames, config.scenes_per_step)[self._share]
        rgb, depth = (self._dataset.read(name, frames) for name in ("rgb", "depth"))
        semantic, valid = self._dataset.read_labels(frames), self._dataset.read_valid(frames)
        intrinsics, poses = self._dataset.tracked_cameras(frames)
        images = rgb[:, self._encoder_views]
        projections = intrinsics[self._encoder_views] @ poses[:, self._encoder_views, :3]

        scene, view, row, column = self._draw_pixels(semantic, depth, valid, rng)
        image = scene * depth.shape[1] + view
        flat_poses = np.ascontiguousarray(poses.reshape(-1, 4, 4))
        flat_intrinsics = np.broadcast_to(intrinsics, (len(frames), *intrinsics.shape)).reshape(-1, 3, 3)
        pixels = np.stack([column, row], axis=-1)[:, None] + 0.5
        directions = pixel_directions(flat_intrinsics[image], flat_poses[image], pixels)[:, 0]
        origins = camera_position(flat_poses)[image]
        flat_rgb, flat_depth, flat_semantic = (array.reshape(-1, *array.shape[2:]) for array in (rgb, depth, semantic))
        views = Views(flat_rgb, flat_depth, flat_semantic, flat_intrinsics, flat_poses, far)
        features = teacher_features(config.teachers, views, Pixels(image, row, column))
        own = self._encoder_views
        labels = countable_labels(semantic, valid)
        middles = self._middles.of(frames, depth[:, own], labels[:, own], intrinsics[own], poses[:, own])
        shares = self._shares.of(semantic[:, own], None if valid is None else valid[:, own])
        shape = (len(frames), config.rays_per_scene)

        def tensor(values: ndarray, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(values.reshape(*shape, *values.shape[1:]))).to(dtype)

        return RayBatch(
            torch.from_numpy(np.ascontiguousarray(images)),
            torch.from_numpy(projections.astype(np.float32)),
            tensor(origins),
            tensor(directions),
            tensor(rgb[scene, view, row, column] / np.float32(255)),
            tensor(semantic[scene, view, row, column], torch.int64),
            tensor(np.minimum(depth[scene, view, row, column], far)),
            tensor(features),
            torch.from_numpy(middles.place),
            torch.from_numpy(middles.seen),
            torch.from_numpy(shares),
        )

    def _draw_pixels(
        self,
        semantic: UInt8[ndarray, "B V H W"],
        depth: Float[ndarray, "B V H W"],
        valid: Bool[ndarray, "B V H W"] | None,
        rng: np.random.Generator,
    ) -> tuple[Int[ndarray, "M"], Int[ndarray, "M"], Int[ndarray, "M"], Int[ndarray, "M"]]:
        """Draw rays of each scene by the weights of their pixels' classes; return scene, view, row and column.

        Pixels that do not count, or show what is before the beginning of rays, have no weight; all count if ``valid``
        is None. Each scene's rays are drawn from a uniform sample of its pixels, which is much larger than the number
        of rays, or from all of them where none in the sample counts.
        """
        scenes, rays = self._config.scenes_per_step, self._config.rays_per_scene
        area = semantic[0, 0].size
        candidates = rng.integers(len(self._views) * area, size=(scenes, rays * _CANDIDATES_PER_RAY))[self._share]

        def weigh(scenes: slice, candidates: ndarray) -> tuple[ndarray, ndarray]:
            place = np.take(self._views, candidates // area) * area + candidates % area

            def shown(images: ndarray) -> ndarray:
                return np.take_along_axis(images[scenes].reshape(len(place), -1), place, axis=1)

            weights = self._statistics.class_weights.take(shown(semantic))
            weights *= self._statistics.pixel_weights.take(candidates)
            weights *= shown(depth) >= self._nearest
            if valid is not None:
                weights *= shown(valid)
            return place, np.cumsum(weights, axis=1)

        place, cumulative = weigh(WHOLE, candidates)
        chances = rng.random((scenes, rays))[self._share]
        picked = [_pick(own, sums, chance) for own, sums, chance in zip(place, cumulative, chances, strict=True)]
        pixel = np.stack(picked)
        for scene in np.flatnonzero(cumulative[:, -1] == 0):
            place, cumulative = weigh(slice(scene, scene + 1), np.arange(len(self._views) * area)[None])
            pixel[scene] = _pick(place[0], cumulative[0], chances[scene])
        view, row, column = np.unravel_index(pixel.ravel(), semantic.shape[1:])
        return np.repeat(np.arange(len(semantic)), rays), view, row, column


def _pick(place: Int[ndarray, "N"], cumulative: Float[ndarray, "N"], chances: Float[ndarray, "R"]) -> Int[ndarray, "R"]:
    """Return the places that some chances in [0, 1) fall on, by the cumulative sums of their weights."""
    drawn = np.searchsorted(cumulative, chances * cumulative[-1], side="right")
    return place[np.minimum(drawn, len(place) - 1)]


def step_random(config: PretrainConfig, step: int) -> np.random.Generator:
    """Return the source of all that is drawn for a step's batch."""
    return np.random.default_rng([config.seed, step])


def drawn_frames(dataset: MultiViewDataset, config: PretrainConfig, step: int) -> Int[ndarray, "B"]:
    """Return the frames of a step's batch."""
    return step_random(config, step).choice(dataset.split("train"), config.scenes_per_step)
