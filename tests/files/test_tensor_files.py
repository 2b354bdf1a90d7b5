"""Tensors on disk: whole or not at all."""

import os
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from nerf_rl.files import tensor_files
from nerf_rl.files.tensor_files import write_tensors


def test_a_failed_write_leaves_the_older_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_tensors(tmp_path / "x.safetensors", {"a": torch.ones(2)})

    def fill_the_disk(tensors: dict[str, torch.Tensor], path: Path) -> None:
        path.write_bytes(b"half a file")
        raise OSError("No space left on device")

    monkeypatch.setattr(tensor_files, "save_file", fill_the_disk)
    with pytest.raises(OSError, match="No space left"):
        write_tensors(tmp_path / "x.safetensors", {"a": torch.zeros(2)})
    assert [path.name for path in tmp_path.iterdir()] == ["x.safetensors"]
    assert torch.equal(load_file(tmp_path / "x.safetensors")["a"], torch.ones(2))


@pytest.mark.parametrize("umask, permissions", [(0o022, 0o644), (0o027, 0o640), (0o077, 0o600)])
def test_who_may_read_the_file_is_for_the_umask_to_say(tmp_path: Path, umask: int, permissions: int) -> None:
    before = os.umask(umask)
    try:
        write_tensors(tmp_path / "x.safetensors", {"a": torch.ones(2)})
    finally:
        os.umask(before)
    assert (tmp_path / "x.safetensors").stat().st_mode & 0o777 == permissions
