"""A radiance field for one latent, for rendering many images of one scene."""

import torch
from jaxtyping import Float
from torch import Tensor

from nerf_rl.pretrain.model.field import RadianceField


class ConditionedField:
    """What a field computes for one latent, which is folded into its layers once.

    Args:
        field: a trained one.
        latent: not standardised.
    """

    @torch.inference_mode()
    def __init__(self, field: RadianceField, latent: Float[Tensor, "Z"]):
        self.field, self.latent = field, latent[None]
        self._folded = field.fold(self.latent)

    @torch.inference_mode()
    def __call__(self, points: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N"], Float[Tensor, "N W"]]:
        """Return density [1/m] and features at world points [m]; density is zero where no ray of training came.

        That is outside of the box of all that is seen, where the network was told nothing.
        """
        density, features = self.field.evaluate(points[None], self._folded)
        return density[0] * self.field.in_box(points), features[0]
