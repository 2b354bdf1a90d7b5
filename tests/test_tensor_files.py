"""Tensors on disk: whole or not at all."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from nerf_rl.tensor_files import write_tensors


def test_a_failed_write_leaves_the_older_file(tmp_path: Path) -> None:
    write_tensors(tmp_path / "x.safetensors", {"a": torch.ones(2)})
    shared = torch.ones(4)
    with pytest.raises(RuntimeError):
        write_tensors(tmp_path / "x.safetensors", {"a": shared, "b": shared})
    assert [path.name for path in tmp_path.iterdir()] == ["x.safetensors"]
    assert torch.equal(load_file(tmp_path / "x.safetensors")["a"], torch.ones(2))
