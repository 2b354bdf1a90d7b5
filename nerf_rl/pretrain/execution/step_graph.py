"""A training step as one launch: on a GPU, to launch its many small kernels takes longer than to run them."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from nerf_rl.pretrain.execution.known_gradients import with_gradients

Losses = Callable[[Sequence[Tensor]], tuple[dict[str, Tensor], Tensor]]
_WARM_UPS = 3  # as PyTorch does before it captures: libraries choose their kernels in the first


class StepGraph:
    """Losses and gradients of a step, captured as a CUDA graph once and then replayed.

    What is captured reads and writes the same memory in every replay, so inputs are copied to where the first ones
    were, and parameters must stay where they are. It must not draw random numbers, nor wait for the device.

    Args:
        losses: returns a step's losses by name and their weighted sum.
        parameters: to take gradients by.
        inputs: of a step, on the GPU; those of later steps have the same shapes.
    """

    def __init__(self, losses: Losses, parameters: Sequence[nn.Parameter], inputs: Sequence[Tensor]):
        self._parameters, self._inputs = list(parameters), [given.clone() for given in inputs]
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(_WARM_UPS):
                self._compute(losses)
        torch.cuda.current_stream().wait_stream(aside)
        self._graph = torch.cuda.CUDAGraph()
        # meanwhile another thread may reserve memory for the next batches
        with torch.cuda.graph(self._graph, capture_error_mode="thread_local"):
            self._named, self._total, self._gradients = self._compute(losses)

    def __call__(self, inputs: Sequence[Tensor]) -> tuple[dict[str, Tensor], Tensor]:
        """Return a step's losses by name, which the next step overwrites, and their sum, which has its gradients."""
        torch._foreach_copy_(self._inputs, list(inputs))
        self._graph.replay()
        return self._named, with_gradients(self._total, self._gradients, self._parameters)

    def _compute(self, losses: Losses) -> tuple[dict[str, Tensor], Tensor, tuple[Tensor, ...]]:
        named, total = losses(self._inputs)
        gradients = torch.autograd.grad(total, self._parameters, allow_unused=True, materialize_grads=True)
        return {name: value.detach() for name, value in named.items()}, total.detach(), gradients
