"""Named tensors as safetensors files, which cannot execute code when they are loaded."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.files.atomic import atomic_write

_REMEDY = "take the file from where it was made, or make it again"

M = TypeVar("M", bound=nn.Module)


def write_tensors(path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Write tensors whole or not at all."""
    with atomic_write(path) as aside:
        save_file({name: tensor.detach().contiguous() for name, tensor in tensors.items()}, aside)


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Read what :func:`write_tensors` wrote.

    Raises:
        MissingFileError: there is no such file, or it is damaged.
    """
    try:
        return load_file(path)
    except (SafetensorError, OSError, ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
        reason = "it does not exist" if not path.exists() else f"it is damaged ({error})"
        raise MissingFileError("a file of weights", path, reason, _REMEDY) from error


def filled(make: Callable[[], M], tensors: Mapping[str, Tensor], path: Path) -> M:
    """Return a module with weights of a file.

    The two are compared before anything is allocated, so that a description which asks for a network without end is
    told as one that does not fit.

    Args:
        make: makes the module that the description tells of.
        tensors: that the file holds.
        path: of the file.

    Raises:
        MissingFileError: the description makes no module, or the file has other weights.
    """
    try:
        with torch.device("meta"):
            expected = make().state_dict()
    except (UserError, RuntimeError, ValueError, TypeError, OverflowError, ArithmeticError) as error:
        reason = f"its description makes no network ({error})"
        raise MissingFileError("a file of weights", path, reason, _REMEDY) from error
    require_tensors(tensors, expected, path)
    module = make()
    module.load_state_dict(dict(tensors))
    return module


def require_tensors(tensors: Mapping[str, Any], expected: Mapping[str, Tensor], path: Path) -> None:
    """Check that a file holds the tensors that it should, by name, shape and kind, and that their values are finite.

    Raises:
        MissingFileError: naming the first that is otherwise.
    """
    names = [*(name for name in expected if name not in tensors), *(name for name in tensors if name not in expected)]
    if names:
        fault = f"{names[0]} is {'missing' if names[0] in expected else 'unknown'}"
    else:
        told = ((name, tensor_fault(tensors[name], like)) for name, like in expected.items())
        fault = next((f"{name} {what}" for name, what in told if what), "")
    if fault:
        raise MissingFileError("a file of weights that fits its description", path, fault, _REMEDY)


def tensor_fault(found: Any, like: Tensor) -> str:
    """Return how a tensor differs from one of the shape and kind that it should have; nothing if it does not."""
    if not isinstance(found, Tensor) or found.layout != torch.strided or found.device.type != "cpu":
        return "is no array of numbers"
    if found.shape != like.shape:
        return f"has the shape {_shape(found)} instead of {_shape(like)}"
    if found.dtype != like.dtype:
        return f"holds {found.dtype} instead of {like.dtype}".replace("torch.", "")
    return "" if bool(torch.isfinite(found).all()) else "holds values that are not finite"


def _shape(tensor: Tensor) -> str:
    return "x".join(map(str, tensor.shape)) or "of one number"


def strip_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names start with ``prefix.``, without it."""
    return {name.removeprefix(f"{prefix}."): t for name, t in tensors.items() if name.startswith(f"{prefix}.")}
