"""Standardisation of observations by running statistics (Lee et al. 2025, "SimBa", RSNorm)."""

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor, nn


class RunningNorm(nn.Module):
    """x -> (x - mean) / std with the mean and standard deviation of all observations seen so far.

    Numbers that hardly vary (a constant, a drawer that nothing has moved yet) are divided by ``floor`` instead, so that
    they do not drown the others when they do vary.

    Args:
        size: O.
        floor: smallest divisor.
    """

    def __init__(self, size: int, floor: float = 0.01):
        super().__init__()
        self._floor = floor
        self.count: Tensor
        self.mean: Tensor
        self.squares: Tensor
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("squares", torch.zeros(size, dtype=torch.float64))

    def update_statistics(self, observations: Float[ndarray, "E O"]) -> None:
        """Take observations into the statistics (Chan, Golub and LeVeque 1983, parallel updating)."""
        x = torch.from_numpy(observations.astype(np.float64)).to(self.mean.device)
        count = self.count + len(x)
        shift = x.mean(0) - self.mean
        self.squares += (x - x.mean(0)).square().sum(0) + shift.square() * self.count * len(x) / count
        self.mean += shift * len(x) / count
        self.count.copy_(count)

    @property
    def std(self) -> Float[Tensor, "O"]:
        """The divisor."""
        return (self.squares / self.count.clamp_min(1)).sqrt().clamp_min(self._floor)

    def forward(self, observation: Float[Tensor, "*B O"]) -> Float[Tensor, "*B O"]:
        """Standardise; the identity before anything has been seen."""
        standardised = (observation - self.mean.float()) / self.std.float()
        return torch.where(self.count == 0, observation, standardised)
