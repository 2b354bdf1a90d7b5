"""Training batches: for each step some frames, their encoder images, and rays drawn over their supervising cameras."""

from typing import NamedTuple

import lightning
import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from nerf_rl.cameras import camera_position, pixel_centres, pixel_directions
from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.pretrain.field import FieldBounds
from nerf_rl.pretrain.teachers import teacher_features

_FRAMES_FOR_STATISTICS = 200
_CANDIDATES_PER_RAY = 32


class RayBatch(NamedTuple):
    """B frames with R rays each."""

    images: UInt8[Tensor, "B V H W 3"]
    """what the encoder's cameras see"""
    projections: Float[Tensor, "B V 3 4"]
    """their matrices"""
    origins: Float[Tensor, "B R 3"]
    """of the rays [m]"""
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


class Statistics(NamedTuple):
    """What training needs to know of a dataset as a whole."""

    bounds: FieldBounds
    class_weights: Float[ndarray, "C"]
    """of a pixel by its class, when rays are drawn"""
    pixel_weights: Float[ndarray, "V H W"]
    """of a pixel by its place, for encoder and supervision cameras"""


def measure(dataset: MultiViewDataset, config: PretrainConfig) -> Statistics:
    """Measure the scene's extent and the classes' frequencies on some training frames."""
    train = dataset.split("train")
    frames = train[np.linspace(0, len(train) - 1, min(_FRAMES_FOR_STATISTICS, len(train))).astype(int)]
    views = dataset.views("encoder", "supervision")
    depth = dataset.read("depth", frames)[:, views]
    fixed = depth[:, [view in dataset.views("encoder") for view in views]]
    near = config.sampling.near if config.sampling.near is not None else 0.8 * float(np.quantile(fixed, 0.001))
    far = config.sampling.far if config.sampling.far is not None else 2.5 * float(np.median(fixed))
    if not 0 < near < far:
        raise UserError(f"sampling needs 0 < near < far, got near {near:.3f} and far {far:.3f}")

    intrinsics, poses = dataset.cameras(frames)
    points = []
    for i, view in enumerate(views):
        pixels = np.broadcast_to(pixel_centres(*depth.shape[2:]), (len(frames), depth[0, 0].size, 2))
        directions = pixel_directions(np.broadcast_to(intrinsics[view], (len(frames), 3, 3)), poses[:, view], pixels)
        flat = depth[:, i].reshape(len(frames), -1, 1)
        surface = camera_position(poses[:, view])[:, None] + flat * directions
        points.append(surface[(flat[..., 0] < far)])
    low, high = np.quantile(np.concatenate(points)[::7], [0.05, 0.95], axis=0)
    centre = 0.5 * (low + high)
    bounds = FieldBounds(
        near, far, (float(centre[0]), float(centre[1]), float(centre[2])), float((high - low).max() / 2)
    )

    semantic = dataset.read("semantic", frames)[:, views]
    counts = np.bincount(semantic.ravel(), minlength=len(dataset.class_names))
    frequency = np.maximum(counts, 1) / counts.sum()
    moving = np.abs(poses[:, views] - poses[:1, views]).max((0, 2, 3)) > 1e-9
    change = np.where(moving[:, None, None], 0.0, class_change(semantic, len(counts)))
    change[moving] = change[~moving].mean() if not moving.all() else 0.0
    return Statistics(bounds, frequency**-config.class_balance, 1.0 + config.change_boost * change)


def class_change(semantic: UInt8[ndarray, "N V H W"], classes: int) -> Float[ndarray, "V H W"]:
    """Return the share of images in which a pixel does not show its most frequent class.

    Where something may be and is not, the background tells as much as the thing itself does where it is.
    """
    shares = np.stack([(semantic == label).mean(0) for label in range(classes)])
    return 1.0 - shares.max(0)


