"""Training with Lightning, and the export of what came out."""

import logging
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import lightning
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data import MultiViewDataModule
from nerf_rl.pretrain.linear_probe import ProbeResult, probe_encoder
from nerf_rl.pretrain.module import SnerlModule
from nerf_rl.pretrain.reconstruction import reconstruction_grid
from nerf_rl.pretrain.train import CHECKPOINT
from nerf_rl.progress import Progress

_FRAMES_IN_GRID = 3


@dataclass
class FitResult:
    """What a pretraining run measured."""

    steps: int
    training_seconds: float
    validation: dict[str, float]
    class_iou: dict[str, float]
    probe: ProbeResult


def fit(config: PretrainConfig, dataset: MultiViewDataset, folder: Path, checkpoint: Path | None) -> FitResult:
    """Train, validate, probe and export into a folder, from a checkpoint if one is given.

    Raises:
        KeyboardInterrupt: the user interrupted; the last checkpoint stays.
    """
    if config.threads is not None:
        torch.set_num_threads(config.threads)
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)  # its advertisements and device lists
    warnings.filterwarnings("ignore", module="lightning.pytorch.*")
    lightning.seed_everything(config.seed, verbose=False)
    data = MultiViewDataModule(dataset, config)
    module = SnerlModule(config, dataset, data.statistics, data.rig)
    logs = "logs" if checkpoint is None else f"logs/resumed_{int(time.time())}"  # a logger empties its folder
    trainer = lightning.Trainer(
        default_root_dir=folder,
        max_steps=config.steps,
        precision=_precision(config.precision),
        logger=[CSVLogger(folder, name="", version=logs), TensorBoardLogger(folder, name="", version=logs)],
        callbacks=[
            ModelCheckpoint(
                folder / CHECKPOINT.parent,
                filename=CHECKPOINT.stem,
                every_n_epochs=1,
                save_on_train_epoch_end=True,
                enable_version_counter=False,
            ),
            _ProgressLines(config.steps),
            _Reconstructions(folder / "reconstructions"),
        ],
        check_val_every_n_epoch=config.epochs_per_validation,
        reload_dataloaders_every_n_epochs=1,
        num_sanity_val_steps=1,
        log_every_n_steps=25,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    try:
        trainer.fit(module, data, ckpt_path=checkpoint, weights_only=True)
    except SystemExit as error:  # what Lightning makes of an interruption
        raise KeyboardInterrupt from error
    if module.validated_step != trainer.global_step:
        trainer.validate(module, data, verbose=False)
    probe = _export(module, dataset, config, folder)
    return FitResult(trainer.global_step, module.seconds, module.validation, module.class_iou, probe)


def _export(module: SnerlModule, dataset: MultiViewDataset, config: PretrainConfig, folder: Path) -> ProbeResult:
    """Probe the encoder, set its latents' statistics, and write encoder and field."""
    encoder = module.encoder.cpu().eval().requires_grad_(False)
    probe = probe_encoder(encoder, dataset, config.probe_frames, config.seed)
    encoder.latent_mean.copy_(torch.from_numpy(probe.latents.mean(0)))
    encoder.latent_std.copy_(torch.from_numpy(probe.latents.std(0)).clamp_min(1e-4))
    description = {
        "classes": list(dataset.class_names),
        "palette": dataset.palette.tolist(),
        "dataset": {"folder": str(dataset.folder), "sha256": dataset.digest()},
        "validation": module.validation,
        "probe": probe.encoder,
    }
    encoder.save(folder, description)
    module.field.cpu().save(folder)
    return probe


def _precision(name: str) -> Any:
    """Return Lightning's name for a precision; ``auto`` takes bf16 where it is computed and not emulated."""
    if name == "auto":
        if torch.cuda.is_available():
            name = "bf16" if torch.cuda.is_bf16_supported() else "32"
        else:
            name = "bf16" if torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported() else "32"
    return {"32": "32-true", "bf16": "bf16-mixed"}[name]


class _ProgressLines(Callback):
    """Shows the progress of training."""

    def __init__(self, steps: int):
        self._steps = steps

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        self._progress = Progress(self._steps, "steps", done=trainer.global_step)

    def on_train_batch_end(self, trainer: lightning.Trainer, module: lightning.LightningModule, *_: Any) -> None:
        psnr = trainer.progress_bar_metrics.get("psnr", float("nan"))
        self._progress.advance(note=f"PSNR of rays {psnr:.1f} dB, {100 * module.progress():.0f} % of the budget")  # type: ignore[operator]

    def on_validation_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if not trainer.sanity_checking and isinstance(module, SnerlModule):
            figures = "  ".join(f"{name} {value:.3f}" for name, value in module.validation.items())
            print(f"step {trainer.global_step}: {figures}", flush=True)


class _Reconstructions(Callback):
    """Writes pictures of held-out frames beside the truth after each validation."""

    def __init__(self, folder: Path):
        self._folder = folder

    def on_validation_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.sanity_checking or not isinstance(module, SnerlModule):
            return
        self._folder.mkdir(exist_ok=True)
        frames = list(trainer.val_dataloaders.dataset)  # type: ignore[union-attr]
        picked = [int(frames[len(frames) * i // _FRAMES_IN_GRID]) for i in range(_FRAMES_IN_GRID)]
        grid = reconstruction_grid(module, picked)
        cv2.imwrite(str(self._folder / f"step_{trainer.global_step:06d}.png"), grid[..., ::-1])
