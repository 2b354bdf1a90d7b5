"""What the processes that share a training step tell each other; with one process, each value is its own."""

import torch
from jaxtyping import Float
from torch import Tensor, distributed


def _together() -> bool:
    return distributed.is_available() and distributed.is_initialized()


def sum_over_processes(values: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """Return the sum of all processes' values; all must call it."""
    if _together():
        values = values.clone()
        distributed.all_reduce(values)
    return values


def mean_over_processes(values: Float[Tensor, "*S"]) -> Float[Tensor, "*S"]:
    """Return the mean of all processes' values; all must call it."""
    return sum_over_processes(values) / distributed.get_world_size() if _together() else values


def of_first_process(value: float, device: torch.device) -> float:
    """Return the first process's value; all must call it.

    Args:
        value: this process's.
        device: of the run, whose transport carries it.
    """
    if not _together():
        return value
    shared = torch.tensor(value, dtype=torch.float64, device=device)
    distributed.broadcast(shared, 0)
    return float(shared)


def is_lost_connection(error: Exception) -> bool:
    """Tell whether an error is that of a process whose partner has gone."""
    return isinstance(error, distributed.DistError) or "gloo" in str(error)
