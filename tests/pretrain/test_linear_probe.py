"""Linear probes: the fit by another route, and what is reported."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.measures.linear_probe import encode_frames, linear_probe, probe_encoder
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


def test_figures_are_those_of_the_held_out_frames_in_columns_that_vary(tiny_dataset: Path, tiny_encoder: Path):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    result = probe_encoder(encoder, dataset, 9, seed=0)
    train, held_out = dataset.split("train"), dataset.split("validation")
    assert len(train) == 9
    state = dataset.read("state/privileged").astype(float)
    varying = [i for i in range(9) if min(state[train, i].std(), state[held_out, i].std()) > 1e-4]
    names = [dataset.columns("privileged")[i] for i in varying]
    assert list(result.encoder) == list(result.random_encoder) == names
    assert {"hand_x", "hand_y", "hand_z"} <= set(names) and "goal_z" not in names
    latents = [encode_frames(encoder, dataset, part) for part in (train, held_out)]
    np.testing.assert_array_equal(result.latents, latents[0])
    error = linear_probe(latents[0], state[train], latents[1]) - state[held_out]
    for name, column in zip(names, varying, strict=True):
        figures = result.encoder[name]
        assert figures["rmse_mm"] == pytest.approx(1000 * np.sqrt((error[:, column] ** 2).mean()), rel=1e-3)
        assert figures["r2"] == pytest.approx(
            1 - (error[:, column] ** 2).mean() / state[held_out, column].var(), abs=1e-3
        )
    assert result.encoder != result.random_encoder


def test_latents_are_those_of_single_frames(tiny_dataset: Path, tiny_encoder: Path, monkeypatch: pytest.MonkeyPatch):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    monkeypatch.setattr("nerf_rl.pretrain.measures.linear_probe._FRAMES_AT_ONCE", 3)
    frames = np.array([7, 0, 2, 7])
    latents = encode_frames(encoder, dataset, frames)
    for row, frame in zip(latents, frames.tolist(), strict=True):
        images = torch.from_numpy(dataset.read("rgb", [frame])[:, [1, 2]])
        matrices = torch.from_numpy(dataset.projections([frame])[:, [1, 2]].astype(np.float32))
        np.testing.assert_allclose(row, encoder(images, matrices)[0].numpy(), atol=1e-5)


def test_the_random_encoder_is_decided_by_the_seed_and_leaves_the_random_state_alone(
    tiny_dataset: Path, tiny_encoder: Path
):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    torch.manual_seed(1)
    before = torch.get_rng_state()
    first = probe_encoder(encoder, dataset, 9, seed=0).random_encoder
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(2)
    assert probe_encoder(encoder, dataset, 9, seed=0).random_encoder == first
    assert probe_encoder(encoder, dataset, 9, seed=1).random_encoder != first


def test_a_dataset_without_held_out_frames_is_refused(
    tiny_dataset: Path, tiny_encoder: Path, monkeypatch: pytest.MonkeyPatch
):
    dataset = MultiViewDataset(tiny_dataset)
    monkeypatch.setattr(dataset, "split", lambda name: np.arange(12 if name == "train" else 1))
    with pytest.raises(UserError, match="needs at least two training and two validation frames to probe on"):
        probe_encoder(Encoder.load(tiny_encoder), dataset, 9, seed=0)
