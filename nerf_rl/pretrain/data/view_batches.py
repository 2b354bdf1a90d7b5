"""Training batches of whole views: for objectives that compare pictures and do not render."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray
from torch import Tensor
from torch.utils.data import Dataset

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import ANCHORS, PretrainConfig
from nerf_rl.pretrain.data.anchors import FollowedMiddles, Middles, countable_labels
from nerf_rl.pretrain.data.batches import WHOLE, drawn_frames
from nerf_rl.pretrain.data.segmentation import CellShares
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
    middles: Float[Tensor, "B A 3"]
    """where these cameras see the classes that move, from their mean and in units of how far each moves; A is 0 unless
    an objective learns from them"""
    seen: Bool[Tensor, "B A"]
    """whether they do"""
    shares: Float[Tensor, "B V C h w"]
    """how much of each cell shows what: something else, or one of those classes; weighted; h is 0 like A"""


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
        self._anchors = statistics.anchors
        self._shares = CellShares(self._anchors, config.encoder.patch)
        self._followed = FollowedMiddles(dataset, self._anchors) if config.objective == ANCHORS else None

    def __getitem__(self, step: int) -> ViewBatch:
        frames = drawn_frames(self._dataset, self._config, step)[self._share]
        images = self._dataset.read("rgb", frames)[:, self._views]
        intrinsics, poses = self._dataset.tracked_cameras(frames)
        projections = intrinsics[self._views] @ poses[:, self._views, :3]
        metres = self._dataset.read("depth", frames)[:, self._views]
        depth = (metres - self._near) / (self._far - self._near)
        middles, shares = self._classes(frames, metres, intrinsics[self._views], poses[:, self._views])
        state = self._dataset.tracked_positions(frames)[:, self._columns]
        return ViewBatch(
            torch.from_numpy(np.ascontiguousarray(images)),
            torch.from_numpy(projections.astype(np.float32)),
            torch.from_numpy(depth.clip(0.0, 1.0).astype(np.float32)),
            torch.from_numpy(((state - self._mean) / self._deviation).astype(np.float32)),
            torch.from_numpy(middles.place.astype(np.float32)),
            torch.from_numpy(middles.seen),
            torch.from_numpy(shares),
        )

    def _classes(self, frames: ndarray, depth: ndarray, intrinsics: ndarray, poses: ndarray) -> tuple[Middles, ndarray]:
        """Return where classes are and what cells show, as :class:`ViewBatch` tells it; none if nothing learns that."""
        if self._followed is None:
            nowhere = Middles(np.zeros((len(frames), 0, 3)), np.zeros((len(frames), 0), bool))
            return nowhere, np.zeros((len(frames), len(self._views), 0, 0, 0), np.float32)
        labels, valid = self._dataset.read_labels(frames), self._dataset.read_valid(frames)
        countable = countable_labels(labels, valid)[:, self._views]
        found = self._followed.of(frames, depth, countable, intrinsics, poses)
        shares = self._shares.of(labels[:, self._views], None if valid is None else valid[:, self._views])
        return found._replace(place=(found.place - self._anchors.mean) / self._anchors.spread[:, None]), shares


def standardised_state(dataset: MultiViewDataset) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return which columns of the true state vary over training frames, and their means and deviations."""
    state = dataset.tracked_positions(dataset.split("train")).astype(np.float64)
    deviation = state.std(0)
    columns = np.flatnonzero(deviation > _LEAST_DEVIATION)
    return columns.tolist(), state.mean(0)[columns], deviation[columns]
