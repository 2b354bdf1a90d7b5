"""Rendering a radiance field for a camera that moves: coarse at once, fine where the coarse image saw something."""

import functools
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray
from torch import Tensor
from torch.nn import functional as F

from nerf_rl.cameras.geometry import (
    camera_position,
    field_of_view,
    intrinsics_from_fovy,
    pixel_centres,
    pixel_directions,
)
from nerf_rl.machine.cores import usable_cores
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.ray_rendering import RenderedImages
from nerf_rl.pretrain.model.volume_rendering import (
    composite,
    even_samples,
    importance_samples,
    median_depth,
    rendering_weights,
    sample_spacings,
    widened_weights,
)

_BINS = 48  # of depth, in which coarse rays remember where they met something
_COARSE_SAMPLES = 20
_IMPORTANCE_SAMPLES = 10
_OPAQUE = 0.03  # a ray that lets less than this through does without the backdrop
_RAYS_PER_CHUNK = 2048
_RAYS_PER_CHUNK_ON_GPU = 1 << 15
_MOST_THREADS = 8


@dataclass(frozen=True)
class FreeCamera:
    """A camera whose pictures may have any size, in OpenCV's axes."""

    camera_from_world: Float[ndarray, "4 4"]
    fovy: float
    """vertical field of view [rad]"""
    aspect: float
    """width over height"""
    unit_intrinsics: Float[ndarray, "3 3"] | None = None
    """K [image widths and heights]; None has square pixels and a centred principal point"""

    @classmethod
    def of_view(
        cls, intrinsics: Float[ndarray, "3 3"], camera_from_world: Float[ndarray, "4 4"], height: int, width: int
    ) -> "FreeCamera":
        """Return the camera of a picture, whose K [pixels] need not be centred, as those of real cameras are not."""
        fovy = field_of_view(intrinsics, height)
        return cls(camera_from_world, fovy, width / height, intrinsics / np.array([[width], [height], [1.0]]))

    def shape(self, longer: int) -> tuple[int, int]:
        """Return height and width [pixels] of an image whose longer side is given."""
        if self.aspect >= 1.0:
            return max(1, round(longer / self.aspect)), longer
        return longer, max(1, round(longer * self.aspect))

    def rays(
        self, height: int, width: int, device: torch.device | str = "cpu"
    ) -> tuple[Float[Tensor, "3"], Float[Tensor, "R 3"]]:
        """Return the origin, and directions of unit planar depth through the pixels' centres."""
        K = self.unit_intrinsics
        if K is None:
            K = intrinsics_from_fovy(np.rad2deg(self.fovy), 1, 1)
            K[0, 0] /= self.aspect
        K = K * np.array([[width], [height], [1.0]])
        directions = pixel_directions(K, self.camera_from_world, pixel_centres(height, width))
        origin = camera_position(self.camera_from_world)
        origin, directions = origin.astype(np.float32), directions.astype(np.float32)
        return torch.from_numpy(origin).to(device), torch.from_numpy(directions).to(device)


@dataclass(frozen=True)
class _Rays:
    """R rays from one place."""

    origin: Float[Tensor, "3"]
    directions: Float[Tensor, "R 3"]
    """of unit planar depth"""
    enter: Float[Tensor, "R"]
    """where they come into the box of all that is seen [m of depth]"""
    leave: Float[Tensor, "R"]

    @classmethod
    def of_camera(cls, camera: FreeCamera, height: int, width: int, field: ConditionedField) -> "_Rays":
        """Return those through the pixels' centres."""
        origin, directions = camera.rays(height, width, field.latent.device)
        return cls(origin, directions, *field.field.ray_limits(origin.expand_as(directions), directions))

    def part(self, which: slice) -> "_Rays":
        return _Rays(self.origin, self.directions[which], self.enter[which], self.leave[which])


@dataclass
class _Sight:
    """What R rays see, and where."""

    features: Float[Tensor, "R W"]
    depths: Float[Tensor, "R S"]
    weights: Float[Tensor, "R S"]
    leave: Float[Tensor, "R"]


