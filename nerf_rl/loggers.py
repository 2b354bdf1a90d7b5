"""Where curves go besides a run's own CSV file: Lightning's loggers by name, or a user's own by ``module:Class``.

An agent's training has no use for Lightning but for its loggers, and TensorBoard's files can be written without: there,
Lightning, which takes seconds to import, is imported only for another logger.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.machine.extras import find_named, import_extra, make_named

if TYPE_CHECKING:
    from lightning.pytorch.loggers import Logger
    from torch.utils.tensorboard import SummaryWriter

TENSORBOARD, WANDB, MLFLOW = "tensorboard", "wandb", "mlflow"
NAMES = (TENSORBOARD, WANDB, MLFLOW)
LOGS = "logs"
"""TensorBoard's folder in a run's"""
_PROJECT = "nerf-rl"


def check_loggers(names: Sequence[str]) -> None:
    """Raise UserError for a name that is neither known nor ``module:Class``; nothing is imported."""
    for name in names:
        if name not in NAMES and ":" not in name:
            raise UnknownNameError("logger", name, NAMES)


def require_loggers(names: Sequence[str]) -> None:
    """Raise UserError if an extra is not installed or a class of the user's own is no logger; nothing is written."""
    for name in names:
        if name in (WANDB, MLFLOW):
            import_extra(name, name, f"--loggers {name}")  # package and extra have the logger's name
        elif name not in NAMES:
            found = find_named("logger", name)
            missing = [part for part in ("log_metrics", "save", "finalize") if not hasattr(found, part)]
            if isinstance(found, type) and missing:
                raise UserError(f"'{name}' is no logger: it lacks {', '.join(missing)}")


@runtime_checkable
class CurveLogger(Protocol):
    """What an agent's training asks of a logger; Lightning's have it."""

    def log_metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Take the values of some curves at a step."""

    def save(self) -> None:
        """Write what has been taken."""

    def finalize(self, status: str) -> None:
        """Close what is open; ``status`` is ``success`` or ``failed``."""


class TensorBoardFile:
    """TensorBoard's file of an agent's curves.

    Args:
        folder: to write it to; it is made with the first values.
        step: that the run goes on from; what its file tells of later ones is taken back.
    """

    def __init__(self, folder: Path, step: int = 0):
        self._folder, self._step = folder, step
        self._writer: SummaryWriter | None = None

    def log_metrics(self, metrics: Mapping[str, float], step: int) -> None:
        """Take the values of some curves at a step."""
        if self._writer is None:
            from torch.utils.tensorboard import SummaryWriter  # it takes half a second to import

            self._writer = SummaryWriter(self._folder, purge_step=self._step + 1 if self._step else None)
        for name, value in metrics.items():
            self._writer.add_scalar(name, value, step)

    def save(self) -> None:
        """Write what has been taken."""
        if self._writer is not None:
            self._writer.flush()

    def finalize(self, status: str) -> None:
        """Close the file."""
        if self._writer is not None:
            self._writer.close()


def make_loggers(names: Sequence[str], run: Path, step: int = 0) -> list[CurveLogger]:
    """Return loggers of an agent's training, which write below its run's folder.

    Args:
        names: ``tensorboard``, ``wandb`` or ``mlflow`` (extras of the same names), or ``module:Class`` of a Lightning
            logger that is made from the run's folder.
        run: the folder.
        step: that the run goes on from.

    Raises:
        UserError: a logger of the user's own cannot be made.
    """
    return [
        TensorBoardFile(run / LOGS, step) if name == TENSORBOARD else make_lightning_logger(name, run, LOGS)
        for name in names
    ]


@contextlib.contextmanager
def closed_at_end(loggers: "Sequence[CurveLogger | Logger]") -> Iterator[None]:
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


def _close(loggers: "Sequence[CurveLogger | Logger]", succeeded: bool) -> None:
    for logger in loggers:
        logger.finalize("success" if succeeded else "failed")
        if not isinstance(logger, TensorBoardFile) and _is_of_wandb(logger):
            import wandb

            wandb.finish(0 if succeeded else 1)  # otherwise this process's next run is taken for the same


def _is_of_wandb(logger: Any) -> bool:
    from lightning.pytorch.loggers import WandbLogger

    return isinstance(logger, WandbLogger)


def make_lightning_logger(name: str, run: Path, version: str) -> Any:
    """Return a logger for Lightning's trainer, which writes below a run's folder; TensorBoard's into ``version``.

    Raises:
        UserError: a logger of the user's own cannot be made.
    """
    from lightning.pytorch.loggers import MLFlowLogger, TensorBoardLogger, WandbLogger  # they take seconds to import

    if name == TENSORBOARD:
        return TensorBoardLogger(run, name="", version=version)
    if name == WANDB:
        return WandbLogger(save_dir=run, name=run.name, project=_PROJECT)
    if name == MLFLOW:
        kept = f"sqlite:///{run.resolve() / 'mlflow.db'}"  # unless there is a server
        return MLFlowLogger(_PROJECT, run.name, os.environ.get("MLFLOW_TRACKING_URI") or kept)
    return make_named("logger", name, run)
