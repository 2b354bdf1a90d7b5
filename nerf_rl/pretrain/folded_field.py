"""A radiance field for one latent, with all that the latent decides folded into its first layer."""

from typing import cast

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from nerf_rl.pretrain.field import RadianceField


class FoldedField:
    """What a field computes for one latent, several times faster, for rendering many images of one scene.

    Inside the unit cube of the field's box, a moving frame sees x - o with a fixed origin o. As
    sin(a (x - o)) = sin(a x) cos(a o) - cos(a x) sin(a o), and likewise for cos, the first layer is linear in
    [x, sin(a x), cos(a x)] for all frames together, so their weights add up. Octaves follow from the first one by the
    double-angle formulas. Points outside, which space contraction bends, are left to the field itself.

    Args:
        field: a trained one.
        latent: not standardised.
    """

    @torch.inference_mode()
    def __init__(self, field: RadianceField, latent: Float[Tensor, "Z"]):
        self.field, self.latent = field, latent[None]
        self._layers = [cast(nn.Linear, layer) for layer in field.layers]
        count, first = field.config.frequencies, self._layers[0]
        waves = 3 * count
        block = 3 + 2 * waves
        weight = first.weight
        bias = first.bias + self._added(0)
        total = weight[:, :block].clone()
        low, high = -torch.ones(3, device=latent.device), torch.ones(3, device=latent.device)
        if field.frame_origins is not None:
            origins = field.frame_origins(self.latent).reshape(-1, 3)
            # frames clamp what is farther than 2 from their origin
            low, high = torch.maximum(low, origins.amax(0) - 2.0), torch.minimum(high, origins.amin(0) + 2.0)
            octave_weights = field.octave_weights.repeat(3)
            for i, origin in enumerate(origins):
                part = weight[:, (i + 1) * block : (i + 2) * block]
                phase = (origin[:, None] * field.octaves).flatten()
                sine, cosine = part[:, 3 : 3 + waves] * octave_weights, part[:, 3 + waves :] * octave_weights
                total[:, :3] += part[:, :3]
                total[:, 3 : 3 + waves] += sine * phase.cos() + cosine * phase.sin()
                total[:, 3 + waves :] += cosine * phase.cos() - sine * phase.sin()
                bias = bias - part[:, :3] @ origin
        by_octave = torch.arange(waves, device=latent.device).reshape(3, count).T.flatten()
        columns = torch.stack([3 + by_octave.reshape(count, 3), 3 + waves + by_octave.reshape(count, 3)], dim=1)
        planes = weight[:, -3 * field.config.plane_features :]
        self._weight = torch.cat([total[:, :3], total[:, columns.flatten()], planes], dim=1).contiguous()
        self._bias, self._low, self._high = bias, low, high

    @torch.inference_mode()
    def __call__(self, points: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N"], Float[Tensor, "N W"]]:
        """Return density [1/m] and features at world points [m]."""
        x = (points - self.field.centre) / self.field.bounds.half_extent
        inside = self.is_inside(x)
        if bool(inside.all()):
            return self.inside(x)
        density = points.new_empty(len(points))
        features = points.new_empty(len(points), self.field.config.width)
        if bool(inside.any()):
            density[inside], features[inside] = self.inside(x[inside])
        far_density, far_features = self.field(points[~inside][None], self.latent)
        density[~inside], features[~inside] = far_density[0], far_features[0]
        return density, features

    def is_inside(self, x: Float[Tensor, "N 3"]) -> Bool[Tensor, "N"]:
        """Tell which points, in half extents from the box's centre, are where nothing is contracted or clamped."""
        return ((x >= self._low) & (x <= self._high)).all(-1)

    @torch.inference_mode()
    def inside(self, x: Float[Tensor, "N 3"]) -> tuple[Float[Tensor, "N"], Float[Tensor, "N W"]]:
        """Return density [1/m] and features at such points."""
        sine, cosine = torch.sin(torch.pi * x), torch.cos(torch.pi * x)
        encoded = [x]
        for _ in range(self.field.config.frequencies):
            encoded += [sine, cosine]
            sine, cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine.square()
        encoded.append(self.field.static_features(x[None])[0])
        hidden = F.relu_(F.linear(torch.cat(encoded, dim=-1), self._weight, self._bias))
        for i, layer in enumerate(self._layers[1:], start=1):
            hidden = F.relu_(F.linear(hidden, layer.weight, layer.bias + self._added(i)))
        density = F.softplus(self.field.density_head(hidden)[:, 0])
        return self.field.density_scale * density, hidden

    def _added(self, layer: int) -> Tensor:
        """Return what the latent adds to a layer's bias."""
        name = str(layer)
        if name not in self.field.latent_layers:
            return torch.zeros(1, device=self.latent.device)
        return self.field.latent_layers[name](self.latent)[0]
