"""The encoder that learns the true state itself."""

from pathlib import Path

import numpy as np
import torch

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.measures.linear_probe import encode_frames
from nerf_rl.pretrain.measures.supervised import train_supervised
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig

CONFIG = EncoderConfig(latent=4, channels=[8, 16], hidden=16)  # too few numbers to fit nine frames by chance


def left_over(encoder: Encoder, dataset: MultiViewDataset) -> float:
    """Return the share of the hand's variance that no linear function of the latents explains."""
    frames = dataset.split("train")
    latents = encode_frames(encoder, dataset, frames)
    state = dataset.read("state/privileged", frames)[:, :3].astype(np.float64)
    design = np.concatenate([latents, np.ones((len(latents), 1))], axis=1)
    residual = state - design @ np.linalg.lstsq(design, state, rcond=None)[0]
    return float((residual**2).sum() / ((state - state.mean(0)) ** 2).sum())


def test_its_latents_know_the_columns_that_it_was_trained_on(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    torch.manual_seed(0)
    untrained = Encoder(CONFIG, EncoderRig.of_dataset(dataset), landmarks=2).eval().requires_grad_(False)
    trained = train_supervised(untrained, dataset, [0, 1, 2], 400, seed=0)
    assert left_over(trained, dataset) < 0.3 * left_over(untrained, dataset)
    assert not any(parameter.requires_grad for parameter in trained.parameters())


def test_a_seed_decides_it(tiny_dataset: Path):
    dataset = MultiViewDataset(tiny_dataset)
    like = Encoder(CONFIG, EncoderRig.of_dataset(dataset))
    first, again, other = (train_supervised(like, dataset, [0, 1], 2, seed).state_dict() for seed in (1, 1, 2))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not all(torch.equal(first[name], other[name]) for name in first)
