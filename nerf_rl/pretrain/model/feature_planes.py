"""Feature planes: a point takes what three planes, one for each pair of axes, hold where it is projected to."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F

_REACH = 2.0  # of an object's planes, in root mean square distances of its points from their middle
_LEAST_SIZE = 1e-6  # of an object, in the unit of points


def noise(*shape: int) -> Tensor:
    """Return normal noise of deviation 0.1; none on the meta device, where PyTorch would import its compiler for it."""
    values = torch.empty(*shape)
    return values if values.is_meta else values.normal_().mul_(0.1)


def project(points: Float[Tensor, "*B 3"]) -> Float[Tensor, "3 *B 2"]:
    """Return points in the planes of x and y, x and z, y and z."""
    return torch.stack([points[..., :2], points[..., ::2], points[..., 1:]])


def sample(planes: Float[Tensor, "3 G H W"], places: Float[Tensor, "3 *B 2"]) -> Float[Tensor, "*B F"]:
    """Return what all three planes hold, one after the other, between the middles of their cells.

    Args:
        planes: G features in each cell.
        places: column and row in [-1, 1], from edge to edge.
    """
    flat = places.reshape(3, -1, 1, 2)
    flat = flat.nan_to_num(0.0)  # where a point is nowhere, PyTorch would look it up outside of the planes' memory
    sampled = F.grid_sample(planes, flat, align_corners=False, padding_mode="border")
    return sampled[..., 0].permute(2, 0, 1).reshape(*places.shape[1:-1], -1)


class ObjectPlanes(nn.Module):
    """Three planes for each frame that follows a class, which span a box around its origin and move with it.

    Waves in a moving frame draw soft shapes, for the finest is several pixels long. Planes hold edges, and what moves
    without turning looks the same in them wherever it is. A point is looked up in the smallest box that holds it: a
    gripper is not lost among the arm, and however many things there are, a point costs three lookups.

    Args:
        objects: number of frames that follow a class.
        size: cells along an edge.
        features: in a cell.
    """

    reach: Tensor

    def __init__(self, objects: int, size: int, features: int):
        super().__init__()
        self.objects, self.size = objects, size
        self.planes = nn.Parameter(noise(3, features, size, size * objects))
        """of all objects, side by side"""
        self.register_buffer("reach", torch.ones(objects))

    def place(self, sizes: Float[Tensor, "A"]) -> None:
        """Let the boxes be as large as what is in them.

        Args:
            sizes: root mean square distance of each object's points from their middle, in the unit of points.
        """
        self.reach.copy_(_REACH * sizes.clamp_min(_LEAST_SIZE))

    def forward(self, points: Float[Tensor, "B N 3"], origins: Float[Tensor, "B A 3"]) -> Float[Tensor, "B N F"]:
        """Return what the planes hold at points of B scenes, fading to zero at the faces of the boxes.

        Args:
            points: in any unit; no gradient goes back to them.
            origins: of the frames, in the same; nor to these.
        """
        offsets = (points[:, :, None] - origins.detach()[:, None]) / self.reach[:, None]  # B N A 3
        holds = offsets.abs().amax(-1) < 1.0
        chosen = torch.where(holds, self.reach, torch.inf).argmin(-1)
        local = offsets.gather(2, chosen[..., None, None].expand(*chosen.shape, 1, 3))[:, :, 0]
        window = (1.0 - local.square().amax(-1, keepdim=True)).clamp_min(0.0)
        places = project(local.clamp(-1.0, 1.0))
        # from the middle of a box's first column to that of its last, so that neighbours do not blend
        inside = (1.0 - 1.0 / self.size) * places[..., 0]
        columns = (2.0 * chosen + 1.0 + inside) / self.objects - 1.0
        return window * sample(self.planes, torch.stack([columns, places[..., 1]], dim=-1))
