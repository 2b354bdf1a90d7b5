"""The state of networks and their optimisers as tensors with flat names, which a checkpoint holds without pickle."""

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from nerf_rl.files.tensor_files import require_tensors, strip_prefix

Networks = Mapping[str, nn.Module]
Optimisers = Mapping[str, torch.optim.Adam]


def flat_state(networks: Networks, optimisers: Optimisers) -> dict[str, Tensor]:
    """Return parameters, buffers and optimiser moments by flat names."""
    tensors: dict[str, Tensor] = {}
    for part, network in networks.items():
        tensors |= {f"{part}.{name}": tensor for name, tensor in network.state_dict().items()}
    for part, optimiser in optimisers.items():
        for index, moments in optimiser.state_dict()["state"].items():
            tensors |= {f"{part}.{index}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    return tensors


def load_flat_state(
    networks: Networks, optimisers: Optimisers, tensors: Mapping[str, Tensor], source: Path = Path("the checkpoint")
) -> None:
    """Put back what :func:`flat_state` returned.

    Args:
        networks, optimisers: as they are at the beginning of a run.
        tensors: of a checkpoint.
        source: the checkpoint, to be named if it does not fit.

    Raises:
        MissingFileError: they are those of other networks.
    """
    require_tensors(tensors, _expected(networks, optimisers, tensors), source)
    for part, network in networks.items():
        network.load_state_dict(strip_prefix(tensors, part))
    for part, optimiser in optimisers.items():
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in strip_prefix(tensors, part).items():
            index, name = key.split(".", 1)
            state.setdefault(int(index), {})[name] = value
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def _expected(networks: Networks, optimisers: Optimisers, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors like those of a checkpoint; moments of a parameter that was never updated may be absent."""
    expected = flat_state(networks, optimisers)
    for part, optimiser in optimisers.items():
        for index, parameter in enumerate(p for group in optimiser.param_groups for p in group["params"]):
            if any(name.startswith(f"{part}.{index}.") for name in tensors):
                moments = {"step": torch.zeros(()), "exp_avg": parameter, "exp_avg_sq": parameter}
                expected |= {f"{part}.{index}.{name}": like.detach() for name, like in moments.items()}
    return expected
