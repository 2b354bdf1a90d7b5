"""What every pretraining run has, whatever teaches its encoder: the encoder, the clock, schedules, checkpoints."""

import math
import time
from collections.abc import Mapping
from typing import Any

import lightning
import numpy as np
import torch
from lightning.pytorch.trainer.states import TrainerFn
from torch import Tensor

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.anchors import Anchors
from nerf_rl.pretrain.execution.distributed import mean_over_processes, of_first_process
from nerf_rl.pretrain.execution.faults import NotFiniteError, SpoiltWeightsError
from nerf_rl.pretrain.measures.latent_statistics import FRAMES, FRAMES_IN_TRAINING, measure_latents
from nerf_rl.pretrain.model.checkpoint_file import DATASET, ENCODER
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import SIMULATORS
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.schedules import warm_cosine
from nerf_rl.pretrain.stopping import parse_goal

_LONGEST_GRADIENT = 1.0
_START = 0.02  # share of a budget of time in which time does not count: a run begins slowly, whatever it does later
IMPORTED_QUALITY = "full"
"""of rendering, for an encoder of imported pictures: nothing renders them, and real ones leave nothing out"""


class EncoderModule(lightning.LightningModule):
    """Trains an encoder; a subclass says by what, in ``training_step``.

    Args:
        config: of the run.
        dataset: that it is trained on.
        anchors: the classes that move, which the encoder looks for.
        rig: the encoder's cameras.
    """

    def __init__(self, config: PretrainConfig, dataset: MultiViewDataset, anchors: Anchors, rig: EncoderRig):
        super().__init__()
        self.config, self._dataset = config, dataset
        self.encoder = Encoder(config.encoder, rig, len(anchors.classes))
        if self.encoder.landmarks is not None:
            self.encoder.landmarks.place(torch.from_numpy(anchors.mean), torch.from_numpy(anchors.spread))
        self.encoder.scene = dataset.manifest["scene"]["name"]
        self.encoder.quality = dataset.manifest["config"].get("quality", IMPORTED_QUALITY)
        self.encoder.pixels_per_metre = dataset.manifest.get("detail")
        self.encoder.renderer = dataset.manifest.get("renderer", "")
        packages = dataset.manifest.get("packages", {})
        self.encoder.simulators = {name: packages[name] for name in SIMULATORS if name in packages}
        self.validation: dict[str, float | None] = {}
        self.class_iou: dict[str, float | None] = {}
        self.class_share: dict[str, float] = {}
        self.validated_step = -1
        """the step that ``validation``, ``class_iou`` and ``class_share`` (of the pixels) are of"""
        self.judged: dict[str, float | None] = {}
        """figures of the last validation in the course of training, by which it may end"""
        self.other_cameras: dict[str, dict[str, float | None]] = {}
        """what ``validation`` is of the encoder's cameras, of those of other roles"""
        self.last_losses: dict[str, Tensor] = {}
        """of the last step; they stay on the device, so that no step waits to show them"""
        self.seconds = 0.0
        """spent training, over all resumptions [s]"""
        self._clock = time.monotonic()

    def describe_step(self) -> str:
        """Return how the last step went, in words; it may wait for the device."""
        return f"{100 * self.progress():.0f} % of the budget"

    def log_losses(self, named: Mapping[str, Tensor], total: Tensor) -> Tensor:
        """Log every loss of a step by its name, of all processes; return the values in the order of the names."""
        self.last_losses = {name: value.detach() for name, value in named.items()}
        values = mean_over_processes(torch.stack([value.detach() for value in (*named.values(), total)]))
        self.log_dict({f"train/{name}": value for name, value in zip((*named, "total"), values, strict=True)})
        return values

    def step_generator(self) -> torch.Generator:
        """Return the source of what is random in the current step, which is the same in all processes."""
        return torch.Generator(self.device).manual_seed(self.config.seed * 1_000_003 + self.global_step)

    def progress(self) -> float:
        """Return the share of the run that is done: of its steps, or of its time if that is further.

        Schedules follow this, so where steps take less than their share of the time, a seed has one course.
        """
        done = self.global_step / self.config.steps
        if self.config.max_minutes is not None:
            spent = self.seconds / (60.0 * self.config.max_minutes)
            done = max(done, spent if spent > _START else 0.0)
        return min(done, 1.0)

    def is_good_enough(self) -> bool:
        """Tell whether the last validation reached what ``stop_when`` asks for, be it before the run was resumed."""
        goal = self.config.stop_when
        return goal is not None and parse_goal(goal).is_reached(self.judged)

    def seconds_left(self) -> float:
        """Return for how long the run may go on training at most [s]."""
        return math.inf if self.config.max_minutes is None else max(60.0 * self.config.max_minutes - self.seconds, 0.0)

    def learning_rate_factor(self) -> float:
        """Return the learning rate as a share of its peak."""
        return warm_cosine(self.progress())

    def parameter_groups(self) -> list[dict[str, Any]]:
        """Return what the optimiser moves; a group without a rate has the run's."""
        return [{"params": [parameter for parameter in self.parameters() if parameter.requires_grad]}]

    def configure_optimizers(self) -> Any:
        """Return Adam with the schedule of :meth:`learning_rate_factor`."""
        optimiser = torch.optim.Adam(
            self.parameter_groups(), lr=self.config.learning_rate, betas=(0.9, 0.99), fused=True
        )
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda _: self.learning_rate_factor())
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": schedule, "interval": "step"}}

    def configure_gradient_clipping(
        self,
        optimizer: torch.optim.Optimizer,
        gradient_clip_val: int | float | None = None,
        gradient_clip_algorithm: str | None = None,
    ) -> None:
        """Shorten gradients longer than one; refuse a step whose gradient is not finite, before it spoils the weights.

        Lightning's own clipping refuses a fused optimiser in mixed precision, because such an optimiser undoes the
        scaling of a float16 loss only after it. Losses in bfloat16 are not scaled, so there is nothing to undo.
        """
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        norm = torch.nn.utils.clip_grad_norm_(parameters, _LONGEST_GRADIENT)
        if not torch.isfinite(norm):
            raise NotFiniteError(self.global_step, {name: float(value) for name, value in self.last_losses.items()})

    def on_train_batch_start(self, batch: Any, step: int) -> int | None:
        """Count the time; end the run when the budget is spent, or where a resumed one had been good enough."""
        self._count_time()
        if self.progress() >= 1.0 or self.is_good_enough():
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

    def on_validation_start(self) -> None:
        """Stop the clock: what a budget of time is for is training."""
        if self._is_fitting:
            self._count_time()

    def on_validation_end(self) -> None:
        """Let the clock go on."""
        self._clock = time.monotonic()

    @property
    def _is_fitting(self) -> bool:
        return self.trainer.state.fn == TrainerFn.FITTING and not self.trainer.sanity_checking

    @property
    def absent(self) -> tuple[str, ...]:
        """What of ``depth``, ``labels`` and ``state`` the dataset lacks."""
        return self._dataset.absent

    @property
    def palette(self) -> np.ndarray:
        """Colours of the semantic classes, u8 [C, 3]."""
        return self._dataset.palette

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Keep what schedule and end may depend on, what was learnt from, and what makes the encoder usable by itself.

        Those are the time spent and the last validation; the dataset's digest; the encoder's description, and the
        statistics of its latents, which belong to these very weights.

        Raises:
            SpoiltWeightsError: the latents are not finite.
        """
        checkpoint["seconds"], checkpoint["validation"] = self.seconds, self.judged
        checkpoint[DATASET] = self._dataset.digest()
        classes = {"classes": list(self._dataset.class_names), "palette": self.palette.tolist()}
        checkpoint[ENCODER] = {**self.encoder.describe(), **classes}
        frames = FRAMES if self.progress() >= 1.0 else FRAMES_IN_TRAINING
        mean, deviation = measure_latents(self.encoder, self._dataset, frames)
        if not (mean + deviation).isfinite().all():
            raise SpoiltWeightsError(self.global_step, "the encoder's latents")
        checkpoint["state_dict"] |= {"encoder.latent_mean": mean, "encoder.latent_std": deviation}

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Restore the time spent and the last validation."""
        self.seconds, self.judged = checkpoint["seconds"], checkpoint.get("validation", {})
