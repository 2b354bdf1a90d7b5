"""Named tensors as safetensors files, which cannot execute code when they are loaded."""

from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save_file
from torch import Tensor

from nerf_rl.runs import written_whole


def write_tensors(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Write tensors whole or not at all."""
    with written_whole(path) as aside:
        save_file({name: tensor.detach().contiguous() for name, tensor in tensors.items()}, aside)
