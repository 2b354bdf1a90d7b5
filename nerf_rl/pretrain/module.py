"""The LightningModule that trains encoder and radiance field together."""

import math
import time
from typing import Any

import lightning
import numpy as np
import torch
from torch import Tensor

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.metrics import confusion_matrix, intersection_over_union, psnr_db
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data import RayBatch, Statistics
from nerf_rl.pretrain.encoder import Encoder
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.pretrain.field import RadianceField
from nerf_rl.pretrain.losses import losses, weighted_sum
from nerf_rl.pretrain.rendering import RenderedImages, render_images, render_with_depth
from nerf_rl.pretrain.teachers import WIDTHS

_WARM_UP = 0.03  # share of the schedule in which the learning rate rises
_PLANE_RATE = 10.0  # of static feature planes, times the learning rate: few rays reach any one cell
_LAST_RATE = 0.02  # of the peak rate
_LONGEST_GRADIENT = 1.0


class SnerlModule(lightning.LightningModule):
    """Trains z by what the field renders from it.

    Args:
        config: of the run.
        dataset: for validation frames.
        statistics: of the dataset.
        rig: the encoder's cameras.
    """

    def __init__(self, config: PretrainConfig, dataset: MultiViewDataset, statistics: Statistics, rig: EncoderRig):
        super().__init__()
        self.config, self._dataset, self._bounds = config, dataset, statistics.bounds
        self.encoder = Encoder(config.encoder, rig)
        self.encoder.scene = dataset.manifest["scene"]["name"]
        self.encoder.quality = dataset.manifest["config"]["quality"]
        self.encoder.detail = dataset.manifest.get("detail")
        teacher_width = sum(WIDTHS[teacher] for teacher in config.teachers)
        classes = len(dataset.class_names)
        self.field = RadianceField(
            config.radiance_field, statistics.bounds, config.encoder.latent, classes, teacher_width
        )
        self.validation: dict[str, float] = {}
        self.class_iou: dict[str, float] = {}
        self.validated_step = -1
        """the step that ``validation`` and ``class_iou`` are of"""
        self.seconds = 0.0
        """spent training, over all resumptions [s]"""
        self._clock = time.monotonic()
        self._reset_validation()

    def training_step(self, batch: RayBatch, step: int) -> Tensor:
        """Return the loss of a step; log every loss by its name."""
        self.field.sharpen(min(self.progress() / self.config.sharp_at, 1.0))
        generator = torch.Generator(self.device).manual_seed(self.config.seed * 1_000_003 + self.global_step)
        latent = self.encoder(batch.images, batch.projections)
        rendered = render_with_depth(
            self.field, latent, batch.origins, batch.directions, batch.depth, self.config.sampling, generator
        )
        named = losses(rendered, batch)
        total = weighted_sum(named, self.config.losses)
        self.log_dict({f"train/{name}": value for name, value in {**named, "total": total}.items()})
        psnr = -10.0 * torch.log10(named["rgb"].detach())
        self.log("psnr", psnr, prog_bar=True, logger=False)
        return total

    def progress(self) -> float:
        """Return the share of the run that is done: of its steps, or of its time if that is further."""
        done = self.global_step / self.config.steps
        if self.config.max_minutes is not None:
            done = max(done, self.seconds / (60.0 * self.config.max_minutes))
        return min(done, 1.0)

    def learning_rate_factor(self) -> float:
        """Return the learning rate as a share of its peak: a linear rise, then a cosine."""
        done = self.progress()
        if done < _WARM_UP:
            return 0.1 + 0.9 * done / _WARM_UP
        cosine = 0.5 + 0.5 * math.cos(math.pi * (done - _WARM_UP) / (1.0 - _WARM_UP))
        return _LAST_RATE + (1.0 - _LAST_RATE) * cosine

    def configure_optimizers(self) -> Any:
        """Return Adam with the schedule of :meth:`learning_rate_factor`; cells of planes learn at a higher rate."""
        rate = self.config.learning_rate
        others = [parameter for parameter in self.parameters() if parameter is not self.field.planes]
        groups: list[dict[str, Any]] = [{"params": others}, {"params": [self.field.planes], "lr": _PLANE_RATE * rate}]
        optimiser = torch.optim.Adam(groups, lr=rate, betas=(0.9, 0.99), fused=True)
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda _: self.learning_rate_factor())
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def configure_gradient_clipping(
        self,
        optimizer: torch.optim.Optimizer,
        gradient_clip_val: int | float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """Shorten gradients longer than one.

        Lightning's own clipping refuses a fused optimiser in mixed precision, because such an optimiser undoes the
        scaling of a float16 loss only after it. Losses in bfloat16 are not scaled, so there is nothing to undo.
        """
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        torch.nn.utils.clip_grad_norm_(parameters, _LONGEST_GRADIENT)

    def on_train_batch_start(self, batch: RayBatch, step: int) -> int | None:
        """Count the time; end the run when the budget is spent."""
        now = time.monotonic()
        self.seconds, self._clock = self.seconds + now - self._clock, now
        if self.progress() >= 1.0:
            self.trainer.should_stop = True
            return -1
        return None

    def on_fit_start(self) -> None:
        """Start the clock."""
        self._clock = time.monotonic()

    def on_validation_epoch_start(self) -> None:
        """Forget the last validation."""
        self._reset_validation()

    def validation_step(self, frame: int, step: int) -> None:
        """Render a held-out frame from the encoder's cameras, without its depth, and compare."""
        rendered, truth = self.render_frame(int(frame)), self.truth(int(frame))
        error = ((rendered.rgb - truth["rgb"]) ** 2).mean(axis=(1, 2, 3))
        self._psnr += [psnr_db(float(view)) for view in error]
        self._confusion += confusion_matrix(truth["semantic"], rendered.semantic, len(self._confusion))
        near = truth["depth"] < self._bounds.far
        self._depth += [float(np.abs(rendered.depth - truth["depth"])[near].mean())] if near.any() else []

    def on_validation_epoch_end(self) -> None:
        """Log the figures of the held-out frames."""
        if not self._psnr:
            return
        iou = intersection_over_union(self._confusion)
        self.validation = {
            "psnr_db": float(np.mean(self._psnr)),
            "miou": float(np.nanmean(iou)),
            "depth_mae_m": float(np.mean(self._depth)) if self._depth else 0.0,
        }
        self.validated_step = self.global_step
        self.class_iou = {name: float(value) for name, value in zip(self._dataset.class_names, iou, strict=True)}
        self.log_dict({f"validation/{name}": value for name, value in self.validation.items()})

    @property
    def palette(self) -> np.ndarray:
        """Colours of the semantic classes, u8 [C, 3]."""
        return self._dataset.palette

    def truth(self, frame: int) -> dict[str, np.ndarray]:
        """Return colours in [0, 1], labels and depth of a frame from the encoder's cameras."""
        views = self._dataset.views("encoder")
        rows = {name: self._dataset.read(name, [frame])[0, views] for name in ("rgb", "semantic", "depth")}
        return {**rows, "rgb": rows["rgb"].astype(np.float32) / 255.0, "semantic": rows["semantic"].astype(np.int64)}

    @torch.no_grad()
    def render_frame(self, frame: int) -> RenderedImages:
        """Encode a frame and render it from the encoder's cameras."""
        rig = self.encoder.rig
        images = self._dataset.read("rgb", [frame])[:, self._dataset.views("encoder")]
        projections = torch.from_numpy(rig.projections).to(self.device)[None]
        latent = self.encoder(torch.from_numpy(images).to(self.device), projections)[0]
        pose = rig.camera_from_world
        return render_images(self.field, latent, rig.intrinsics, pose, rig.height, rig.width, self.config.sampling)

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep the time spent, which the schedule may depend on."""
        checkpoint["seconds"] = self.seconds

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Restore the time spent."""
        self.seconds = checkpoint["seconds"]

    def _reset_validation(self) -> None:
        classes = len(self._dataset.class_names)
        self._psnr: list[float] = []
        self._depth: list[float] = []
        self._confusion = np.zeros((classes, classes), np.int64)
