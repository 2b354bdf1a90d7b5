"""The LightningModule that trains encoder and radiance field together."""

from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.metrics import psnr_db
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatch
from nerf_rl.pretrain.data.data_module import NO_FRAME
from nerf_rl.pretrain.data.statistics import Statistics
from nerf_rl.pretrain.data.teachers import find_teacher
from nerf_rl.pretrain.execution.faults import SpoiltWeightsError
from nerf_rl.pretrain.execution.placement import choose_strategy
from nerf_rl.pretrain.execution.side_by_side import Shares, equal_shares
from nerf_rl.pretrain.execution.step_graph import StepGraph
from nerf_rl.pretrain.measures.picture_measures import PictureFigures, PictureMeasures
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.precision import in_full_precision, resolve_precision
from nerf_rl.pretrain.model.ray_rendering import RenderedImages, SampleNoise, render_depth_guided, render_images
from nerf_rl.pretrain.objectives.encoder_module import EncoderModule
from nerf_rl.pretrain.objectives.losses import SEGMENTATION, losses, segmentation_loss, weighted_sum

_PLANE_RATE = 10.0  # of feature planes, times the learning rate: few rays reach any one cell
ENCODER_CAMERAS = "encoder"
"""the role of those that z is made of; a run's figures are of what they see"""
_LOSSES_OF = {DEPTH: "depth", LABELS: "semantic"}  # which mean nothing where there is none
_OTHER_CAMERAS = ("test", "supervision")  # roles: never trained on; trained on, but not in these episodes
_MOST_OTHER_CAMERAS = 2  # of a role, the first ones: some datasets have a dome of fifty


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
        super().__init__(config, dataset, statistics.anchors, rig)
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
        if LABELS in dataset.absent:  # nothing teaches it, which processes that exchange gradients would refuse
            self.field.semantic_head.requires_grad_(False)
        self.field.place_anchors(*(torch.from_numpy(value) for value in (anchors.mean, anchors.spread, anchors.size)))
        self.register_buffer("anchor_spread", torch.from_numpy(anchors.spread).float(), persistent=False)
        self._distance = statistics.distance
        self.threads = 1
        """that share the scenes of a training step"""
        self._graph: StepGraph | None = None
        others = {role: dataset.views(role)[:_MOST_OTHER_CAMERAS] for role in _OTHER_CAMERAS if dataset.views(role)}
        self._views = {ENCODER_CAMERAS: dataset.views(ENCODER_CAMERAS), **others}
        names, far = dataset.class_names, statistics.bounds.far
        self._measures = {role: PictureMeasures(names, far) for role in self._views}
        self._registered = nn.ModuleDict(self._measures)  # with which they follow the module to its device

    def training_step(self, batch: RayBatch, step: int) -> Tensor:
        """Return the loss of a step, of this process's share of its scenes; log every loss by its name, of all."""
        self.field.set_coarse_to_fine(min(self.progress() / self.config.coarse_to_fine, 1.0))
        noise = self._noise(len(batch.images))
        shares = equal_shares(len(batch.images), self.threads)
        if self._replays:
            named, total = self._replayed_losses(batch, noise)
        elif len(shares) == 1:
            named, total = self._losses(batch, noise)
        else:
            named, total = self._shares.mean_losses(
                lambda share: self._losses(RayBatch(*(part[share] for part in batch)), noise.of_scenes(share)),
                shares,
                self._trained(),
            )
        self.log_losses(named, total)
        return total

    def _losses(self, batch: RayBatch, noise: SampleNoise) -> tuple[dict[str, Tensor], Tensor]:
        """Return the losses of some scenes by name, and their weighted sum."""
        latent, landmarks = self.encoder.read(batch.images, batch.projections)
        rays = batch.origins, batch.directions, batch.depth
        rendered = render_depth_guided(self.field, latent, *rays, self.config.sampling, noise, self._distance)
        with in_full_precision(self.device):
            origins = self.field.origins(latent)[:, : len(self.anchor_spread)]
        named = losses(rendered, batch, origins, self.anchor_spread, self._distance)
        if landmarks is not None:
            named[SEGMENTATION] = segmentation_loss(landmarks.logits, batch.shares)
        for kind in self._dataset.absent:
            named.pop(_LOSSES_OF.get(kind, ""), None)
        return named, weighted_sum(named, self.config.losses)

    @cached_property
    def _replays(self) -> bool:
        """Whether steps are captured.

        Not where processes exchange gradients while those are computed, nor in bfloat16: nobody has tried whether
        weights are cast anew in each replay.
        """
        config, is_gpu = self.config, self.device.type == "cuda"
        is_whole = resolve_precision(config.precision, self.device) == "32"
        return config.step_graph and is_gpu and is_whole and choose_strategy(config) == "auto"

    def _replayed_losses(self, batch: RayBatch, noise: SampleNoise) -> tuple[dict[str, Tensor], Tensor]:
        """Return what :meth:`_losses` does, by replaying what it did in the first step."""
        inputs = [*batch, noise.even, noise.before, noise.around]
        if self._graph is None:
            parts = len(batch)
            self._graph = StepGraph(
                lambda given: self._losses(RayBatch(*given[:parts]), SampleNoise(*given[parts:])),
                self._trained(),
                inputs,
            )
        return self._graph(inputs)

    def _trained(self) -> list[nn.Parameter]:
        return [parameter for parameter in self.parameters() if parameter.requires_grad]

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
        """Return all parameters; the field's layers and the cells of its planes learn at higher rates."""
        rate, field = self.config.learning_rate, self.field
        planes = [field.planes, *(field.object_planes.parameters() if field.object_planes is not None else ())]
        layers = [*field.layers.parameters(), *field.latent_layers.parameters()]
        for head in (field.density_head, field.rgb_head, field.semantic_head, field.feature_head):
            layers += head.parameters() if head is not None else ()
        faster = {id(parameter) for parameter in (*planes, *layers)}
        return [
            {"params": [parameter for parameter in self.parameters() if id(parameter) not in faster]},
            {"params": layers, "lr": self.config.field_rate * rate},
            {"params": planes, "lr": _PLANE_RATE * rate},
        ]

    def on_train_start(self) -> None:
        """Leave single operations undivided while scenes are shared out."""
        self._shares = Shares(self.threads)
        self._divide(is_training=True)

    def on_validation_start(self) -> None:
        """Let PyTorch divide single operations, since frames are rendered one by one."""
        super().on_validation_start()
        self._divide(is_training=False)

    def on_validation_end(self) -> None:
        """Leave them undivided again, and forget the check before training."""
        super().on_validation_end()
        if self.trainer.sanity_checking:
            self.validated_step = -1  # that looks at one frame
        if self._is_fitting:
            self._divide(is_training=True)

    def _divide(self, is_training: bool) -> None:
        """Set PyTorch's own threads: those that do not have a share of a training step's scenes."""
        if self.threads > 1:
            shares = equal_shares(self.config.scenes_per_step // self.trainer.world_size, self.threads)
            torch.set_num_threads(max(1, self.threads // len(shares)) if is_training else self.threads)

    def on_validation_epoch_start(self) -> None:
        """Forget the last validation."""
        for measures in self._measures.values():
            measures.reset()

    def validation_step(self, frame: int, step: int) -> None:
        """Render a held-out frame, without its depth, from the encoder's and from other cameras, and compare."""
        if int(frame) == NO_FRAME:
            return
        latent = self._encode(int(frame))
        for role, measures in self._measures.items():
            measures.update(self._render(latent, int(frame), role), self.truth(int(frame), role))

    def on_validation_epoch_end(self) -> None:
        """Log the figures of the held-out frames, those of all processes together.

        Raises:
            SpoiltWeightsError: the field's colours are not finite.
        """
        found = {role: measures.compute() for role, measures in self._measures.items()}
        for role, pictures in found.items():
            if pictures is None:
                return
            if pictures.figures["psnr_db"] is None:
                raise SpoiltWeightsError(self.global_step, "the field's colours")
            if LABELS in self._dataset.absent:
                pictures = PictureFigures({**pictures.figures, "miou": None}, {}, {})
            if DEPTH in self._dataset.absent:
                pictures = pictures._replace(figures={**pictures.figures, "depth_mae_m": None})
            if role == ENCODER_CAMERAS:
                self.validation, self.class_iou, self.class_share = pictures
            else:
                self.other_cameras[role] = pictures.figures
            folder = "validation" if role == ENCODER_CAMERAS else f"validation_{role}"
            known = {f"{folder}/{name}": value for name, value in pictures.figures.items() if value is not None}
            self.log_dict(known, rank_zero_only=True)
        self.validated_step = self.global_step
        if self.config.stop_when and self._is_fitting:
            self.judged = dict(self.validation)
            if self.is_good_enough():
                self.trainer.should_stop = True

    @property
    def far(self) -> float:
        """Depth of the dataset's far plane [m]."""
        return float(self._dataset.manifest["far"])

    def truth(self, frame: int, role: str = ENCODER_CAMERAS) -> dict[str, np.ndarray]:
        """Return colours in [0, 1], labels and depth of a frame from the cameras of a role."""
        views = self._views[role]
        rgb, depth = (self._dataset.read(name, [frame])[0, views] for name in ("rgb", "depth"))
        semantic = self._dataset.read_labels([frame])[0, views].astype(np.int64)
        return {"rgb": rgb.astype(np.float32) / 255.0, "semantic": semantic, "depth": depth}

    def render_frame(self, frame: int) -> RenderedImages:
        """Encode a frame and render it from the encoder's cameras."""
        return self._render(self._encode(frame), frame, ENCODER_CAMERAS)

    @torch.no_grad()
    def _encode(self, frame: int) -> Float[Tensor, "Z"]:
        images = self._dataset.read("rgb", [frame])[:, self._views[ENCODER_CAMERAS]]
        return self.encoder.encode(torch.from_numpy(images))[0]

    def _render(self, latent: Float[Tensor, "Z"], frame: int, role: str) -> RenderedImages:
        """Render what a latent describes from where the cameras of a role were in a frame, where the field lives."""
        rig, views = self.encoder.rig, self._views[role]
        intrinsics, poses = self._dataset.tracked_cameras([frame])
        size = rig.height, rig.width
        return render_images(self.field, latent, intrinsics[views], poses[0, views], *size, self.config.sampling)
