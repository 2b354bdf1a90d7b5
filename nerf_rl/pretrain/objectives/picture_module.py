"""The LightningModule that trains an encoder by an objective on its own pictures."""

from torch import Tensor

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.learnable import require_targets
from nerf_rl.pretrain.data.statistics import Statistics
from nerf_rl.pretrain.data.view_batches import ViewBatch, standardised_state
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.objectives.encoder_module import EncoderModule
from nerf_rl.pretrain.objectives.losses import SEGMENTATION
from nerf_rl.pretrain.objectives.picture_objectives import OBJECTIVES


class PictureModule(EncoderModule):
    """Trains z by one of :data:`~nerf_rl.pretrain.objectives.picture_objectives.OBJECTIVES`; the probe measures it.

    Args:
        config: of the run, with the name of the objective.
        dataset: that it is trained on.
        statistics: of the dataset.
        rig: the encoder's cameras.

    Raises:
        UserError: the objective learns where classes are that move, or what varies of the true state, and none does.
    """

    def __init__(self, config: PretrainConfig, dataset: MultiViewDataset, statistics: Statistics, rig: EncoderRig):
        super().__init__(config, dataset, statistics.anchors, rig)
        require_targets(dataset, config, statistics.anchors)
        columns, *_ = standardised_state(dataset)
        classes = len(statistics.anchors.classes)
        self._weights = {SEGMENTATION: config.losses.segmentation}  # the others are what an objective is
        self.objective = OBJECTIVES[config.objective](self.encoder, len(columns), classes)

    def training_step(self, batch: ViewBatch, step: int) -> Tensor:
        """Return the loss of a step, of this process's share of its scenes; log every loss by its name, of all."""
        named = self.objective(self.encoder, batch, self.step_generator())
        weighted = (self._weights.get(name, 1.0) * value for name, value in named.items())
        total = sum(weighted, start=batch.depth.new_zeros(()))
        self.log_losses(named, total)
        return total
