"""Training batches of whole views: for objectives that compare pictures and do not render."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.utils.data import Dataset

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import WHOLE, drawn_frames
from nerf_rl.pretrain.data.statistics import Statistics

_LEAST_DEVIATION = 1e-4


class ViewBatch(NamedTuple):
    """B scenes as the encoder's V cameras see them."""

    images: UInt8[Tensor, "B V H W 3"]
    """RGB"""
    projections: Float[Tensor, "B V 3 4"]
    """camera matrices [pixels, m]"""
    depth: Float[Tensor, "B V H W"]
    """planar depth, 0 at the nearest surface and 1 at the backdrop"""
    state: Float[Tensor, "B S"]
    """columns of the true state that vary, in deviations from their mean"""


class ViewBatches(Dataset):
    """Maps a step's number to its batch, of the very frames that the radiance field would see in that step.

    Args:
        dataset: to draw from.
        config: of the run.
        statistics: of the dataset.
        share: the scenes of a batch to prepare; the others are left to the processes that train on them.
    """

    def __init__(self, dataset: MultiViewDataset, config: PretrainConfig, statistics: Statistics, share: slice = WHOLE):
        self._dataset, self._config, self._share = dataset, config, share
        self._views = dataset.views("encoder")
        self._near, self._far = statistics.bounds.near, statistics.bounds.far
        self._columns, self._mean, self._deviation = standardised_state(dataset)

    def __getitem__(self, step: int) -> ViewBatch:
        frames = drawn_frames(self._dataset, self._config, step)[self._share]
        images = self._dataset.read("rgb", frames)[:, self._views]
        intrinsics, poses = self._dataset.tracked_cameras(frames)
        projections = intrinsics[self._views] @ poses[:, self._views, :3]
        depth = (self._dataset.read("depth", frames)[:, self._views] - self._near) / (self._far - self._near)
        state = self._dataset.tracked_positions(frames)[:, self._columns]
        return ViewBatch(
            torch.from_numpy(np.ascontiguousarray(images)),
            torch.from_numpy(projections.astype(np.float32)),
            torch.from_numpy(depth.clip(0.0, 1.0).astype(np.float32)),
            torch.from_numpy(((state - self._mean) / self._deviation).astype(np.float32)),
        )


def standardised_state(dataset: MultiViewDataset) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return which columns of the true state vary over training frames, and their means and deviations."""
    state = dataset.tracked_positions(dataset.split("train")).astype(np.float64)
    deviation = state.std(0)
    columns = np.flatnonzero(deviation > _LEAST_DEVIATION)
    return columns.tolist(), state.mean(0)[columns], deviation[columns]
