"""Mean and deviation of an encoder's latents over training frames, by which they are standardised."""

import copy

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.measures.linear_probe import encode_frames
from nerf_rl.pretrain.model.encoder import Encoder

FRAMES, FRAMES_IN_TRAINING = 512, 128
"""of a finished encoder; of one that is still trained, since its statistics are measured again with every checkpoint"""
_LEAST_DEVIATION = 1e-4


def measure_latents(
    encoder: Encoder, dataset: MultiViewDataset, most: int = FRAMES
) -> tuple[Float[Tensor, "Z"], Float[Tensor, "Z"]]:
    """Return mean and deviation of the latents of evenly spread training frames.

    They are measured on the processor in full precision, wherever and however the encoder is trained, so that the same
    weights always have the same statistics. The encoder is left as it is.

    Args:
        encoder: to measure.
        dataset: that it is trained on.
        most: how many frames to measure on.
    """
    train = dataset.split("train")
    frames = train[np.linspace(0, len(train) - 1, min(most, len(train))).astype(int)]
    measured = copy.deepcopy(encoder).cpu().float().eval()
    with torch.autocast("cpu", enabled=False):
        latents = encode_frames(measured, dataset, frames)
    mean, deviation = latents.mean(0), latents.std(0).clip(_LEAST_DEVIATION)
    return torch.from_numpy(mean).float(), torch.from_numpy(deviation).float()
