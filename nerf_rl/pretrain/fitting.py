"""Training with Lightning, and the export of what came out."""

import logging
import math
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import lightning
import torch
from lightning.pytorch.callbacks import Callback, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.loggers import closed_at_end, make_lightning_logger
from nerf_rl.pretrain.config import FIELD, RANDOM, PretrainConfig
from nerf_rl.pretrain.data.batches import drawn_frames
from nerf_rl.pretrain.data.data_module import NO_FRAME, MultiViewDataModule
from nerf_rl.pretrain.execution.distributed import is_lost_connection
from nerf_rl.pretrain.execution.faults import FAILED_BATCH, NotFiniteError, OutOfMemoryError, is_out_of_memory
from nerf_rl.pretrain.execution.launch import LostProcessError
from nerf_rl.pretrain.execution.placement import (
    choose_accelerator,
    choose_strategy,
    describe_device,
    environment,
    thread_count,
)
from nerf_rl.pretrain.measures.figures import describe_validation
from nerf_rl.pretrain.measures.latent_statistics import measure_latents
from nerf_rl.pretrain.measures.probing import ProbeResult, probe_encoder
from nerf_rl.pretrain.model.encoder_file import CHECKPOINT, DESCRIPTION
from nerf_rl.pretrain.model.precision import lightning_precision, resolve_precision
from nerf_rl.pretrain.objectives.encoder_module import EncoderModule
from nerf_rl.pretrain.objectives.held_out_pictures import reconstruction_grid
from nerf_rl.pretrain.objectives.picture_module import PictureModule
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule
from nerf_rl.pretrain.reconstructions import FOLDER, picture_name
from nerf_rl.pretrain.resuming import require_resumable
from nerf_rl.progress import Progress

_FRAMES_IN_GRID = 3


@dataclass
class FitResult:
    """What a pretraining run measured."""

    steps: int
    training_seconds: float
    device: str
    precision: str
    validation: dict[str, float | None]
    class_iou: dict[str, float | None]
    class_share: dict[str, float]
    """of the pixels of held-out frames"""
    other_cameras: dict[str, dict[str, float | None]]
    """what ``validation`` is of the encoder's cameras, of those of other roles"""
    probe: ProbeResult


def fit(config: PretrainConfig, dataset: MultiViewDataset, folder: Path, checkpoint: Path | None) -> FitResult | None:
    """Train, validate, probe and export into a folder, from a checkpoint if one is given.

    Only a radiance field is validated, since only that renders what the cameras saw.

    Returns:
        What was measured; None in all processes but the first of those that share the run.

    Raises:
        KeyboardInterrupt: the user interrupted; the last checkpoint stays.
        NotFiniteError: a step's gradient is not finite; the last checkpoint stays.
        SpoiltWeightsError: the latents, or the field's colours, are not; it stays, too.
        OutOfMemoryError: there is not enough memory for the networks, or for a step.
        LostProcessError: another process that shares the run has gone.
    """
    accelerator = choose_accelerator(config.accelerator, config.devices)
    precision = resolve_precision(config.precision, torch.device(accelerator))
    threads = thread_count(config, accelerator) or torch.get_num_threads()
    torch.set_num_threads(threads)
    for name in ("lightning.pytorch", "lightning.fabric"):  # advertisements, lists of devices and processes
        logging.getLogger(name).setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="lightning.pytorch.*")
    lightning.seed_everything(config.seed, verbose=False)
    logs = "logs" if checkpoint is None else f"logs/resumed_{int(time.time())}"  # a logger empties its folder
    loggers = [make_lightning_logger(name, folder, logs) for name in config.loggers]
    trainer = lightning.Trainer(
        default_root_dir=folder,
        accelerator=accelerator,
        devices=config.devices,
        num_nodes=config.nodes,
        strategy=choose_strategy(config),
        plugins=[environment(config)],
        max_steps=config.steps,
        precision=lightning_precision(precision),
        logger=[CSVLogger(folder, name="", version=logs), *loggers],
        callbacks=[
            ModelCheckpoint(
                folder / CHECKPOINT.parent,
                filename=CHECKPOINT.stem,
                every_n_epochs=1,
                save_on_train_epoch_end=True,
                enable_version_counter=False,
            ),
            _ProgressLines(config.steps),
            _Reconstructions(folder / FOLDER),
        ],
        check_val_every_n_epoch=config.epochs_per_validation,
        reload_dataloaders_every_n_epochs=1,
        use_distributed_sampler=False,  # a batch and a validation share themselves out
        num_sanity_val_steps=1 if config.objective == FIELD else 0,
        limit_val_batches=1.0 if config.objective == FIELD else 0,
        log_every_n_steps=config.log_every,
        enable_progress_bar=False,
        enable_model_summary=False,
    )
    data = MultiViewDataModule(dataset, config, trainer.global_rank, trainer.world_size, accelerator == "cuda")
    try:
        module = make_module(config, dataset, data, threads if accelerator == "cpu" else 1)
        if checkpoint is not None:
            require_resumable(checkpoint, module, trainer)
        if trainer.is_global_zero and (data.statistics.anchors.classes or data.statistics.anchors.seldom):
            print(data.statistics.anchors.describe(dataset.class_names), flush=True)
        with closed_at_end(loggers):
            if config.objective != RANDOM:
                trainer.fit(module, data, ckpt_path=checkpoint, weights_only=True)
            torch.set_num_threads(threads)
            if isinstance(module, SnerlModule) and module.validated_step != trainer.global_step:
                trainer.validate(module, data, verbose=False)
    except SystemExit as error:  # what Lightning makes of an interruption
        raise KeyboardInterrupt from error
    except NotFiniteError as error:
        if trainer.is_global_zero:
            frames = drawn_frames(dataset, config, error.step).tolist()
            losses = {name: value if math.isfinite(value) else None for name, value in error.losses.items()}
            failed = {"step": error.step, "seed": config.seed, "frames": frames, "losses": losses}
            write_json(folder / FAILED_BATCH, failed)
        raise
    except (RuntimeError, MemoryError) as error:
        if is_out_of_memory(error):
            raise OutOfMemoryError(describe_device(trainer.strategy.root_device)) from error
        if trainer.world_size > 1 and is_lost_connection(error):
            raise LostProcessError("another process of the run has gone") from error
        raise
    if not trainer.is_global_zero:
        return None
    device = describe_device(trainer.strategy.root_device)
    probe = _export(module, dataset, config, folder)
    found = module.validation, module.class_iou, module.class_share, module.other_cameras, probe
    return FitResult(trainer.global_step, module.seconds, device, precision, *found)


