"""The LightningModule that trains encoder and radiance field together."""

import math
from typing import Any

import numpy as np
import torch
from lightning.pytorch.trainer.states import TrainerFn
from torch import Tensor

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.metrics import confusion_matrix, intersection_over_union, psnr_db
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatch
from nerf_rl.pretrain.data.data_module import NO_FRAME
from nerf_rl.pretrain.data.statistics import Statistics
from nerf_rl.pretrain.data.teachers import find_teacher
from nerf_rl.pretrain.execution.distributed import sum_over_processes
from nerf_rl.pretrain.execution.side_by_side import Shares, equal_shares
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.precision import in_full_precision
from nerf_rl.pretrain.model.ray_rendering import RenderedImages, SampleNoise, render_depth_guided, render_images
from nerf_rl.pretrain.objectives.encoder_module import EncoderModule
from nerf_rl.pretrain.objectives.losses import losses, weighted_sum
from nerf_rl.pretrain.stopping import parse_goal

_PLANE_RATE = 10.0  # of static feature planes, times the learning rate: few rays reach any one cell
_LEAST_ERROR = 1e-10  # squared, of colours: a picture without any counts as 100 dB, which has a mean with others


class SnerlModule(EncoderModule):
    """Trains z by what the field renders from it.

    Args:
        config: of the run.
        dataset: for validation frames.
        statistics: of the dataset.
        rig: the encoder's cameras.
    """

    anchor_spread: Tensor

    def __init__(self, config: PretrainConfig, dataset: MultiViewDataset, statistics: Statistics, rig: EncoderRig):
        super().__init__(config, dataset, rig)
        self._bounds = statistics.bounds
        teacher_width = sum(find_teacher(name).width for name in config.teachers)
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
        self.threads = 1
        """that share the scenes of a training step"""
        self._reset_validation()

    def training_step(self, batch: RayBatch, step: int) -> Tensor:
        """Return the loss of a step, of this process's share of its scenes; log every loss by its name, of all."""
        self.field.set_coarse_to_fine(min(self.progress() / self.config.coarse_to_fine, 1.0))
        noise = self._noise(len(batch.images))
        shares = equal_shares(len(batch.images), self.threads)
        if len(shares) == 1:
            named, total = self._losses(batch, noise)
        else:
            named, total = self._shares.mean_losses(
                lambda share: self._losses(RayBatch(*(part[share] for part in batch)), noise.of_scenes(share)),
                shares,
                [parameter for parameter in self.parameters() if parameter.requires_grad],
            )
        self.log_losses(named, total)
        return total

    def _losses(self, batch: RayBatch, noise: SampleNoise) -> tuple[dict[str, Tensor], Tensor]:
        """Return the losses of some scenes by name, and their weighted sum."""
        latent = self.encoder(batch.images, batch.projections)
        rendered = render_depth_guided(
            self.field, latent, batch.origins, batch.directions, batch.depth, self.config.sampling, noise
        )
        with in_full_precision(self.device):
            origins = self.field.origins(latent)[:, : len(self.anchor_spread)]
        named = losses(rendered, batch, origins, self.anchor_spread)
        return named, weighted_sum(named, self.config.losses)

    def describe_step(self) -> str:
        """Return how the last step went, in words; it waits for the device."""
        error = float(self.last_losses.get("rgb", float("nan")))
        return f"PSNR of rays {psnr_db(error):.1f} dB, {super().describe_step()}"

    def _noise(self, scenes: int) -> SampleNoise:
        """Draw where the rays of this process's scenes are evaluated: its share of what one process would draw."""
        config = self.config
        shape = config.scenes_per_step, config.rays_per_scene
        noise = SampleNoise.draw(config.sampling, *shape, self.step_generator(), self.device)
        first = self.global_rank * scenes
        return noise.of_scenes(slice(first, first + scenes))

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return all parameters; cells of planes learn at a higher rate."""
        others = [parameter for parameter in self.parameters() if parameter is not self.field.planes]
        return [{"params": others}, {"params": [self.field.planes], "lr": _PLANE_RATE * self.config.learning_rate}]

    def on_train_start(self) -> None:
        """Leave single operations undivided while scenes are shared out."""
        self._shares = Shares(self.threads)
        self._divide(is_training=True)

    def on_validation_start(self) -> None:
        """Let PyTorch divide single operations, since frames are rendered one by one."""
        self._divide(is_training=False)

    def on_validation_end(self) -> None:
        """Leave them undivided again."""
        if self._is_fitting:
            self._divide(is_training=True)

    def _divide(self, is_training: bool) -> None:
        """Set PyTorch's own threads: those that do not have a share of a training step's scenes."""
        if self.threads > 1:
            shares = equal_shares(self.config.scenes_per_step // self.trainer.world_size, self.threads)
            torch.set_num_threads(max(1, self.threads // len(shares)) if is_training else self.threads)

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
        if self.config.stop_when and self._is_fitting and parse_goal(self.config.stop_when).is_reached(self.validation):
            self.trainer.should_stop = True
        known = {f"validation/{name}": value for name, value in self.validation.items() if value is not None}
        self.log_dict(known, rank_zero_only=True)

    @property
    def _is_fitting(self) -> bool:
        return self.trainer.state.fn == TrainerFn.FITTING and not self.trainer.sanity_checking

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

    def _reset_validation(self) -> None:
        classes = len(self._dataset.class_names)
        self._psnr: list[float] = []
        self._depth: list[float] = []
        self._confusion = np.zeros((classes, classes), np.int64)
