"""The LightningModule that trains an encoder by an objective on its own pictures."""

from torch import Tensor

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.view_batches import ViewBatch, standardised_state
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.objectives.encoder_module import EncoderModule
from nerf_rl.pretrain.objectives.picture_objectives import OBJECTIVES


class PictureModule(EncoderModule):
    """Trains z by one of :data:`~nerf_rl.pretrain.objectives.picture_objectives.OBJECTIVES`; the probe measures it.

    Args:
        config: of the run, with the name of the objective.
        dataset: that it is trained on.
        rig: the encoder's cameras.
    """

    def __init__(self, config: PretrainConfig, dataset: MultiViewDataset, rig: EncoderRig):
        super().__init__(config, dataset, rig)
        columns, *_ = standardised_state(dataset)
        self.objective = OBJECTIVES[config.objective](self.encoder, len(columns))

    def training_step(self, batch: ViewBatch, step: int) -> Tensor:
        """Return the loss of a step, of this process's share of its scenes; log every loss by its name, of all."""
        named = self.objective(self.encoder, batch, self.step_generator())
        total = sum(named.values(), start=batch.depth.new_zeros(()))
        self.log_losses(named, total)
        return total
