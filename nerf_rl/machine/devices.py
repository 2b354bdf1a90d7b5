"""Where to compute: the names that ``--device`` takes, and mistakes in them told before anything else happens."""

import re
from typing import TYPE_CHECKING

from nerf_rl.errors import UserError

if TYPE_CHECKING:
    import torch

_NAMES = re.compile(r"auto|cpu|cuda(:\d+)?")


def check_device_name(name: str) -> None:
    """Raise UserError if a name is none that ``--device`` takes; whether the machine has the device is not asked."""
    if not _NAMES.fullmatch(name):
        raise UserError(f"unknown device '{name}'; --device takes auto, cpu, cuda, or one GPU of several as cuda:1")


def check_device(name: str) -> None:
    """Raise UserError if a device is unknown or absent; PyTorch is imported only where that has to be asked."""
    check_device_name(name)
    if name in ("auto", "cpu"):
        return
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if count <= int(name.partition(":")[2] or 0):
        available = ", ".join(["cpu", *(f"cuda:{index}" for index in range(count))])
        raise UserError(f"device '{name}' is not on this machine, or PyTorch cannot use it; available: {available}")


def resolve_device(name: str) -> "torch.device":
    """Return a device by its name; ``auto`` is a GPU if PyTorch can use one, else the CPU.

    Raises:
        UserError: unknown or absent; the message lists what is available.
    """
    check_device(name)
    import torch

    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)
