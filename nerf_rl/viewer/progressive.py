"""Rendering a radiance field for a camera that moves: coarse at once, fine where the coarse image saw something."""

import functools
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor
from torch.nn import functional as F

from nerf_rl.cameras import camera_position, pixel_centres, pixel_directions
from nerf_rl.pretrain.folded_field import FoldedField
from nerf_rl.pretrain.rendering import RenderedImages
from nerf_rl.pretrain.volume_rendering import (
    composite,
    importance_samples,
    rendering_weights,
    sample_spacings,
    stratified_samples,
)

_BINS = 48  # of depth, in which coarse rays remember where they met something
_COARSE_SAMPLES = 20
_IMPORTANCE_SAMPLES = 10
_FINE_SAMPLES = 8
_OPAQUE = 0.03  # a ray that lets less than this through does without the backdrop
_RAYS_PER_CHUNK = 2048
_MOST_THREADS = 8


@dataclass(frozen=True)
class FreeCamera:
    """A camera for people, in OpenCV's axes."""

    camera_from_world: Float[ndarray, "4 4"]
    fovy: float
    """vertical field of view [rad]"""
    aspect: float
    """width over height"""

    def shape(self, longer: int) -> tuple[int, int]:
        """Return height and width [pixels] of an image whose longer side is given."""
        if self.aspect >= 1.0:
            return max(1, round(longer / self.aspect)), longer
        return longer, max(1, round(longer * self.aspect))

    def rays(self, height: int, width: int) -> tuple[Float[Tensor, "3"], Float[Tensor, "R 3"]]:
        """Return the origin, and directions of unit planar depth through the pixels' centres."""
        focal = 0.5 / np.tan(self.fovy / 2.0)  # in image heights
        K = np.diag([focal * width / self.aspect, focal * height, 1.0])
        K[:2, 2] = width / 2.0, height / 2.0
        directions = pixel_directions(K, self.camera_from_world, pixel_centres(height, width))
        origin = camera_position(self.camera_from_world)
        return torch.from_numpy(origin.astype(np.float32)), torch.from_numpy(directions.astype(np.float32))


@dataclass
class _Rays:
    """What R rays see, and where."""

    features: Float[Tensor, "R W"]
    depths: Float[Tensor, "R S"]
    weights: Float[Tensor, "R S"]


@torch.inference_mode()
def render_progressively(
    field: FoldedField,
    camera: FreeCamera,
    coarse: int,
    fine: list[int],
    stale: Callable[[], bool] = lambda: False,
) -> Iterator[RenderedImages]:
    """Yield ever finer images (V = 1), until a newer one is wanted.

    The coarse image has samples all along its rays. A ray of a finer one has a few, spread over the depths at which the
    coarse rays around it met something, which costs a fraction.

    Args:
        field: of the scene.
        camera: from where.
        coarse: pixels on the longer side of the first image.
        fine: the same, of the images after it.
        stale: tells whether to stop.
    """
    near, far = field.field.bounds.near, field.field.bounds.far
    height, width = camera.shape(coarse)
    device = field.latent.device
    depths = stratified_samples(near, far, (height * width,), _COARSE_SAMPLES, None, device)
    spacing = (far - near) / _COARSE_SAMPLES
    density = _in_chunks(field, camera.rays(height, width), depths, None, stale)
    if density is None:
        return
    # once more, where the first samples found something
    middles = importance_samples(depths, density.weights[:, :-1], _IMPORTANCE_SAMPLES)
    both = torch.cat([depths, middles], dim=-1).sort(-1).values
    rays = _in_chunks(field, camera.rays(height, width), both, None, stale)
    if rays is None:
        return
    yield _images(field, rays, height, width)
    bins = stratified_samples(near, far, (), _BINS, None, device)
    histogram = _histogram(rays, near, far).reshape(1, height, width, _BINS).permute(0, 3, 1, 2)
    around = F.max_pool2d(histogram, 3, 1, 1)
    for size in fine:
        height, width = camera.shape(size)
        mass = F.interpolate(around, (height, width), mode="nearest")[0].reshape(_BINS, -1).T
        depths = importance_samples(bins.expand(len(mass), -1), mass, _FINE_SAMPLES)
        longest = max(spacing, 1.5 * (far - near) / _BINS)
        rays = _in_chunks(field, camera.rays(height, width), depths, longest, stale)
        if rays is None:
            return
        yield _images(field, rays, height, width)


