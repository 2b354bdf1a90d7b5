"""A number that leads back to parameters by gradients that were computed before."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor


def with_gradients(total: Tensor, gradients: Sequence[Tensor | None], parameters: Sequence[Tensor]) -> Tensor:
    """Return a number whose gradients for some parameters are known already; None is of those that it does not need."""
    return _KnownGradients.apply(total, gradients, *parameters)  # type: ignore[no-untyped-call, no-any-return]


class _KnownGradients(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, total: Tensor, gradients: Sequence[Tensor | None], *parameters: Tensor) -> Tensor:
        ctx.gradients = gradients
        return total.clone()

    @staticmethod
    def backward(ctx: Any, *outer: Tensor) -> Any:
        if not any(gradient is None for gradient in ctx.gradients):
            return None, None, *torch._foreach_mul(ctx.gradients, outer[0])
        return None, None, *(None if gradient is None else outer[0] * gradient for gradient in ctx.gradients)
