"""Where the frames of a radiance field are, as a linear function of z."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional as F


class FrameOrigins(nn.Linear):
    """Origins that are linear in z, each frame's in a unit of its own.

    Adam moves every weight by about the learning rate, whatever the size of its gradient. In one unit for all, such a
    step can move a frame by some millimetres: little of an arm's way, but more than all of a nail's. In units of how
    far each thing moves, a step is the same share of every way.

    Args:
        latent: size of z.
        frames: number of frames.
    """

    units: Tensor

    def __init__(self, latent: int, frames: int):
        super().__init__(latent, 3 * frames)
        self.register_buffer("units", torch.ones(frames))

    def forward(self, latent: Float[Tensor, "B Z"]) -> Float[Tensor, "B F 3"]:
        """Return the origins."""
        weight = self.weight * self.units.repeat_interleave(3)[:, None]
        return F.linear(latent, weight, self.bias).reshape(len(latent), -1, 3)

    def place(self, places: Float[Tensor, "A 3"], units: Float[Tensor, "A"]) -> None:
        """Let the first frames start at some places, and move in some units from there."""
        with torch.no_grad():
            self.bias[: places.numel()] = places.flatten()
            self.units[: len(units)] = units