def make_module(
    config: PretrainConfig, dataset: MultiViewDataset, data: MultiViewDataModule, threads: int = 1
) -> EncoderModule:
    """Return what trains the encoder by the configuration's objective.

    Args:
        config: of the run.
        dataset: to train on.
        data: its batches and statistics.
        threads: that share a step's scenes, where the objective allows it.
    """
    if config.objective == FIELD:
        module = SnerlModule(config, dataset, data.statistics, data.rig)
        module.threads = threads
        return module
    if config.objective == RANDOM:
        return EncoderModule(config, dataset, data.statistics.anchors, data.rig)
    return PictureModule(config, dataset, data.statistics, data.rig)


def _export(module: EncoderModule, dataset: MultiViewDataset, config: PretrainConfig, folder: Path) -> ProbeResult:
    """Probe the encoder, set its latents' statistics, and write encoder and, if there is one, field."""
    print("probing the encoder, and an untrained one beside it", flush=True)
    encoder = module.encoder.cpu().eval().requires_grad_(False)
    probe = probe_encoder(encoder, dataset, config.probe_frames, config.seed)
    mean, deviation = measure_latents(encoder, dataset)
    encoder.latent_mean.copy_(mean)
    encoder.latent_std.copy_(deviation)
    description = {
        "classes": list(dataset.class_names),
        "palette": dataset.palette.tolist(),
        "objective": config.objective,
        "dataset": {"folder": str(dataset.folder), "sha256": dataset.digest()},
        "validation": module.validation,
        "probe": probe.encoder.columns,
        "joint_probe": probe.encoder.joints,
    }
    for earlier in (SUMMARY, DESCRIPTION):  # a resumed run that is cut off here has none, rather than an older one's
        (folder / earlier).unlink(missing_ok=True)
    if isinstance(module, SnerlModule):
        module.field.cpu().save(folder)
    encoder.save(folder, description)
    return probe


class _ProgressLines(Callback):
    """Shows the progress of training, from the first of the processes."""

    def __init__(self, steps: int):
        self._steps = steps

    def on_train_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        self._progress = Progress(self._steps, "steps", done=trainer.global_step)

    def on_train_batch_end(self, trainer: lightning.Trainer, module: lightning.LightningModule, *_: Any) -> None:
        if trainer.is_global_zero and isinstance(module, EncoderModule):
            self._progress.advance(note=module.describe_step, most_seconds=module.seconds_left())

    def on_validation_start(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        frames = len(trainer.val_dataloaders) if trainer.val_dataloaders is not None else 0
        self._validation = Progress(frames, "held-out frames")

    def on_validation_batch_end(self, trainer: lightning.Trainer, module: lightning.LightningModule, *_: Any) -> None:
        if trainer.is_global_zero and not trainer.sanity_checking:
            self._validation.advance()

    def on_validation_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.is_global_zero and not trainer.sanity_checking and isinstance(module, SnerlModule):
            print(f"step {trainer.global_step}: {describe_validation(module.validation)}", flush=True)


class _Reconstructions(Callback):
    """Writes pictures of held-out frames beside the truth after each validation."""

    def __init__(self, folder: Path):
        self._folder = folder

    def on_validation_end(self, trainer: lightning.Trainer, module: lightning.LightningModule) -> None:
        if trainer.sanity_checking or not trainer.is_global_zero or not isinstance(module, SnerlModule):
            return
        self._folder.mkdir(exist_ok=True)
        frames = [frame for frame in trainer.val_dataloaders.dataset if frame != NO_FRAME]  # type: ignore[union-attr]
        picked = [int(frames[len(frames) * i // _FRAMES_IN_GRID]) for i in range(_FRAMES_IN_GRID)]
        grid = reconstruction_grid(module, picked)
        cv2.imwrite(str(self._folder / picture_name(trainer.global_step)), grid[..., ::-1])
