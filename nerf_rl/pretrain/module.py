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
from nerf_rl.pretrain.artefact import SIMULATORS
from nerf_rl.pretrain.batches import RayBatch
from nerf_rl.pretrain.checkpoint_file import ENCODER
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data_module import NO_FRAME
from nerf_rl.pretrain.distributed import mean_over_processes, of_first_process, sum_over_processes
from nerf_rl.pretrain.encoder import Encoder
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.pretrain.field import RadianceField
from nerf_rl.pretrain.latent_statistics import FRAMES, FRAMES_IN_TRAINING, measure_latents
from nerf_rl.pretrain.losses import losses, weighted_sum
from nerf_rl.pretrain.precision import in_full_precision
from nerf_rl.pretrain.rendering import RenderedImages, SampleNoise, render_images, render_with_depth
from nerf_rl.pretrain.statistics import Statistics
from nerf_rl.pretrain.teachers import WIDTHS

_WARM_UP = 0.03  # share of the schedule in which the learning rate rises
_PLANE_RATE = 10.0  # of static feature planes, times the learning rate: few rays reach any one cell
_LAST_RATE = 0.02  # of the peak rate
_LONGEST_GRADIENT = 1.0
_LEAST_ERROR = 1e-10  # squared, of colours: a picture without any counts as 100 dB, which has a mean with others


