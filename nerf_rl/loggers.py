"""Where curves go besides a run's own CSV file: Lightning's loggers by name, or a user's own by ``module:Class``."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nerf_rl.errors import UnknownNameError
from nerf_rl.machine.extras import find_named, import_extra, make_named

if TYPE_CHECKING:
    from lightning.pytorch.loggers import Logger

TENSORBOARD, WANDB, MLFLOW = "tensorboard", "wandb", "mlflow"
NAMES = (TENSORBOARD, WANDB, MLFLOW)
_PROJECT = "nerf-rl"


def check_loggers(names: Sequence[str]) -> None:
    """Raise UserError for a name that is neither known nor ``module:Class``; nothing is imported."""
    for name in names:
        if name not in NAMES and ":" not in name:
            raise UnknownNameError("logger", name, NAMES)


def require_loggers(names: Sequence[str]) -> None:
    """Raise UserError if an extra is not installed or a logger of the user's own is not there; nothing is written."""
    for name in names:
        if name in (WANDB, MLFLOW):
            import_extra(name, name, f"--loggers {name}")  # package and extra have the logger's name
        elif name not in NAMES:
            find_named("logger", name)


def make_loggers(names: Sequence[str], run: Path, version: str = "logs") -> "list[Logger]":
    """Return loggers that write below a run's folder.

    Args:
        names: ``tensorboard``, ``wandb`` or ``mlflow`` (extras of the same names), or ``module:Class`` of a Lightning
            logger that is made from the run's folder.
        run: the folder.
        version: TensorBoard's folder in it.

    Raises:
        UserError: a logger of the user's own cannot be made.
    """
    return [_make(name, run, version) for name in names]


@contextlib.contextmanager
def closed_at_end(loggers: "Sequence[Logger]") -> Iterator[None]:
    """Tell loggers at the end of a run that it has ended, and whether well, so that none takes it for one that goes on.

    Args:
        loggers: of the run.
    """
    try:
        yield
    except BaseException:
        _close(loggers, False)
        raise
    _close(loggers, True)


def _close(loggers: "Sequence[Logger]", succeeded: bool) -> None:
    from lightning.pytorch.loggers import WandbLogger

    for logger in loggers:
        logger.finalize("success" if succeeded else "failed")
        if isinstance(logger, WandbLogger):
            import wandb

            wandb.finish(0 if succeeded else 1)  # otherwise this process's next run is taken for the same


def _make(name: str, run: Path, version: str) -> Any:
    from lightning.pytorch.loggers import MLFlowLogger, TensorBoardLogger, WandbLogger  # they take seconds to import

    if name == TENSORBOARD:
        return TensorBoardLogger(run, name="", version=version)
    if name == WANDB:
        return WandbLogger(save_dir=run, name=run.name, project=_PROJECT)
    if name == MLFLOW:
        kept = f"sqlite:///{run.resolve() / 'mlflow.db'}"  # unless there is a server
        return MLFlowLogger(_PROJECT, run.name, os.environ.get("MLFLOW_TRACKING_URI") or kept)
    return make_named("logger", name, run)
