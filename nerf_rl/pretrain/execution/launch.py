"""Starting the processes that share a run's steps, one for each device; importing this module loads nothing heavy."""

import contextlib
import os
import signal
import socket
from collections.abc import Callable
from typing import Any

from nerf_rl.errors import FailureError, UserError
from nerf_rl.machine.processes import delay_interrupts, end_with_parent, start_method, start_server
from nerf_rl.pretrain.config import PretrainConfig

_PATIENCE = 10.0  # with processes that should end because another one has [s]
_RESUME = "go on from the last checkpoint with --resume true"


class LostProcessError(FailureError):
    """A process that shared the run is gone."""

    def __init__(self, who: str):
        super().__init__(f"{who}, and the others cannot go on without it; {_RESUME}")


def rank_from_outside(config: PretrainConfig) -> int | None:
    """Return which of the run's processes torchrun or srun has started this one as; None if neither has.

    Variables of a SLURM job alone say nothing: a run on one device is a run on one device, also as one of many tasks.

    Raises:
        UserError: they have started another number of processes than the configuration shares the steps among.
    """
    wanted = config.processes
    if "TORCHELASTIC_RUN_ID" in os.environ:
        starter, rank, started = "torchrun", int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])
    elif wanted > 1 and int(os.environ.get("SLURM_STEP_NUM_TASKS", "1")) > 1:
        starter, rank, started = "srun", int(os.environ["SLURM_PROCID"]), int(os.environ["SLURM_STEP_NUM_TASKS"])
    elif config.nodes > 1:
        raise UserError(f"--nodes {config.nodes}: start the command on each of them, with torchrun or srun")
    else:
        return None
    if started != wanted:
        raise UserError(
            f"{starter} has started {started} processes, but --devices {config.devices} on --nodes {config.nodes} "
            f"needs {wanted}"
        )
    return rank


def run_on_each_device(config: PretrainConfig, train: Callable[..., None], *arguments: Any) -> None:
    """Call ``train(config, *arguments)`` in one process for each device of this machine, and wait for all.

    Args:
        config: of the run.
        train: can be pickled, as can its arguments; finds its place in the variables that Lightning reads.
        arguments: its further arguments.

    Raises:
        FailureError: one of them failed or was ended; the others have been ended then.
        KeyboardInterrupt: the user interrupted; they have been ended then.
    """
    from torch import multiprocessing

    count = config.devices
    modules = ["nerf_rl.pretrain.fitting", train.__module__]
    start_server(modules)
    method = start_method(modules)
    told = multiprocessing.get_context(method).SimpleQueue()
    passed = (count, _free_port(), told, config, train, arguments)
    try:
        with delay_interrupts():
            context = multiprocessing.start_processes(_process, passed, count, join=False, start_method=method)
        while not context.join(grace_period=_PATIENCE):
            pass
    except (multiprocessing.ProcessExitedException, multiprocessing.ProcessRaisedException) as error:
        ended = [(rank, process.exitcode) for rank, process in enumerate(context.processes)]
        killed = [rank for rank, code in ended if code == -signal.SIGKILL]
        if isinstance(error, multiprocessing.ProcessExitedException) and error.signal_name:
            who = f"process {error.error_index} of {count} was ended by {error.signal_name}"
            raise LostProcessError(who) from error
        if killed:
            raise LostProcessError(f"process {killed[0]} of {count} was ended by SIGKILL") from error
        if not told.empty():
            kind, sentence = told.get()
            raise kind(sentence) from error
        raise
    except KeyboardInterrupt:
        for process in context.processes:
            process.terminate()
        for process in context.processes:
            process.join(_PATIENCE)
            process.kill()
        raise


def _process(
    rank: int,
    count: int,
    port: int,
    told: Any,
    config: PretrainConfig,
    train: Callable[..., None],
    arguments: tuple[Any, ...],
) -> None:
    """Be one of the processes: ``told`` takes the kind and the sentence of a failure that has one."""
    end_with_parent()
    place = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": count, "NODE_RANK": 0, "LOCAL_RANK": rank}
    os.environ.update({name: str(value) for name, value in place.items()})
    try:
        train(config, *arguments)
    except LostProcessError:
        raise SystemExit(1) from None  # who is lost, the process that started this one can tell
    except (UserError, FailureError) as error:
        told.put((UserError if isinstance(error, UserError) else FailureError, str(error)))
        raise SystemExit(1) from None


def _free_port() -> int:
    with contextlib.closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