class Picture(NamedTuple):
    """An image to be rendered."""

    longer: int
    """pixels on the longer side"""
    samples: int = 8
    """on each ray"""


@torch.inference_mode()
def render_progressively(
    field: ConditionedField,
    camera: FreeCamera,
    coarse: int,
    fine: list[Picture],
    stale: Callable[[], bool] = lambda: False,
) -> Iterator[RenderedImages]:
    """Yield ever finer images (V = 1), until a newer one is wanted.

    The coarse image has samples all along its rays. A ray of a finer one has a few, spread over the depths at which the
    coarse rays around it met something, which costs a fraction.

    Args:
        field: of the scene.
        camera: from where.
        coarse: pixels on the longer side of the first image.
        fine: the images after it.
        stale: tells whether to stop.
    """
    near, far = field.field.bounds.near, field.field.bounds.far
    height, width = camera.shape(coarse)
    device = field.latent.device
    rays = _Rays.of_camera(camera, height, width, field)
    spacing = (far - near) / _COARSE_SAMPLES
    every = even_samples(rays.enter, rays.leave, (height * width,), _COARSE_SAMPLES, device)
    sight = _in_chunks(lambda part: _render_twice(field, rays.part(part), every[part]), len(every), stale, device)
    if sight is None:
        return
    yield _images(field, sight, height, width)
    bins = even_samples(near, far, (), _BINS, device)
    histogram = _histogram(sight, near, far).reshape(1, height, width, _BINS).permute(0, 3, 1, 2)
    around = F.max_pool2d(histogram, 3, 1, 1)
    longest = max(spacing, 1.5 * (far - near) / _BINS)
    for picture in fine:
        height, width = camera.shape(picture.longer)
        rays = _Rays.of_camera(camera, height, width, field)
        mass = F.interpolate(around, (height, width), mode="nearest")[0].reshape(_BINS, -1).T
        render = partial(_render_where, field, rays, bins, mass, picture.samples, longest)
        sight = _in_chunks(render, len(mass), stale, device)
        if sight is None:
            return
        yield _images(field, sight, height, width)


