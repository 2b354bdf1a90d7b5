"""The LightningModule that trains an encoder by an objective on its own pictures."""

from torch import Tensor

from nerf_rl.datasets.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.encoder_module import EncoderModule
from nerf_rl.pretrain.encoder_rig import EncoderRig
from nerf_rl.pretrain.objectives import OBJECTIVES
from nerf_rl.pretrain.view_batches import ViewBatch, standardised_state


class PictureModule(EncoderModule):
    """Trains z by an objective of :mod:`nerf_rl.pretrain.objectives`; the probe alone measures what came out.

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
