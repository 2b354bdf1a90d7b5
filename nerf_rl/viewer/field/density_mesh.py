"""Surfaces of a density, by surface nets on a regular grid."""

from itertools import product

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from numpy import ndarray

from nerf_rl.pretrain.model.conditioned_field import ConditionedField

_POINTS_AT_ONCE = 1 << 15
_AXES = np.eye(3, dtype=np.int64)


def surface_net(values: Float[ndarray, "X Y Z"], level: float) -> tuple[Float32[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Return the surface on which values on a grid cross a level: vertices in grid units, and triangles.

    Naive surface nets (Gibson 1998): a cell that the surface passes through has one vertex, the mean of the crossings
    on its edges; an edge that crosses joins the vertices of the four cells around it. Triangles face smaller values.
    """
    inside = values > level
    cells = np.array(values.shape) - 1
    total, count = np.zeros((*cells, 3)), np.zeros(cells)
    quads = []
    for axis in range(3):
        step = _AXES[axis]
        ends = [inside[_window(inside.shape, step * end, step)] for end in (0, 1)]
        crossing = ends[0] != ends[1]
        low, high = (values[_window(values.shape, step * end, step)] for end in (0, 1))
        share = np.where(crossing, (level - low) / np.where(crossing, high - low, 1.0), 0.0)
        b, c = _AXES[(axis + 1) % 3], _AXES[(axis + 2) % 3]
        for i, j in product((0, 1), (0, 1)):  # the cells around an edge hold it at four of their own edges
            corner = i * b + j * c
            part = tuple(slice(start, start + size) for start, size in zip(corner, cells, strict=True))
            crossed = crossing[part]
            count += crossed
            total += crossed[..., None] * (corner + share[part][..., None] * step)
        edges = np.argwhere(crossing)
        within = ((edges - b - c >= 0) | (step > 0)).all(1) & ((edges < cells) | (step > 0)).all(1)
        edges = edges[within]
        around = np.stack([edges - b - c, edges - c, edges, edges - b], axis=1)
        flip = ends[1][tuple(edges.T)]
        around[flip] = around[flip][:, ::-1]
        quads.append(around)
    used = np.argwhere(count > 0)
    number = np.full(cells, -1)
    number[tuple(used.T)] = np.arange(len(used))
    vertices = used + total[tuple(used.T)] / count[tuple(used.T)][:, None]
    corners = np.concatenate(quads).reshape(-1, 3)
    faces = number[tuple(corners.T)].reshape(-1, 4)
    return vertices.astype(np.float32), np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def density_mesh(
    field: ConditionedField, level: float = 20.0, resolution: int = 72
) -> tuple[Float32[ndarray, "V 3"], Int[ndarray, "F 3"], Float32[ndarray, "V 3"]]:
    """Return the surface of a density in the field's box: vertices [m], triangles, and colours in [0, 1].

    Args:
        field: of the scene.
        level: of the density [1/m]; behind the surface, half of the light is gone after 0.7 / level.
        resolution: grid points on a side of the box.
    """
    bounds = field.field.bounds
    side = np.linspace(-bounds.half_extent, bounds.half_extent, resolution)
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3) + np.array(bounds.centre)
    device = field.latent.device
    parts = torch.from_numpy(grid.astype(np.float32)).split(_POINTS_AT_ONCE)
    density = [field(part.to(device))[0].cpu() for part in parts]
    vertices, faces = surface_net(torch.cat(density).reshape(resolution, resolution, resolution).numpy(), level)
    points = vertices * (side[1] - side[0]) - bounds.half_extent + np.array(bounds.centre)
    parts = torch.from_numpy(points.astype(np.float32)).split(_POINTS_AT_ONCE)
    features = [field(part.to(device))[1] for part in parts]
    with torch.inference_mode():
        colours = field.field.read(torch.cat(features))["rgb"].clamp(0.0, 1.0).cpu().numpy()
    return points.astype(np.float32), faces, colours


def _window(shape: tuple[int, ...], start: ndarray, shrink: ndarray) -> tuple[slice, ...]:
    return tuple(slice(s, n - k + s) for s, n, k in zip(start, shape, shrink, strict=True))