class RayBatches(Dataset):
    """Maps a step's number to its batch, so that a step's content depends on nothing but the seed and the number."""

    def __init__(self, dataset: MultiViewDataset, config: PretrainConfig, statistics: Statistics):
        self._dataset, self._config, self._statistics = dataset, config, statistics
        self._frames = dataset.split("train")
        self._encoder_views = dataset.views("encoder")
        self._views = dataset.views("encoder", "supervision")

    def __getitem__(self, step: int) -> RayBatch:
        config, far = self._config, self._statistics.bounds.far
        rng = np.random.default_rng([config.seed, step])
        frames = rng.choice(self._frames, config.scenes_per_step)
        rgb, semantic, depth = (self._dataset.read(name, frames) for name in ("rgb", "semantic", "depth"))
        intrinsics, poses = self._dataset.cameras(frames)
        images = rgb[:, self._encoder_views]
        projections = intrinsics[self._encoder_views] @ poses[:, self._encoder_views, :3]

        scene, view, row, column = self._draw_pixels(semantic[:, self._views], rng)
        image = scene * depth.shape[1] + view
        flat_depth = depth.reshape(-1, *depth.shape[2:])
        flat_poses = np.ascontiguousarray(poses.reshape(-1, 4, 4))
        flat_intrinsics = np.broadcast_to(intrinsics, (len(frames), *intrinsics.shape)).reshape(-1, 3, 3)
        pixels = np.stack([column, row], axis=-1)[:, None] + 0.5
        directions = pixel_directions(flat_intrinsics[image], flat_poses[image], pixels)[:, 0]
        origins = camera_position(flat_poses)[image]
        features = (
            teacher_features(config.teachers, flat_depth, flat_intrinsics, flat_poses, image, row, column, far)
            if config.teachers
            else np.zeros((len(image), 0), np.float32)
        )
        shape = (config.scenes_per_step, config.rays_per_scene)

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
        )

    def _draw_pixels(
        self, semantic: UInt8[ndarray, "B V H W"], rng: np.random.Generator
    ) -> tuple[Int[ndarray, "M"], Int[ndarray, "M"], Int[ndarray, "M"], Int[ndarray, "M"]]:
        """Draw rays of each scene by the weights of their pixels' classes; return scene, view, row and column.

        Each scene's rays are drawn from a uniform sample of its pixels, which is much larger than the number of rays.
        """
        batch, rays = len(semantic), self._config.rays_per_scene
        flat = semantic.reshape(batch, -1)
        candidates = rng.integers(flat.shape[1], size=(batch, rays * _CANDIDATES_PER_RAY))
        weights = self._statistics.class_weights.take(np.take_along_axis(flat, candidates, axis=1))
        weights *= self._statistics.pixel_weights.take(candidates)
        cumulative = np.cumsum(weights, axis=1)
        levels = rng.random((batch, rays)) * cumulative[:, -1:]
        drawn = np.stack(
            [np.searchsorted(row, level, side="right") for row, level in zip(cumulative, levels, strict=True)]
        )
        pixel = np.take_along_axis(candidates, np.minimum(drawn, candidates.shape[1] - 1), axis=1).ravel()
        view, row, column = np.unravel_index(pixel, semantic.shape[1:])
        return np.repeat(np.arange(batch), rays), np.asarray(self._views)[view], row, column


class MultiViewDataModule(lightning.LightningDataModule):
    """Batches of an epoch for training, and whole held-out frames for validation.

    Args:
        dataset: to train on.
        config: of the run.
    """

    def __init__(self, dataset: MultiViewDataset, config: PretrainConfig):
        super().__init__()
        self._dataset, self._config = dataset, config
        self.statistics = measure(dataset, config)
        self.rig = EncoderRig.of_dataset(dataset)

    def train_dataloader(self) -> DataLoader:
        """Return the steps that are left of the current epoch; an epoch is what lies between two checkpoints.

        It is found by the number of steps: Lightning, when resumed, begins with the number of the epoch that ended.
        """
        first = self.trainer.global_step if self.trainer is not None else 0
        epoch = first // self._config.steps_per_epoch
        return DataLoader(
            RayBatches(self._dataset, self._config, self.statistics),
            batch_size=None,
            sampler=range(first, min((epoch + 1) * self._config.steps_per_epoch, self._config.steps)),
            num_workers=self._config.loader_workers,
            multiprocessing_context="spawn" if self._config.loader_workers else None,
        )

    def val_dataloader(self) -> DataLoader:
        """Return the indices of held-out frames, spread evenly over the held-out episodes."""
        frames = self._dataset.split("validation")
        chosen = frames[np.linspace(0, len(frames) - 1, min(self._config.validation_frames, len(frames))).astype(int)]
        return DataLoader([int(frame) for frame in chosen], batch_size=None)  # type: ignore[arg-type]
