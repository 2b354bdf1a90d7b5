"""The losses of pretraining, as one dictionary of named scalars: L = sum of weight x loss (SNeRL, equation 6)."""

from dataclasses import asdict

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional as F

from nerf_rl.pretrain.config import LossConfig
from nerf_rl.pretrain.data.batches import RayBatch
from nerf_rl.pretrain.model.ray_rendering import RenderedRays

SEGMENTATION = "segmentation"
"""the loss by which an encoder finds landmarks"""
_BETA = 0.1  # of the anchors' Huber loss: errors above a tenth of the spread count by their size, not its square


def losses(
    rendered: RenderedRays,
    batch: RayBatch,
    origins: Float[Tensor, "B A 3"],
    spread: Float[Tensor, "A"],
    unit: float = 1.0,
) -> dict[str, Tensor]:
    """Return each loss, unweighted.

    ``rgb``: mean squared error of colours. ``semantic``: cross-entropy of class labels. ``feature``: mean squared
    error of the teachers' features. ``depth``: mean distance of a ray's weight from its known surface, in units,
    ``sum_i w_i |t_i - depth| / unit``, which bounds the error of the expected depth from above and is only zero if all
    weight lies on the surface. ``anchor``: Huber loss between the frames that follow classes and the visible middles of
    those, in units of how far each class moves, so that what moves little counts as much; what is hidden counts as
    right.
    ``segmentation`` is of the encoder's pictures, not of rays (:func:`segmentation_loss`).

    Args:
        rendered: rays of the batch.
        batch: what they should show.
        origins: of the frames that follow classes [m].
        spread: how far those classes move [m].
        unit: of distances from surfaces [m].
    """
    values = rendered.values
    named = {
        "rgb": F.mse_loss(values["rgb"].float(), batch.rgb),
        "semantic": F.cross_entropy(values["semantic"].float().flatten(0, 1), batch.semantic.flatten()),
        "depth": (rendered.weights * (rendered.depths - batch.depth[..., None]).abs()).sum(-1).mean() / unit,
    }
    if "feature" in values:
        named["feature"] = F.mse_loss(values["feature"].float(), batch.feature)
    if len(spread):
        named["anchor"] = anchor_loss((origins - batch.middles) / spread[:, None], batch.seen)
    return named


def anchor_loss(errors: Float[Tensor, "B A 3"], seen: Bool[Tensor, "B A"]) -> Tensor:
    """Return the Huber loss of where classes are taken to be.

    Args:
        errors: in units of how far each class moves.
        seen: whether it is known where they are; what is hidden counts as right.
    """
    each = F.smooth_l1_loss(errors, torch.zeros_like(errors), reduction="none", beta=_BETA)
    return (each.sum(-1) * seen).mean()


def segmentation_loss(logits: Float[Tensor, "BV C h w"], shares: Float[Tensor, "B V C h w"]) -> Tensor:
    """Return the cross-entropy of what the cells of pictures show.

    Args:
        logits: of each cell.
        shares: of each cell, that show each class, with the classes' weights.
    """
    return -(shares.flatten(0, 1) * logits.log_softmax(1)).sum(1).mean()


def weighted_sum(named: dict[str, Tensor], weights: LossConfig) -> Tensor:
    """Return the scalar to minimise."""
    weight = asdict(weights)
    return torch.stack([weight[name] * value for name, value in named.items()]).sum()
