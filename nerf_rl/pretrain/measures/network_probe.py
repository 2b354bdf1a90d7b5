"""Network probes: what a small network reads from a latent beyond what is a linear function of it."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Integer
from numpy import ndarray
from torch import Tensor, nn

from nerf_rl.pretrain.measures.linear_probe import linear_probe

_HIDDEN = 128
_LEARNING_RATE = 2e-3
_WEIGHT_DECAY = 0.1
_FRAMES_PER_STEP = 256
_EPOCHS = 60
_PATIENCE = 10  # epochs without a better one for all targets together
_CHECKED = 0.15  # share of the episodes
_LEAST_DEVIATION = 1e-6


def network_probe(
    latents: Float[ndarray, "N Z"],
    targets: Float[ndarray, "N T"],
    queries: Float[ndarray, "M Z"],
    episodes: Integer[ndarray, "N"],
    seed: int,
) -> Float[ndarray, "M T"]:
    """Fit a linear map plus a network with two hidden layers; return the predictions for other latents.

    The network begins at zero and learns what the linear map leaves of the standardised targets; each target is read
    from the epoch that is best for it on a seventh of the episodes, on which nothing is fitted. So it is hardly ever
    worse than the linear probe, however few frames there are. It is fitted on the processor.

    Args:
        latents: of the frames to fit on.
        targets: of these frames.
        queries: latents to read.
        episodes: that these frames are of; frames of one show much the same, so an episode is fitted on or checked on.
        seed: of weights, order, and of the episodes that are checked on.
    """
    checked = _checked(episodes, np.random.default_rng(seed))
    linear = linear_probe(latents[~checked], targets[~checked], np.concatenate([latents, queries]))
    scale = _deviations(targets)
    residual = torch.from_numpy((targets - linear[: len(latents)]) / scale).float()
    mean, deviation = latents.mean(0), _deviations(latents)
    design, query = (torch.from_numpy((part - mean) / deviation).float() for part in (latents, queries))
    return linear[len(latents) :] + _fit(design, residual, query, torch.from_numpy(checked), seed) * scale


def _fit(
    design: Float[Tensor, "N Z"],
    target: Float[Tensor, "N T"],
    query: Float[Tensor, "M Z"],
    checked: Bool[Tensor, "N"],
    seed: int,
) -> Float[ndarray, "M T"]:
    """Return what the network reads, each number from the epoch after which it was best on what is checked."""
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        last = nn.Linear(_HIDDEN, target.shape[1])
        layers = [nn.Linear(design.shape[1], _HIDDEN), nn.SiLU(), nn.Linear(_HIDDEN, _HIDDEN), nn.SiLU(), last]
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    network = nn.Sequential(*layers)
    fitted_design, fitted_target = design[~checked], target[~checked]
    check_design, check_target = design[checked], target[checked]
    steps = _EPOCHS * -(-len(fitted_design) // _FRAMES_PER_STEP)
    optimiser = torch.optim.AdamW(network.parameters(), _LEARNING_RATE, weight_decay=_WEIGHT_DECAY, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    least, read = (check_target**2).mean(0), torch.zeros(len(query), target.shape[1])
    least_mean, waited = least.mean(), 0
    for _ in range(_EPOCHS):
        for frames in torch.randperm(len(fitted_design), generator=generator).split(_FRAMES_PER_STEP):
            loss = nn.functional.mse_loss(network(fitted_design[frames]), fitted_target[frames])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
        with torch.no_grad():
            errors = ((network(check_design) - check_target) ** 2).mean(0)
            read = torch.where(errors < least, network(query), read)
        least = torch.minimum(errors, least)
        waited = 0 if errors.mean() < least_mean else waited + 1
        least_mean = torch.minimum(errors.mean(), least_mean)
        if waited == _PATIENCE:
            break
    return read.double().numpy()


def _checked(episodes: Integer[ndarray, "N"], rng: np.random.Generator) -> ndarray:
    """Return which frames are checked on: those of some episodes, or single ones where all are of one."""
    groups = episodes if len(np.unique(episodes)) > 1 else np.arange(len(episodes))
    names = rng.permutation(np.unique(groups))
    return np.isin(groups, names[: max(1, round(_CHECKED * len(names)))])


def _deviations(values: Float[ndarray, "N D"]) -> Float[ndarray, "D"]:
    """Return deviations, and 1 where nothing varies."""
    deviation = values.std(0)
    return np.where(deviation > _LEAST_DEVIATION, deviation, 1.0)
