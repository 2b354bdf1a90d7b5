"""The latent-conditioned radiance field."""

import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional as F

from nerf_rl.files.json_files import write_json
from nerf_rl.files.tensor_files import filled, read_tensors, write_tensors
from nerf_rl.pretrain.config import FieldConfig
from nerf_rl.pretrain.model.feature_planes import ObjectPlanes, noise, project, sample
from nerf_rl.pretrain.model.field_description import DESCRIPTION, FORMAT, WEIGHTS, read_field_description
from nerf_rl.pretrain.model.frame_origins import FrameOrigins
from nerf_rl.pretrain.model.precision import in_full_precision

_COARSE_OCTAVES = 2  # that moving frames always see
_DENSITY_SCALE = 10.0  # so that the network's outputs of order one are both empty and solid, at the scene's scale


@dataclass(frozen=True)
class FieldBounds:
    """Where the field lives: sampled depths, the box of all that is seen, and the one that is mapped to the unit cube.

    The boxes stand in the world, or in the tracking frame of a dataset whose encoder's cameras follow a body
    (:mod:`nerf_rl.cameras.tracking_frame`); there they travel with the body.
    """

    near: float
    """nearest planar depth [m]"""
    far: float
    """planar depth of the backdrop [m]"""
    centre: tuple[float, float, float]
    """of the box that is mapped to the unit cube [m]"""
    half_extent: float
    """of that box [m]"""
    low: tuple[float, float, float] | None = None
    """corner of the box outside of which nothing is evaluated [m]; none if there is no such box"""
    high: tuple[float, float, float] | None = None
    """its opposite corner [m]"""

    def corners(self) -> Float[Tensor, "2 3"]:
        """Return the low and the high corner [m], infinitely far away if there is no such box."""
        return torch.tensor([self.low or (-math.inf,) * 3, self.high or (math.inf,) * 3])


class Folded(NamedTuple):
    """The layers of a field as B latents have them."""

    weight: Float[Tensor, "B E W"]
    """of the first layer, for a point's encoding"""
    shifts: list[Float[Tensor, "#B 1 W"]]
    """what each layer adds"""
    origins: Float[Tensor, "B A 3"]
    """of the frames that follow classes, in the box"""


