"""On which devices a run trains, and how Lightning is told."""

import torch
from lightning.fabric.plugins.environments import (
    ClusterEnvironment,
    LightningEnvironment,
    SLURMEnvironment,
    TorchElasticEnvironment,
)
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from nerf_rl.errors import UserError
from nerf_rl.machine.cores import usable_cores
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.execution.launch import rank_from_outside


def choose_accelerator(name: str, devices: int) -> str:
    """Return ``cuda`` or ``cpu`` for Lightning's ``gpu``, ``cpu`` or ``auto``.

    Raises:
        UserError: there are not so many GPUs.
    """
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "cpu" or (name == "auto" and gpus == 0):
        return "cpu"
    if devices > gpus:
        found = f"only {gpus} GPU here that PyTorch can use" if gpus else "no GPU here that PyTorch can use"
        raise UserError(
            f"--accelerator {name} --devices {devices}: there is {found}; --accelerator cpu takes any number"
        )
    return "cuda"


def choose_strategy(config: PretrainConfig) -> str:
    """Return how the processes of a run train together, in Lightning's word."""
    return "ddp" if config.processes > 1 or config.strategy == "ddp" else "auto"


def environment(config: PretrainConfig) -> ClusterEnvironment:
    """Return what tells Lightning of a run's processes.

    It is named, not guessed: in a SLURM job Lightning would take the job's tasks for the processes of the run.
    """
    if rank_from_outside(config) is None:
        if config.processes == 1:
            rank_zero_only.rank = 0  # type: ignore[attr-defined]  # else the number of a SLURM task silences the loggers
        return LightningEnvironment()
    return TorchElasticEnvironment() if TorchElasticEnvironment.detect() else SLURMEnvironment(auto_requeue=False)


def thread_count(config: PretrainConfig, accelerator: str) -> int | None:
    """Return the CPU threads of a process; None leaves them to PyTorch."""
    if config.threads is None and accelerator == "cpu" and config.devices > 1:
        return max(1, usable_cores() // config.devices)
    return config.threads


def describe_device(device: torch.device) -> str:
    """Return a device's name for people."""
    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type
