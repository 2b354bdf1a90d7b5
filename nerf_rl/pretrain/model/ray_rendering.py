"""Rendering a radiance field: with depth known (training) and without (everything else)."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor

from nerf_rl.cameras.geometry import camera_position, pixel_centres, pixel_directions
from nerf_rl.pretrain.config import SamplingConfig
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.volume_rendering import (
    composite,
    even_samples,
    free_space_samples,
    importance_samples,
    median_depth,
    rendering_weights,
    sample_spacings,
    stratified_samples,
    surface_samples,
    widened_weights,
)

_POINTS_PER_CHUNK = 1 << 14  # what is between two layers stays in a processor's cache
_POINTS_PER_CHUNK_ON_GPU = 1 << 16


@dataclass
class RenderedRays:
    """What R rays of each of B scenes see."""

    values: dict[str, Tensor]
    """``rgb`` [B, R, 3], ``semantic`` logits [B, R, C], ``feature`` [B, R, F]"""
    depths: Float[Tensor, "B R S"]
    """planar depth of the samples [m]"""
    weights: Float[Tensor, "B R S"]
    """their share in the ray"""
    leave: Float[Tensor, "B R"]
    """planar depth beyond which there is nothing but the backdrop [m]"""

    @property
    def depth(self) -> Float[Tensor, "B R"]:
        """Median planar depth [m]."""
        return median_depth(self.weights, self.depths, self.leave)


def render_at(
    field: RadianceField,
    latent: Float[Tensor, "B Z"],
    origins: Float[Tensor, "B R 3"],
    directions: Float[Tensor, "B R 3"],
    depths: Float[Tensor, "B R S"],
    leave: Float[Tensor, "B R"],
) -> RenderedRays:
    """Render rays from samples at sorted planar depths [m], the last one the backdrop, up to where they leave [m]."""
    density, features = _evaluate(field, latent, origins, directions, depths)
    weights = rendering_weights(density, sample_spacings(depths, directions, leave))
    return RenderedRays(field.read(composite(weights.to(features.dtype), features)), depths, weights, leave)


@dataclass
class SampleNoise:
    """What is random about where B x R rays of known depth are evaluated."""

    even: Float[Tensor, "B R S"]
    """uniform in [0, 1]"""
    before: Float[Tensor, "B R A"]
    """uniform in [0, 1]"""
    around: Float[Tensor, "B R N"]
    """standard normal"""

    @classmethod
    def draw(
        cls, config: SamplingConfig, scenes: int, rays: int, generator: torch.Generator, device: torch.device
    ) -> "SampleNoise":
        """Draw it for all rays of some scenes."""

        def counts(samples: int) -> tuple[int, int, int]:
            return scenes, rays, samples

        return cls(
            torch.rand(counts(config.training_stratified), generator=generator, device=device),
            torch.rand(counts(config.training_free_space), generator=generator, device=device),
            torch.randn(counts(config.training_surface), generator=generator, device=device),
        )

    def of_scenes(self, share: slice) -> "SampleNoise":
        """Return that of some of the scenes."""
        return SampleNoise(self.even[share], self.before[share], self.around[share])


def render_depth_guided(
    field: RadianceField,
    latent: Float[Tensor, "B Z"],
    origins: Float[Tensor, "B R 3"],
    directions: Float[Tensor, "B R 3"],
    depth: Float[Tensor, "B R"],
    config: SamplingConfig,
    noise: SampleNoise,
    unit: float = 1.0,
) -> RenderedRays:
    """Render rays whose planar depth [m] is known: samples everywhere, before the surface, and around it.

    Those before the surface tell the field what is empty where something might have been. With importance samples as
    well, or instead, rays are looked for as if their depth were unknown: where those everywhere found density.
    ``unit`` is that of the recipe's lengths [m].
    """
    near, far = field.ray_limits(origins, directions)
    even = stratified_samples(near, far, noise.even)
    before = free_space_samples(torch.minimum(depth, far), unit * config.free_space_reach, near, noise.before)
    around = surface_samples(depth, unit * config.surface_deviation, near, far, noise.around)
    found = _found_density(field, latent, origins, directions, even, config.training_importance)
    backdrop = torch.full_like(depth[..., None], field.bounds.far)
    depths = torch.cat([torch.cat([even, before, around, found], dim=-1).sort(-1).values, backdrop], dim=-1)
    return render_at(field, latent, origins, directions, depths, far)


@torch.no_grad()
def render_without_depth(
    field: RadianceField,
    latent: Float[Tensor, "B Z"],
    origins: Float[Tensor, "B R 3"],
    directions: Float[Tensor, "B R 3"],
    config: SamplingConfig,
) -> RenderedRays:
    """Render rays of unknown depth: even samples, then importance samples where those found density, and around it.

    The field is asked once for each. What it says of the even samples counts in the picture, too.
    """
    near, far = field.ray_limits(origins, directions)
    even = even_samples(near, far, tuple(origins.shape[:2]), config.rendering_stratified, origins.device)
    density, features = _evaluate(field, latent, origins, directions, even)
    found = widened_weights(rendering_weights(density, sample_spacings(even, directions)))
    fine = importance_samples(even, found, config.rendering_importance)
    finer = torch.cat([fine, torch.full_like(even[..., :1], field.bounds.far)], dim=-1)  # the backdrop is the last
    finer_density, finer_features = _evaluate(field, latent, origins, directions, finer)
    depths, order = torch.cat([even, finer], dim=-1).sort(dim=-1, stable=True)
    density = torch.cat([density, finer_density], dim=-1).gather(-1, order)
    weights = rendering_weights(density, sample_spacings(depths, directions, far))
    unsorted = torch.zeros_like(weights).scatter(-1, order, weights).to(features.dtype)
    even_share, finer_share = unsorted.split([even.shape[-1], finer.shape[-1]], dim=-1)
    composited = composite(even_share, features) + composite(finer_share, finer_features)
    return RenderedRays(field.read(composited), depths, weights, far)


@dataclass
class RenderedImages:
    """What cameras see of one scene, as the field has it."""

    rgb: Float[ndarray, "V H W 3"]
    """in [0, 1]"""
    semantic: Int[ndarray, "V H W"]
    """class ids"""
    depth: Float[ndarray, "V H W"]
    """median planar depth [m]"""


def render_images(
    field: RadianceField,
    latent: Float[Tensor, "Z"],
    intrinsics: Float[ndarray, "V 3 3"],
    camera_from_world: Float[ndarray, "V 4 4"],
    height: int,
    width: int,
    config: SamplingConfig,
) -> RenderedImages:
    """Render whole images of the scene that a latent describes, from any cameras, in chunks of bounded memory."""
    views = len(intrinsics)
    pixels = np.broadcast_to(pixel_centres(height, width), (views, height * width, 2))
    directions = pixel_directions(intrinsics, camera_from_world, pixels)
    origins = np.broadcast_to(camera_position(camera_from_world)[:, None], directions.shape)
    device = latent.device
    rays = [
        torch.from_numpy(np.ascontiguousarray(a.reshape(-1, 3), np.float32)).to(device) for a in (origins, directions)
    ]
    samples = config.rendering_stratified + config.rendering_importance + 1
    chunk = max(1, (_POINTS_PER_CHUNK if device.type == "cpu" else _POINTS_PER_CHUNK_ON_GPU) // samples)
    rgb, semantic, depth = [], [], []
    for start in range(0, len(rays[0]), chunk):
        part = [ray[None, start : start + chunk] for ray in rays]
        rendered = render_without_depth(field, latent[None], part[0], part[1], config)
        rgb.append(rendered.values["rgb"][0].clamp(0.0, 1.0).float())
        semantic.append(rendered.values["semantic"][0].argmax(-1))
        depth.append(rendered.depth[0])
    shape = (views, height, width)
    return RenderedImages(
        torch.cat(rgb).reshape(*shape, 3).cpu().numpy(),
        torch.cat(semantic).reshape(shape).cpu().numpy(),
        torch.cat(depth).reshape(shape).cpu().numpy(),
    )


@torch.no_grad()
def _found_density(
    field: RadianceField, latent: Tensor, origins: Tensor, directions: Tensor, even: Float[Tensor, "B R S"], count: int
) -> Float[Tensor, "B R M"]:
    """Return planar depths [m] where samples found density."""
    if not count:
        return even[..., :0]
    density, _ = _evaluate(field, latent, origins, directions, even)
    return importance_samples(even, rendering_weights(density, sample_spacings(even, directions)), count)


def _evaluate(
    field: RadianceField, latent: Tensor, origins: Tensor, directions: Tensor, depths: Float[Tensor, "B R S"]
) -> tuple[Float[Tensor, "B R S"], Float[Tensor, "B R S W"]]:
    points = origins[..., None, :] + depths[..., None] * directions[..., None, :]
    density, features = field(points.flatten(1, 2), latent)
    return density.reshape(depths.shape), features.reshape(*depths.shape, -1)