def _in_chunks(
    field: FoldedField,
    rays: tuple[Tensor, Tensor],
    depths: Float[Tensor, "R S"],
    longest: float | None,
    stale: Callable[[], bool],
) -> _Rays | None:
    """Render rays at sorted depths [m]; None if a newer picture was wanted before the end.

    Args:
        longest: most that a sample may stand for [m of depth]; gaps between samples are known to be empty.
    """

    def chunk(start: int) -> _Rays | None:
        if stale():
            return None
        chosen = slice(start, start + _RAYS_PER_CHUNK)
        with torch.inference_mode():  # it holds for a thread
            return _render(field, rays[0], rays[1][chosen], depths[chosen], longest)

    parts = list(_threads().map(chunk, range(0, len(depths), _RAYS_PER_CHUNK)))
    whole = [part for part in parts if part is not None]
    if len(whole) < len(parts):
        return None
    return _Rays(*(torch.cat([getattr(part, name) for part in whole]) for name in ("features", "depths", "weights")))


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Return threads that each render chunks of their own.

    They need not wait for each other as PyTorch's own threads do at every operation, which takes many times longer
    where a browser wants the same cores.
    """
    count = min(_MOST_THREADS, len(os.sched_getaffinity(0)))
    return ThreadPoolExecutor(count, "field", initializer=torch.set_num_threads, initargs=(1,))


def _render(
    field: FoldedField, origin: Tensor, directions: Tensor, depths: Float[Tensor, "R S"], longest: float | None
) -> _Rays:
    far = torch.full_like(depths[:, :1], field.field.bounds.far)
    points = origin + depths[..., None] * directions[:, None]
    density, features = field(points.reshape(-1, 3))
    every = torch.cat([depths, far], dim=-1)
    spacings = sample_spacings(every, directions)
    if longest is not None:
        length = longest * directions.norm(dim=-1, keepdim=True)
        spacings[:, :-1] = torch.minimum(spacings[:, :-1], length)
    densities = torch.cat([density.reshape(depths.shape), torch.ones_like(far)], dim=-1)  # the backdrop takes the rest
    weights = rendering_weights(densities, spacings)
    seen = composite(weights[:, :-1], features.reshape(*depths.shape, -1))
    open_rays = torch.nonzero(weights[:, -1] > _OPAQUE)[:, 0]
    if len(open_rays):
        _, backdrop = field(origin + field.field.bounds.far * directions[open_rays])
        seen[open_rays] += weights[open_rays, -1:] * backdrop
    return _Rays(seen, every, weights)


def _histogram(rays: _Rays, near: float, far: float) -> Float[Tensor, "R bins"]:
    """Return each ray's weight in equal bins of depth."""
    place = ((rays.depths[:, :-1] - near) / (far - near) * _BINS).long().clamp(0, _BINS - 1)
    return torch.zeros(len(place), _BINS).scatter_add_(1, place, rays.weights[:, :-1].clone())


def _images(field: FoldedField, rays: _Rays, height: int, width: int) -> RenderedImages:
    values, shape = field.field.read(rays.features), (1, height, width)
    return RenderedImages(
        values["rgb"].clamp(0.0, 1.0).reshape(*shape, 3).numpy(),
        values["semantic"].argmax(-1).reshape(shape).numpy(),
        (rays.weights * rays.depths).sum(-1).reshape(shape).numpy(),
    )
