"""Named tensors as safetensors files, which cannot execute code when they are loaded."""

import os
from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save_file
from torch import Tensor


def write_tensors(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Write tensors whole or not at all: aside, flushed to disk, renamed."""
    aside = path.with_name(f".{path.name}.partial")
    save_file({name: tensor.detach().contiguous() for name, tensor in tensors.items()}, aside)
    with open(aside, "rb") as file:
        os.fsync(file.fileno())
    os.replace(aside, path)
