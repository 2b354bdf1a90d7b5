"""Where the classes are that move: found in each picture by segmenting it, and in space by triangulating that."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

from nerf_rl.pretrain.model.precision import in_full_precision

READ_MAPS = 2
"""of the encoder's feature maps, from the finest on: a thing is to be known by its look, not by what is usually near"""
_WIDTH = 32  # channels of the head
_PRIOR_ERROR = 0.003  # of a picture's width: as much as a class's usual place is held to be wrong by its spread
_LEAST_CONFIDENCE = 1e-3
_NEAREST = 1e-3  # depth of a usual place, for cameras that have it beside or behind them [m]


class FoundLandmarks(NamedTuple):
    """What B scenes of V views each show of A classes."""

    logits: Float[Tensor, "BV C h w"]
    """of what a cell of a picture shows: nothing that is looked for, or each of the classes; C is A + 1"""
    places: Float[Tensor, "B A 3"]
    """of their middles, from where they usually are and in units of how far each moves"""
    confidence: Float[Tensor, "B A"]
    """from 0, seen by no camera, to 1, surely by all"""


class Landmarks(nn.Module):
    """Segments what each camera sees, and triangulates the middle of each class that moves.

    The layers that turn whole pictures into z know a thing where training has shown it, and nowhere else: a ball that
    was kicked to another end of the table is taken to be where balls usually are. Convolutions find it anywhere in a
    picture, and camera matrices tell where that is. What the head learns from is the labels of a dataset.

    Args:
        channels: of the feature maps, finest first; the first :data:`READ_MAPS` are read.
        classes: A.
        latent: size of z.
    """

    usual_places: Tensor
    spread: Tensor

    def __init__(self, channels: list[int], classes: int, latent: int):
        super().__init__()
        self.laterals = nn.ModuleList(nn.Conv2d(width, _WIDTH, 1) for width in channels[:READ_MAPS])
        self.head = nn.Sequential(
            nn.ReLU(), nn.Conv2d(_WIDTH, _WIDTH, 3, padding=1), nn.ReLU(), nn.Conv2d(_WIDTH, classes + 1, 1)
        )
        self.to_latent = nn.Linear(4 * classes, latent, bias=False)
        self.register_buffer("usual_places", torch.zeros(classes, 3))
        self.register_buffer("spread", torch.ones(classes))

    def place(self, middles: Float[Tensor, "A 3"], spread: Float[Tensor, "A"]) -> None:
        """Set where the classes are on average [m], and how far they move from there [m]."""
        self.usual_places.copy_(middles)
        self.spread.copy_(spread)

    def forward(self, maps: list[Float[Tensor, "BV _ _ _"]], projections: Float[Tensor, "B V 3 4"]) -> FoundLandmarks:
        """Find the classes.

        Args:
            maps: the finest feature maps of all views.
            projections: of the views, from positions [m] to parts of a picture's width and height, 0 to 1.
        """
        finest = maps[0].shape[-2:]
        features = self.laterals[0](maps[0])
        for lateral, coarser in zip(self.laterals[1:], maps[1:], strict=True):
            features = features + F.interpolate(lateral(coarser), finest, mode="bilinear", align_corners=False)
        logits = self.head(features)
        with in_full_precision(logits.device):
            logits = logits.to(projections.dtype)
            middles, confidence = picture_middles(logits.softmax(1)[:, 1:])
            views = projections.shape[:2]
            seen = confidence.reshape(*views, -1)
            places = triangulate(
                middles.reshape(*views, -1, 2), seen, projections, self.usual_places, self.spread.clamp_min(1e-9)
            )
            return FoundLandmarks(logits, places, seen.mean(1))

    def latent(self, found: FoundLandmarks) -> Float[Tensor, "B Z"]:
        """Return what z is told of the landmarks."""
        return self.to_latent(torch.cat([found.places.flatten(1), found.confidence], dim=1))


def picture_middles(
    masks: Float[Tensor, "N A h w"],
) -> tuple[Float[Tensor, "N A 2"], Float[Tensor, "N A"]]:
    """Return the middles of soft masks in parts of width and height, and how sure each is, from nearly 0 to 1.

    Masks are squared, so that a little everywhere counts less than much in one place.
    """
    height, width = masks.shape[-2:]
    squared = masks**2
    mass = squared.flatten(2).sum(-1)
    columns = (torch.arange(width, device=masks.device, dtype=masks.dtype) + 0.5) / width
    rows = (torch.arange(height, device=masks.device, dtype=masks.dtype) + 0.5) / height
    sums = torch.stack([(squared.sum(2) * columns).sum(-1), (squared.sum(3) * rows).sum(-1)], dim=-1)
    middles = (sums + 0.5 * _LEAST_CONFIDENCE) / (mass + _LEAST_CONFIDENCE)[..., None]
    return middles, (mass**2).clamp(_LEAST_CONFIDENCE, 1.0)


def triangulate(
    middles: Float[Tensor, "B V A 2"],
    confidence: Float[Tensor, "B V A"],
    projections: Float[Tensor, "B V 3 4"],
    usual_places: Float[Tensor, "A 3"],
    spread: Float[Tensor, "A"],
) -> Float[Tensor, "B A 3"]:
    """Return the places that views agree on best, from the usual ones and in units of the spread.

    Least squares of the linear equations of triangulation (Hartley and Zisserman, "Multiple View Geometry", 12.2), each
    weighted by a view's confidence and divided by the depth of the usual place, so that errors are about those in the
    picture; what no view tells is left to the usual place.

    Args:
        middles: in parts of a picture's width and height.
        confidence: of each.
        projections: of the views, in the same units and metres.
        usual_places: [m].
        spread: of them [m].
    """
    matrix, offset = projections[..., :3], projections[..., 3]
    homogeneous = torch.einsum("bvij,aj->bvai", matrix, usual_places) + offset[:, :, None]  # B V A 3
    depth = homogeneous[..., 2].clamp_min(_NEAREST)[..., None]
    # u = (P0 X) / (P2 X) as (u P2 - P0) X = 0, around the usual place
    rows = (middles[..., None] * matrix[:, :, None, 2:] - matrix[:, :, None, :2]) / depth[..., None]  # B V A 2 3
    errors = (homogeneous[..., :2] - middles * homogeneous[..., 2:]) / depth  # B V A 2
    rows = rows * spread[:, None, None]
    weighted = rows * confidence[..., None, None]
    normal = torch.einsum("bvaki,bvakj->baij", weighted, rows)
    prior = _PRIOR_ERROR**2 * torch.eye(3, device=rows.device, dtype=rows.dtype)
    right = torch.einsum("bvaki,bvak->bai", weighted, errors)
    return torch.linalg.solve_ex(normal + prior, right[..., None]).result[..., 0]  # never singular, so not checked