def _in_chunks(
    render: Callable[[slice], _Sight], count: int, stale: Callable[[], bool], device: torch.device
) -> _Sight | None:
    """Render rays, on the processor in all threads; None if a newer picture was wanted before the end.

    Args:
        render: renders the rays of a slice.
        count: how many there are.
        stale: tells whether a newer picture is wanted.
        device: where they are rendered.
    """
    size = _RAYS_PER_CHUNK_ON_GPU
    if device.type == "cpu":
        size = min(_RAYS_PER_CHUNK, -(-count // (2 * _thread_count())))

    def chunk(start: int) -> _Sight | None:
        if stale():
            return None
        with torch.inference_mode():  # it holds for a thread
            return render(slice(start, start + size))

    parts = list(_threads().map(chunk, range(0, count, size)))
    whole = [part for part in parts if part is not None]
    if len(whole) < len(parts):
        return None
    return _Sight(*(torch.cat([getattr(part, each.name) for part in whole]) for each in fields(_Sight)))


@functools.cache
def _threads() -> ThreadPoolExecutor:
    """Return threads that each render chunks of their own.

    They need not wait for each other as PyTorch's own threads do at every operation, which takes many times longer
    where a browser wants the same cores.
    """
    return ThreadPoolExecutor(_thread_count(), "field", initializer=torch.set_num_threads, initargs=(1,))


def _thread_count() -> int:
    return min(_MOST_THREADS, usable_cores())


def _render_twice(field: ConditionedField, rays: _Rays, depths: Float[Tensor, "R S"]) -> _Sight:
    """Render rays at sorted depths [m], and at some more where the first ones found something."""
    first = _evaluate(field, rays, depths)
    weights = _weights(field, rays, depths, first[0], None)
    more = importance_samples(depths, widened_weights(weights[:, :-1]), _IMPORTANCE_SAMPLES)
    second = _evaluate(field, rays, more)
    every, order = torch.cat([depths, more], dim=-1).sort(-1)
    density = torch.cat([first[0], second[0]], dim=1).gather(1, order)
    features = torch.cat([first[1], second[1]], dim=1)
    features = features.gather(1, order[..., None].expand(-1, -1, features.shape[-1]))
    return _composed(field, rays, every, density, features, None)


def _render_where(
    field: ConditionedField,
    rays: _Rays,
    bins: Float[Tensor, "B"],
    mass: Float[Tensor, "R B"],
    samples: int,
    longest: float,
    part: slice,
) -> _Sight:
    """Render some rays at depths spread over where something was met.

    Args:
        field: of the scene.
        rays: all of them.
        bins: depths [m].
        mass: what all rays met there.
        samples: on each ray.
        longest: most that a sample may stand for [m of depth]; gaps between samples are known to be empty.
        part: which rays.
    """
    chosen, rays = mass[part], rays.part(part)
    depths = importance_samples(bins.expand(len(chosen), -1), chosen, samples)
    density, features = _evaluate(field, rays, depths)
    return _composed(field, rays, depths, density, features, longest)


def _evaluate(
    field: ConditionedField, rays: _Rays, depths: Float[Tensor, "R S"]
) -> tuple[Float[Tensor, "R S"], Float[Tensor, "R S W"]]:
    density, features = field((rays.origin + depths[..., None] * rays.directions[:, None]).reshape(-1, 3))
    return density.reshape(depths.shape), features.reshape(*depths.shape, -1)


def _weights(
    field: ConditionedField, rays: _Rays, depths: Float[Tensor, "R S"], density: Tensor, longest: float | None
) -> Float[Tensor, "R S1"]:
    """Return the samples' shares in their rays, and last that of the backdrop, which takes the rest."""
    far = torch.full_like(depths[:, :1], field.field.bounds.far)
    spacings = sample_spacings(torch.cat([depths, far], dim=-1), rays.directions, rays.leave)
    if longest is not None:
        length = longest * rays.directions.norm(dim=-1, keepdim=True)
        spacings[:, :-1] = torch.minimum(spacings[:, :-1], length)
    return rendering_weights(torch.cat([density, torch.ones_like(far)], dim=-1), spacings)


def _composed(
    field: ConditionedField,
    rays: _Rays,
    depths: Float[Tensor, "R S"],
    density: Float[Tensor, "R S"],
    features: Float[Tensor, "R S W"],
    longest: float | None,
) -> _Sight:
    """Put samples together, and the backdrop where they let something through."""
    weights = _weights(field, rays, depths, density, longest)
    seen = composite(weights[:, :-1], features)
    open_rays = torch.nonzero(weights[:, -1] > _OPAQUE)[:, 0]
    if len(open_rays):
        _, backdrop = field(rays.origin + field.field.bounds.far * rays.directions[open_rays])
        seen[open_rays] += weights[open_rays, -1:] * backdrop
    far = torch.full_like(depths[:, :1], field.field.bounds.far)
    return _Sight(seen, torch.cat([depths, far], dim=-1), weights, rays.leave)


def _histogram(sight: _Sight, near: float, far: float) -> Float[Tensor, "R bins"]:
    """Return each ray's weight in equal bins of depth."""
    place = ((sight.depths[:, :-1] - near) / (far - near) * _BINS).long().clamp(0, _BINS - 1)
    return torch.zeros(len(place), _BINS, device=place.device).scatter_add_(1, place, sight.weights[:, :-1].clone())


def _images(field: ConditionedField, sight: _Sight, height: int, width: int) -> RenderedImages:
    values, shape = field.field.read(sight.features), (1, height, width)
    return RenderedImages(
        values["rgb"].clamp(0.0, 1.0).reshape(*shape, 3).cpu().numpy(),
        values["semantic"].argmax(-1).reshape(shape).cpu().numpy(),
        median_depth(sight.weights, sight.depths, sight.leave).reshape(shape).cpu().numpy(),
    )
