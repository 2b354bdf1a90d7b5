"""Where curves go besides a run's own CSV file: Lightning's loggers by name, or a user's own by ``module:Class``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerf_rl.errors import UnknownNameError
from nerf_rl.machine.extras import find_named, import_extra, make_named

if TYPE_CHECKING:
    from lightning.pytorch.loggers import Logger

TENSORBOARD, WANDB = "tensorboard", "wandb"
NAMES = (TENSORBOARD, WANDB)


def check_loggers(names: Sequence[str]) -> None:
    """Raise UserError for a name that is neither known nor ``module:Class``; nothing is imported."""
    for name in names:
        if name not in NAMES and ":" not in name:
            raise UnknownNameError("logger", name, NAMES)


def require_loggers(names: Sequence[str]) -> None:
    """Raise UserError if an extra is not installed or a logger of the user's own is not there; nothing is written."""
    for name in names:
        if name == WANDB:
            import_extra("wandb", "wandb", f"--loggers {WANDB}")
        elif name not in NAMES:
            find_named("logger", name)


def make_loggers(names: Sequence[str], run: Path, version: str = "logs") -> "list[Logger]":
    """Return loggers that write below a run's folder.

    Args:
        names: ``tensorboard``, ``wandb`` (extra ``wandb``), or ``module:Class`` of a Lightning logger that is made from
            the run's folder.
        run: the folder.
        version: TensorBoard's folder in it.

    Raises:
        UserError: a logger of the user's own cannot be made.
    """
    return [_make(name, run, version) for name in names]


def _make(name: str, run: Path, version: str) -> Any:
    from lightning.pytorch.loggers import TensorBoardLogger, WandbLogger  # they take seconds to import

    if name == TENSORBOARD:
        return TensorBoardLogger(run, name="", version=version)
    if name == WANDB:
        return WandbLogger(save_dir=run, name=run.name, project="nerf-rl")
    return make_named("logger", name, run)