class RadianceField(nn.Module):
    """Density and features at a point of the scene that a latent describes.

    Most of a scene never changes, so three static feature planes hold what is common to all scenes (table, walls). What
    does change mostly moves as a whole, so points are also encoded relative to frames whose origins are linear in z: a
    drawer that slides is then one shape in a moving frame, and its position is easy to read from z. The first frames
    each follow a class that moves (:mod:`nerf_rl.pretrain.data.anchors`), the others find something to follow. The
    network sees all of that, what feature planes that go with those first frames hold, and z itself. Colours, class
    logits and teacher features are linear in the features, so they are read once a ray, after compositing, which equals
    compositing them sample by sample.

    Frames cost next to nothing. As sin(a (x - o)) = sin(a x) cos(a o) - cos(a x) sin(a o), and likewise for cos, the
    first layer is linear in [x, sin(a x), cos(a x)] for all frames together, so for each latent the frames' weights are
    folded into one matrix, and a point is encoded once.

    While training looks for the origins, :meth:`set_coarse_to_fine` holds back the fine octaves in moving frames: with
    them, an origin that is off by more than half a wavelength has no slope towards the right one.

    Args:
        config: sizes.
        bounds: of the scene.
        latent: size of z.
        classes: number of semantic classes.
        teacher_features: number of teacher features, 0 for none.
        anchors: number of frames that follow a class; ``config.free_frames`` others come on top.
    """

    octaves: Tensor
    octave_weights: Tensor
    centre: Tensor
    corners: Tensor

    def __init__(
        self,
        config: FieldConfig,
        bounds: FieldBounds,
        latent: int,
        classes: int,
        teacher_features: int,
        anchors: int = 0,
    ):
        super().__init__()
        self.config, self.bounds = config, bounds
        self.sizes = {"latent": latent, "classes": classes, "teacher_features": teacher_features, "anchors": anchors}
        self.frames = anchors + config.free_frames
        self.planes = nn.Parameter(noise(3, config.plane_features, config.plane_size, config.plane_size))
        self.frame_origins = FrameOrigins(latent, self.frames) if self.frames else None
        self.object_planes: ObjectPlanes | None = None
        if anchors and config.object_plane_size:
            self.object_planes = ObjectPlanes(anchors, config.object_plane_size, config.plane_features)
        planes = 3 if self.object_planes is None else 6
        encoded = (1 + self.frames) * (3 + 6 * config.frequencies) + planes * config.plane_features
        widths = [encoded] + [config.width] * config.layers
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        # z enters at the first and at the last hidden layer
        self.latent_layers = nn.ModuleDict(
            {str(i): nn.Linear(latent, config.width, bias=False) for i in {0, config.layers - 1}}
        )
        self.density_head = nn.Linear(config.width, 1)
        self.rgb_head = nn.Linear(config.width, 3)
        self.semantic_head = nn.Linear(config.width, classes)
        self.feature_head = nn.Linear(config.width, teacher_features) if teacher_features else None
        self.register_buffer(
            "octaves", torch.tensor([math.pi * 2.0**k for k in range(config.frequencies)]), persistent=False
        )
        # in moving frames; stored, since what was learnt goes with them
        self.register_buffer("octave_weights", torch.ones(config.frequencies))
        self.register_buffer("centre", torch.tensor(bounds.centre), persistent=False)
        self.register_buffer("corners", bounds.corners(), persistent=False)

    def set_coarse_to_fine(self, share: float) -> None:
        """Let moving frames see their coarsest octaves (``share`` 0), all of them (1), or something between.

        Octave k has the weight (1 - cos(pi clamp(a - k, 0, 1))) / 2 with a growing from the number of coarse octaves to
        that of all, as in BARF (Lin et al. 2021), which aligns cameras in this way. A new field sees all.
        """
        open_octaves = _COARSE_OCTAVES + share * (self.config.frequencies - _COARSE_OCTAVES)
        part = (open_octaves - torch.arange(self.config.frequencies, device=self.octaves.device)).clamp(0.0, 1.0)
        self.octave_weights.copy_(0.5 - 0.5 * torch.cos(torch.pi * part))

    def forward(
        self, points: Float[Tensor, "B N 3"], latent: Float[Tensor, "B Z"]
    ) -> tuple[Float[Tensor, "B N"], Float[Tensor, "B N W"]]:
        """Return density [1/m] and features at world points [m] of B scenes with N points each."""
        return self.evaluate(points, self.fold(latent))

    def ray_limits(
        self, origins: Float[Tensor, "*B 3"], directions: Float[Tensor, "*B 3"]
    ) -> tuple[Float[Tensor, "*B"], Float[Tensor, "*B"]]:
        """Return between which planar depths [m] rays are evaluated: within near, far and the box of all that is seen.

        Those that miss the box have both at ``far``: they see the backdrop alone. The intersection is that of slabs
        (Kay and Kajiya 1986).
        """
        slope = torch.where(directions == 0.0, 1e-12, directions)
        first, second = (self.corners[:, None] - origins.reshape(-1, 3)) / slope.reshape(-1, 3)
        shape, (near, far) = origins.shape[:-1], (self.bounds.near, self.bounds.far)
        entry = torch.minimum(first, second).amax(-1).clamp(min=near).reshape(shape)
        leave = torch.maximum(first, second).amin(-1).clamp(max=far).reshape(shape)
        hit = entry < leave
        return torch.where(hit, entry, far), torch.where(hit, leave, far)

    def in_box(self, points: Float[Tensor, "*B 3"]) -> Bool[Tensor, "*B"]:
        """Return which world points [m] are in the box of all that is seen; all, if there is no such box."""
        return ((points >= self.corners[0]) & (points <= self.corners[1])).all(-1)

    def origins(self, latent: Float[Tensor, "B Z"]) -> Float[Tensor, "B F 3"]:
        """Return where in the world the frames are [m]."""
        return self.centre + self.bounds.half_extent * self._origins_in_box(latent)

    def place_anchors(
        self, middles: Float[Tensor, "A 3"], spread: Float[Tensor, "A"], sizes: Float[Tensor, "A"]
    ) -> None:
        """Let the first frames start where the classes that they follow are on average.

        Args:
            middles: those places in the world [m].
            spread: how far the classes move from there [m].
            sizes: root mean square distance of their points from their middles [m].
        """
        extent = self.bounds.half_extent
        if self.frame_origins is not None:
            self.frame_origins.place((middles.to(self.centre) - self.centre) / extent, spread.to(self.centre) / extent)
        if self.object_planes is not None:
            self.object_planes.place(sizes.to(self.centre) / extent)

    def fold(self, latent: Float[Tensor, "B Z"]) -> Folded:
        """Return the layers as latents have them, for any number of points."""
        first: nn.Linear = self.layers[0]  # type: ignore[assignment]
        waves, block = 3 * self.config.frequencies, 3 + 6 * self.config.frequencies
        with in_full_precision(latent.device):
            shifts = [layer.bias.expand(1, 1, -1) for layer in self.layers]  # type: ignore[operator]
            for name, added in self.latent_layers.items():
                shifts[int(name)] = shifts[int(name)] + added(latent)[:, None]
            weight = first.weight.T
            folded = weight[:block].expand(len(latent), -1, -1)
            origins = self._origins_in_box(latent)
            if self.frames:
                phases = (self.octaves[:, None] * origins[:, :, None]).flatten(2)  # B F 3L
                linear, sine, cosine = (
                    weight[block : (1 + self.frames) * block]
                    .reshape(self.frames, block, -1)
                    .split((3, waves, waves), dim=1)
                )
                seen = self.octave_weights.repeat_interleave(3)
                c, s = seen * phases.cos(), seen * phases.sin()
                moved = [
                    linear.sum(0).expand(len(latent), -1, -1),
                    torch.einsum("bfe,few->bew", c, sine) + torch.einsum("bfe,few->bew", s, cosine),
                    torch.einsum("bfe,few->bew", c, cosine) - torch.einsum("bfe,few->bew", s, sine),
                ]
                folded = folded + torch.cat(moved, dim=1)
                shifts[0] = shifts[0] - torch.einsum("bfd,fdw->bw", origins, linear)[:, None]
            return Folded(folded, shifts, origins[:, : self.sizes["anchors"]])

    def evaluate(
        self, points: Float[Tensor, "B N 3"], folded: Folded
    ) -> tuple[Float[Tensor, "B N"], Float[Tensor, "B N W"]]:
        """Return density [1/m] and features at world points [m] of the scenes whose latents were folded."""
        x = contract((points - self.centre) / self.bounds.half_extent)
        # apart from the static features, since no gradient goes back to where a point is
        hidden = torch.bmm(torch.cat([x, *self._waves(x)], dim=-1), folded.weight)
        looked_up = self.static_features(x)
        if self.object_planes is not None:
            looked_up = torch.cat([looked_up, self.object_planes(x, folded.origins)], dim=-1)
        hidden = hidden + F.linear(looked_up, self.layers[0].weight[:, -looked_up.shape[-1] :])  # type: ignore[index]
        for layer, shift in zip([None, *self.layers[1:]], folded.shifts, strict=True):
            hidden = hidden if layer is None else F.linear(hidden, layer.weight)
            hidden = F.relu_(hidden + shift.to(hidden.dtype))
        return self.density_scale * F.softplus(self.density_head(hidden)[..., 0].float()), hidden

    @property
    def density_scale(self) -> float:
        """Density [1/m] of an activation of one."""
        return _DENSITY_SCALE / self.bounds.half_extent

    def read(self, features: Float[Tensor, "*B W"]) -> dict[str, Tensor]:
        """Return ``rgb`` [3], ``semantic`` logits [C] and, with teachers, ``feature`` [F] of composited features."""
        values = {"rgb": self.rgb_head(features), "semantic": self.semantic_head(features)}
        if self.feature_head is not None:
            values["feature"] = self.feature_head(features)
        return values

    def _origins_in_box(self, latent: Float[Tensor, "B Z"]) -> Float[Tensor, "B F 3"]:
        if self.frame_origins is None:
            return latent.new_zeros(len(latent), 0, 3)
        return self.frame_origins(latent)

    def _waves(self, x: Float[Tensor, "B N 3"]) -> list[Float[Tensor, "B N 3"]]:
        """Return the sines of all octaves, then their cosines, by the double-angle formulas."""
        sines, cosines = [torch.sin(torch.pi * x)], [torch.cos(torch.pi * x)]
        for _ in range(1, self.config.frequencies):
            sine, cosine = sines[-1], cosines[-1]
            sines.append(2.0 * sine * cosine)
            cosines.append(1.0 - 2.0 * sine.square())
        return [*sines, *cosines][: 2 * self.config.frequencies]

    def static_features(self, x: Float[Tensor, "B N 3"]) -> Float[Tensor, "B N G"]:
        """Return what the static feature planes hold at contracted points."""
        return sample(self.planes, project(x) / 2.0)

    def save(self, folder: Path) -> None:
        """Write ``field.safetensors`` and ``field.json``."""
        write_tensors(folder / WEIGHTS, self.state_dict())
        description = {"format": FORMAT, "config": asdict(self.config), "bounds": asdict(self.bounds), **self.sizes}
        write_json(folder / DESCRIPTION, description)

    @classmethod
    def load(cls, folder: Path) -> "RadianceField":
        """Read a field that :meth:`save` wrote.

        Raises:
            MissingFileError: there is none, it is damaged, or of another format.
        """
        described = read_field_description(folder)
        config = FieldConfig(**{"object_plane_size": 0, **described["config"]})  # none before they were there
        bounds = FieldBounds(**{name: _as_tuple(value) for name, value in described["bounds"].items()})
        sizes = {name: described[name] for name in ("latent", "classes", "teacher_features", "anchors")}
        tensors = read_tensors(folder / WEIGHTS)
        if frames := described["anchors"] + config.free_frames:
            tensors.setdefault("frame_origins.units", torch.ones(frames))  # one for all, before there were more
        return filled(lambda: cls(config, bounds, **sizes), tensors, folder / WEIGHTS).eval()


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def contract(x: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """Map space into a cube of half extent 2 and leave the unit cube as it is.

    This is mip-NeRF 360's equation 10 with the largest coordinate as the norm.
    """
    norm = x.abs().amax(dim=-1, keepdim=True).clamp_min(1.0)
    return x * (2.0 - 1.0 / norm) / norm
