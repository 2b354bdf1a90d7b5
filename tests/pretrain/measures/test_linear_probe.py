"""Linear probes: the fit by another route, and the latents that it is of."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.measures.linear_probe import encode_frames, linear_probe
from nerf_rl.pretrain.model.encoder import Encoder

RIDGE = 1e-3


def random_latents(count: int, seed: int) -> np.ndarray:
    """Return correlated latents of different scales, one of them constant."""
    rng = np.random.default_rng(seed)
    mixing = np.random.default_rng(9).normal(size=(8, 8))
    latents = rng.normal(size=(count, 8)) @ mixing * np.logspace(-2, 2, 8) + 3.0
    latents[:, 5] = 1.5
    return latents


def test_a_linear_map_is_recovered():
    rng = np.random.default_rng(0)
    latents, queries = rng.normal(size=(400, 8)), rng.normal(size=(100, 8))
    weights, offset = rng.normal(size=(8, 3)), rng.normal(size=3)
    predicted = linear_probe(latents, latents @ weights + offset, queries)
    np.testing.assert_allclose(predicted, queries @ weights + offset, atol=0.02)


def test_the_fit_is_that_of_least_squares_on_padded_data():
    latents, queries = random_latents(60, 1), random_latents(20, 2)
    targets = np.random.default_rng(3).normal(size=(60, 2)) + 7.0
    mean, deviation = latents.mean(0), latents.std(0) + 1e-8
    design = np.concatenate([(latents - mean) / deviation, np.sqrt(RIDGE * 60) * np.eye(8)])  # ridge as further rows
    padded = np.concatenate([targets - targets.mean(0), np.zeros((8, 2))])
    weights = np.linalg.lstsq(design, padded, rcond=None)[0]
    expected = (queries - mean) / deviation @ weights + targets.mean(0)
    np.testing.assert_allclose(linear_probe(latents, targets, queries), expected, atol=1e-8)


def test_the_units_of_latents_do_not_matter():
    latents, queries = random_latents(60, 1), random_latents(20, 2)
    targets = np.random.default_rng(3).normal(size=(60, 2))
    predicted = linear_probe(latents, targets, queries)
    np.testing.assert_allclose(linear_probe(1e4 * latents - 7, targets, 1e4 * queries - 7), predicted, atol=1e-5)


def test_latents_are_those_of_single_frames(tiny_dataset: Path, tiny_encoder: Path, monkeypatch: pytest.MonkeyPatch):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    monkeypatch.setattr("nerf_rl.pretrain.measures.linear_probe._FRAMES_AT_ONCE", 3)
    frames = np.array([7, 0, 2, 7])
    latents = encode_frames(encoder, dataset, frames)
    for row, frame in zip(latents, frames.tolist(), strict=True):
        images = torch.from_numpy(dataset.read("rgb", [frame])[:, [1, 2]])
        matrices = torch.from_numpy(dataset.projections([frame])[:, [1, 2]].astype(np.float32))
        np.testing.assert_allclose(row, encoder(images, matrices)[0].numpy(), atol=1e-5)
