"""Linear probes: what a frozen encoder's latent knows of the true state."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.encoder import Encoder

_FRAMES_AT_ONCE = 64
_RIDGE = 1e-3  # of the standardised latents' variance

Figures = dict[str, dict[str, float]]
"""Column name to ``rmse_mm`` and ``r2``."""


@dataclass
class ProbeResult:
    """Figures of the encoder and of an untrained one, column by column."""

    encoder: Figures
    random_encoder: Figures
    latents: Float[ndarray, "N Z"]
    """of the training frames that the encoder's probe was fitted on"""

    def table(self) -> str:
        """Return the figures as lines of text."""
        lines = [f"{'linear probe':<20} {'RMSE [mm]':>10} {'R2':>7} {'random encoder [mm]':>21}"]
        for name, figures in self.encoder.items():
            untrained = self.random_encoder[name]["rmse_mm"]
            lines.append(f"{name:<20} {figures['rmse_mm']:>10.1f} {figures['r2']:>7.3f} {untrained:>21.1f}")
        return "\n".join(lines)


def probe_encoder(encoder: Encoder, dataset: MultiViewDataset, frames: int, seed: int) -> ProbeResult:
    """Fit probes on training frames and measure them on all held-out frames, for the encoder and an untrained copy.

    Columns that do not vary are left out.

    Args:
        encoder: frozen; it is run where it is.
        dataset: with the encoder's cameras.
        frames: how many training frames to fit on, evenly spread.
        seed: of the untrained copy.
    """
    train, held_out = dataset.split("train"), dataset.split("validation")
    if len(train) < 2 or len(held_out) < 2:
        raise UserError(f"{dataset.folder} needs at least two training and two validation frames to probe on")
    train = train[np.linspace(0, len(train) - 1, min(frames, len(train))).astype(int)]
    state = [dataset.read("state/privileged", part).astype(np.float64) for part in (train, held_out)]
    names = dataset.columns("privileged")
    varying = [i for i in range(len(names)) if min(part[:, i].std() for part in state) > 1e-4]
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        untrained = Encoder(encoder.config, encoder.rig).eval().requires_grad_(False).to(encoder.latent_mean.device)
    results, fitted_on = [], []
    for candidate in (encoder, untrained):
        latents = [encode_frames(candidate, dataset, part) for part in (train, held_out)]
        fitted_on.append(latents[0])
        predicted = linear_probe(latents[0], state[0][:, varying], latents[1])
        truth = state[1][:, varying]
        squared = ((predicted - truth) ** 2).mean(0)
        r2 = 1.0 - squared / truth.var(0)
        results.append(
            {
                names[column]: {"rmse_mm": round(1000 * float(squared[i]) ** 0.5, 3), "r2": round(float(r2[i]), 4)}
                for i, column in enumerate(varying)
            }
        )
    return ProbeResult(results[0], results[1], fitted_on[0])


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
    device = encoder.latent_mean.device
    projections = torch.from_numpy(encoder.rig.projections).to(device)
    latents = []
    for start in range(0, len(frames), _FRAMES_AT_ONCE):
        images = torch.from_numpy(dataset.read("rgb", frames[start : start + _FRAMES_AT_ONCE])[:, views]).to(device)
        latents.append(encoder(images, projections.expand(len(images), -1, -1, -1)).cpu().numpy())
    return np.concatenate(latents).astype(np.float64)
