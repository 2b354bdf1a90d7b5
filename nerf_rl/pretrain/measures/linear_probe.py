"""Linear probes: what a frozen encoder's latent knows of the true state."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.measures.supervised import train_supervised
from nerf_rl.pretrain.model.encoder import Encoder

_FRAMES_AT_ONCE = 64
_RIDGE = 1e-3  # of the standardised latents' variance

Figures = dict[str, dict[str, float]]
"""Column name to ``rmse_mm`` and ``r2``."""


@dataclass
class ProbeResult:
    """Figures of the encoder and of others beside it, column by column."""

    encoder: Figures
    random_encoder: Figures
    """of an untrained encoder"""
    latents: Float[ndarray, "N Z"]
    """of the training frames that the encoder's probe was fitted on"""
    supervised: Figures | None = None
    """of an encoder that was trained on the columns themselves"""

    def table(self) -> str:
        """Return the figures as lines of text."""
        head = f"{'linear probe':<20} {'RMSE [mm]':>10} {'R2':>7} {'untrained encoder [mm]':>23}"
        lines = [head + (f" {'supervised encoder [mm]':>24}" if self.supervised else "")]
        for name, figures in self.encoder.items():
            untrained = self.random_encoder[name]["rmse_mm"]
            line = f"{name:<20} {figures['rmse_mm']:>10.1f} {figures['r2']:>7.3f} {untrained:>23.1f}"
            lines.append(line + (f" {self.supervised[name]['rmse_mm']:>24.1f}" if self.supervised else ""))
        return "\n".join(lines)

    def summary(self) -> dict[str, Figures]:
        """Return what ``summary.json`` holds of them."""
        ceiling = {"probe_supervised_encoder": self.supervised} if self.supervised else {}
        return {"probe": self.encoder, "probe_random_encoder": self.random_encoder, **ceiling}


def probe_encoder(
    encoder: Encoder, dataset: MultiViewDataset, frames: int, seed: int, ceiling_steps: int = 0
) -> ProbeResult:
    """Fit probes on training frames and measure them on all held-out frames, for the encoder and an untrained copy.

    Columns that do not vary are left out.

    Args:
        encoder: frozen; it is run where it is.
        dataset: with the encoder's cameras.
        frames: how many training frames to fit on, evenly spread.
        seed: of the untrained copy.
        ceiling_steps: for how long to train a copy on the true state, which shows what is possible; 0 for none.

    Raises:
        UserError: there are too few frames.
    """
    train, held_out = dataset.split("train"), dataset.split("validation")
    if len(train) < 2 or len(held_out) < 2:
        raise UserError(f"{dataset.folder} needs at least two training and two validation frames to probe on")
    train = train[np.linspace(0, len(train) - 1, min(frames, len(train))).astype(int)]
    state = [dataset.read("state/privileged", part).astype(np.float64) for part in (train, held_out)]
    names = dataset.columns("privileged")
    varying = [i for i in range(len(names)) if min(part[:, i].std() for part in state) > 1e-4]

    def figures(candidate: Encoder) -> tuple[Figures, ndarray]:
        latents = [encode_frames(candidate, dataset, part) for part in (train, held_out)]
        truth = state[1][:, varying]
        squared = ((linear_probe(latents[0], state[0][:, varying], latents[1]) - truth) ** 2).mean(0)
        r2 = 1.0 - squared / truth.var(0)
        found = {
            names[column]: {"rmse_mm": round(1000 * float(squared[i]) ** 0.5, 3), "r2": round(float(r2[i]), 4)}
            for i, column in enumerate(varying)
        }
        return found, latents[0]

    with torch.random.fork_rng():
        torch.manual_seed(seed)
        untrained = Encoder(encoder.config, encoder.rig).eval().requires_grad_(False).to(encoder.latent_mean.device)
    own, latents = figures(encoder)
    result = ProbeResult(own, figures(untrained)[0], latents)
    if ceiling_steps and varying:
        supervised = train_supervised(encoder.config, encoder.rig, dataset, varying, ceiling_steps, seed)
        result.supervised = figures(supervised.to(encoder.latent_mean.device))[0]
    return result


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
