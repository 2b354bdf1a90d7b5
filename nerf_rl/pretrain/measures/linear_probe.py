"""Linear probes: what a linear function reads from a latent."""

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.model.encoder import Encoder

_FRAMES_AT_ONCE = 64
_RIDGE = 1e-3  # of the standardised latents' variance


def linear_probe(
    latents: Float[ndarray, "N Z"], targets: Float[ndarray, "N T"], queries: Float[ndarray, "M Z"]
) -> Float[ndarray, "M T"]:
    """Fit targets by ridge regression on standardised latents; return the predictions for other latents."""
    mean, deviation = latents.mean(0), latents.std(0) + 1e-8
    design, query = (latents - mean) / deviation, (queries - mean) / deviation
    gram = design.T @ design / len(design) + _RIDGE * np.eye(design.shape[1])
    weights = np.linalg.solve(gram, design.T @ (targets - targets.mean(0)) / len(design))
    return query @ weights + targets.mean(0)


@torch.inference_mode()
def encode_frames(encoder: Encoder, dataset: MultiViewDataset, frames: ndarray) -> Float[ndarray, "N Z"]:
    """Return the latents (not standardised) of some frames, from the dataset's encoder cameras."""
    views = dataset.views("encoder")
    latents = []
    for start in range(0, len(frames), _FRAMES_AT_ONCE):
        images = torch.from_numpy(dataset.read("rgb", frames[start : start + _FRAMES_AT_ONCE])[:, views])
        latents.append(encoder.encode(images).cpu().numpy())
    return np.concatenate(latents).astype(np.float64)
