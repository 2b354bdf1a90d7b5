"""A step's scenes shared out among threads, each of which goes forwards and backwards by itself.

PyTorch's own threads share every single operation and wait for each other after it, a thousand times a step; where
waking up takes long, as on virtual machines, two of them are slower than one. These wait once a step. What they compute
is the same for a number of threads, whichever of them is faster.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import torch
from torch import Tensor

from nerf_rl.pretrain.execution.known_gradients import with_gradients

Losses = dict[str, Tensor]


class Shares:
    """Runs the shares of a step side by side.

    Args:
        threads: how many there are.
    """

    def __init__(self, threads: int):
        self._pool = ThreadPoolExecutor(threads, "shares")

    def mean_losses(
        self,
        losses_of: Callable[[slice], tuple[Losses, Tensor]],
        shares: Sequence[slice],
        parameters: Sequence[Tensor],
    ) -> tuple[Losses, Tensor]:
        """Return the means over equal shares of losses by name, and of their total, which leads back to the parameters.

        Args:
            losses_of: gives a share's losses and their total; it is called in a thread for each.
            shares: of the scenes.
            parameters: that the total is to have gradients for.
        """
        device = parameters[0].device.type
        precision, reduced = torch.get_autocast_dtype(device), torch.is_autocast_enabled(device)

        def one(share: slice) -> tuple[Losses, Tensor, tuple[Tensor | None, ...]]:
            with torch.enable_grad(), torch.autocast(device, precision, reduced):  # which are of each thread
                named, total = losses_of(share)
            gradients = torch.autograd.grad(total / len(shares), parameters, allow_unused=True)
            return {name: value.detach() for name, value in named.items()}, total.detach(), gradients

        each = list(self._pool.map(one, shares))
        gradients = [_sum(column) for column in zip(*(found[2] for found in each), strict=True)]
        means = {name: torch.stack([found[0][name] for found in each]).mean() for name in each[0][0]}
        total = torch.stack([found[1] for found in each]).mean()
        return means, with_gradients(total, gradients, parameters)


def equal_shares(scenes: int, most: int) -> list[slice]:
    """Return as many equal shares of some scenes as there can be, up to a number."""
    count = next(count for count in range(min(most, scenes), 0, -1) if scenes % count == 0)
    each = scenes // count
    return [slice(first, first + each) for first in range(0, scenes, each)]


def _sum(column: tuple[Tensor | None, ...]) -> Tensor | None:
    known = [gradient for gradient in column if gradient is not None]
    return sum(known[1:], start=known[0]) if known else None