class SnerlModule(lightning.LightningModule):
    """Trains z by what the field renders from it.

    Args:
        config: of the run.
        dataset: for validation frames.
        statistics: of the dataset.
        rig: the encoder's cameras.
    """

    anchor_spread: Tensor

    def __init__(self, config: PretrainConfig, dataset: MultiViewDataset, statistics: Statistics, rig: EncoderRig):
        super().__init__()
        self.config, self._dataset, self._bounds = config, dataset, statistics.bounds
        self.encoder = Encoder(config.encoder, rig)
        self.encoder.scene = dataset.manifest["scene"]["name"]
        self.encoder.quality = dataset.manifest["config"]["quality"]
        self.encoder.detail = dataset.manifest.get("detail")
        self.encoder.renderer = dataset.manifest.get("renderer", "")
        packages = dataset.manifest.get("packages", {})
        self.encoder.simulators = {name: packages[name] for name in SIMULATORS if name in packages}
        teacher_width = sum(WIDTHS[teacher] for teacher in config.teachers)
        classes = len(dataset.class_names)
        anchors = statistics.anchors
        self.field = RadianceField(
            config.radiance_field,
            statistics.bounds,
            config.encoder.latent,
            classes,
            teacher_width,
            len(anchors.classes),
        )
        self.field.place_anchors(torch.from_numpy(anchors.mean))
        self.register_buffer("anchor_spread", torch.from_numpy(anchors.spread).float(), persistent=False)
        self.validation: dict[str, float | None] = {}
        self.class_iou: dict[str, float | None] = {}
        self.class_share: dict[str, float] = {}
        self.validated_step = -1
        """the step that ``validation``, ``class_iou`` and ``class_share`` (of the pixels) are of"""
        self.seconds = 0.0
        """spent training, over all resumptions [s]"""
        self.ray_error: Tensor | None = None
        """squared error of the last step's colours; it stays on the device, so that no step waits to show it"""
        self._clock = time.monotonic()
        self._reset_validation()

    def training_step(self, batch: RayBatch, step: int) -> Tensor:
        """Return the loss of a step, of this process's share of its scenes; log every loss by its name, of all."""
        self.field.sharpen(min(self.progress() / self.config.sharp_at, 1.0))
        latent = self.encoder(batch.images, batch.projections)
        rendered = render_with_depth(
            self.field,
            latent,
            batch.origins,
            batch.directions,
            batch.depth,
            self.config.sampling,
            self._noise(len(batch.images)),
        )
        with in_full_precision(self.device):
            origins = self.field.origins(latent)[:, : len(self.anchor_spread)]
        named = losses(rendered, batch, origins, self.anchor_spread)
        total = weighted_sum(named, self.config.losses)
        values = mean_over_processes(torch.stack([value.detach() for value in (*named.values(), total)]))
        self.ray_error = values[0]
        self.log_dict({f"train/{name}": value for name, value in zip((*named, "total"), values, strict=True)})
        return total

    def describe_step(self) -> str:
        """Return how the last step went, in words; it waits for the device."""
        error = float("nan") if self.ray_error is None else float(self.ray_error)
        return f"PSNR of rays {psnr_db(error):.1f} dB, {100 * self.progress():.0f} % of the budget"

    def _noise(self, scenes: int) -> SampleNoise:
        """Draw where the rays of this process's scenes are evaluated: its share of what one process would draw."""
        config = self.config
        generator = torch.Generator(self.device).manual_seed(config.seed * 1_000_003 + self.global_step)
        noise = SampleNoise.draw(config.sampling, config.scenes_per_step, config.rays_per_scene, generator, self.device)
        first = self.global_rank * scenes
        return noise.of_scenes(slice(first, first + scenes))

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
        self._count_time()
        if self.progress() >= 1.0:
            self.trainer.should_stop = True
            return -1
        return None

    def _count_time(self) -> None:
        """Add what has passed since the last call; where schedules follow the time, by the first process's clock."""
        now = time.monotonic()
        self.seconds, self._clock = self.seconds + now - self._clock, now
        if self.config.max_minutes is not None:
            self.seconds = of_first_process(self.seconds, self.device)

    def on_fit_start(self) -> None:
        """Start the clock."""
        self._clock = time.monotonic()

    def on_validation_epoch_start(self) -> None:
        """Forget the last validation."""
        self._reset_validation()

    def validation_step(self, frame: int, step: int) -> None:
        """Render a held-out frame from the encoder's cameras, without its depth, and compare."""
        if int(frame) == NO_FRAME:
            return
        rendered, truth = self.render_frame(int(frame)), self.truth(int(frame))
        error = ((rendered.rgb - truth["rgb"]) ** 2).mean(axis=(1, 2, 3))
        self._psnr += [psnr_db(max(float(view), _LEAST_ERROR)) for view in error]
        self._confusion += confusion_matrix(truth["semantic"], rendered.semantic, len(self._confusion))
        near = truth["depth"] < self._bounds.far
        self._depth += [float(np.abs(rendered.depth - truth["depth"])[near].mean())] if near.any() else []

    def on_validation_epoch_end(self) -> None:
        """Log the figures of the held-out frames, those of all processes together."""
        sums = [sum(self._psnr), len(self._psnr), sum(self._depth), len(self._depth)]
        own = torch.tensor([*sums, *self._confusion.ravel()], dtype=torch.float64, device=self.device)
        merged = sum_over_processes(own).cpu().numpy()
        (psnr, views, depth, frames), confusion = merged[:4], merged[4:].reshape(self._confusion.shape)
        if not views:
            return
        iou = intersection_over_union(confusion.astype(np.int64))
        self.validation = {
            "psnr_db": float(psnr / views),
            "miou": float(np.nanmean(iou)),
            "depth_mae_m": float(depth / frames) if frames else None,
        }
        self.validated_step = self.global_step
        self.class_iou = {
            name: None if math.isnan(value) else float(value)
            for name, value in zip(self._dataset.class_names, iou.tolist(), strict=True)
        }
        shares = confusion.sum(1) / confusion.sum()
        self.class_share = dict(zip(self._dataset.class_names, shares.tolist(), strict=True))
        known = {f"validation/{name}": value for name, value in self.validation.items() if value is not None}
        self.log_dict(known, rank_zero_only=True)

    @property
    def palette(self) -> np.ndarray:
        """Colours of the semantic classes, u8 [C, 3]."""
        return self._dataset.palette

    @property
    def far(self) -> float:
        """Depth of the dataset's far plane [m]."""
        return float(self._dataset.manifest["far"])

    def truth(self, frame: int) -> dict[str, np.ndarray]:
        """Return colours in [0, 1], labels and depth of a frame from the encoder's cameras."""
        views = self._dataset.views("encoder")
        rgb, depth = (self._dataset.read(name, [frame])[0, views] for name in ("rgb", "depth"))
        semantic = self._dataset.read_labels([frame])[0, views].astype(np.int64)
        return {"rgb": rgb.astype(np.float32) / 255.0, "semantic": semantic, "depth": depth}

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
        """Keep the time spent, which the schedule may depend on, and what makes the encoder usable by itself.

        That is its description and the statistics of its latents, which belong to these very weights.
        """
        checkpoint["seconds"] = self.seconds
        classes = {"classes": list(self._dataset.class_names), "palette": self.palette.tolist()}
        checkpoint[ENCODER] = {**self.encoder.describe(), **classes}
        frames = FRAMES if self.progress() >= 1.0 else FRAMES_IN_TRAINING
        mean, deviation = measure_latents(self.encoder, self._dataset, frames)
        checkpoint["state_dict"] |= {"encoder.latent_mean": mean, "encoder.latent_std": deviation}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Restore the time spent."""
        self.seconds = checkpoint["seconds"]

    def _reset_validation(self) -> None:
        classes = len(self._dataset.class_names)
        self._psnr: list[float] = []
        self._depth: list[float] = []
        self._confusion = np.zeros((classes, classes), np.int64)
