"""A frame as one coloured surface: the views' depth fused into a truncated signed distance field by Open3D."""

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from nerf_rl.datasets.export.seen import Seen
from nerf_rl.datasets.storage.point_cloud import unproject
from nerf_rl.errors import UserError
from nerf_rl.files.atomic import atomic_write
from nerf_rl.machine.extras import import_extra

_BLOCK, _FIRST_BLOCKS = 16, 1000  # voxels along an edge of a block, and blocks to begin with
_LEAST_TRUNCATION, _MOST_TRUNCATION = 2.0, 8.0  # voxels
_TRUNCATION_PIXELS = 2.0  # what they cover: with less, surfaces that are seen aslant have holes
_LEAST_WEIGHT = 0.5  # of a voxel that counts: one view is enough
_DEPTH_UNIT = 1.0  # [m]
_FARTHEST = 1000.0  # [m]; depth is limited beforehand


def load_open3d() -> ModuleType:
    """Import Open3D, which takes seconds.

    Raises:
        UserError: it, or a system library that it needs, is not installed.
    """
    purpose = "--format mesh"
    try:
        return import_extra("open3d", "export", purpose)
    except ModuleNotFoundError:
        raise
    except ImportError as error:
        raise UserError(
            f"{purpose} needs a system library that Open3D does not find ({error}); on Debian and Ubuntu: "
            "apt install libusb-1.0-0 libgl1 libgomp1"
        ) from error


def write_mesh(path: Path, seen: Seen, voxel: float) -> bool:
    """Fuse the views of a frame and write the surface as PLY; tell whether there is any that could be written.

    Args:
        path: of the file.
        seen: the frame and what of it counts.
        voxel: edge of the field's voxels [m].
    """
    open3d = load_open3d()
    tensor, single = open3d.core.Tensor, open3d.core.float32
    grid = open3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (single,) * 3, ((1,), (1,), (3,)), voxel, _BLOCK, _FIRST_BLOCKS
    )
    frame, depth = seen.frame, seen.depth()
    truncation = _truncation(seen, depth, voxel)
    for view in np.flatnonzero(depth.any(axis=(1, 2))):
        image = open3d.t.geometry.Image(tensor(np.ascontiguousarray(depth[view][..., None])))
        colours = open3d.t.geometry.Image(tensor(frame.rgb[view].astype(np.float32) / 255))
        matrices = frame.intrinsics[view], frame.camera_from_world[view]
        # of a depth image, Open3D would look at every fourth pixel of every fourth row for blocks that it touches
        points = unproject(depth[view], *matrices)[depth[view] > 0].astype(np.float32)
        blocks = grid.compute_unique_block_coordinates(open3d.t.geometry.PointCloud(tensor(points)), truncation)
        camera = [tensor(matrix.tolist()) for matrix in matrices]
        grid.integrate(blocks, image, colours, *camera, _DEPTH_UNIT, _FARTHEST, truncation)
    mesh = grid.extract_triangle_mesh(_LEAST_WEIGHT) if depth.any() else None
    if mesh is None or len(mesh.triangle.indices) == 0:
        return False
    _write(path, mesh.to_legacy())
    return True


def _write(path: Path, mesh: Any) -> None:
    """Write Open3D's mesh with trimesh: Open3D's own writer reports success where the disk is full."""
    import trimesh

    surface = trimesh.Trimesh(
        np.asarray(mesh.vertices),
        np.asarray(mesh.triangles),
        vertex_normals=np.asarray(mesh.vertex_normals),
        vertex_colors=(np.asarray(mesh.vertex_colors) * 255).round().astype(np.uint8),
        process=False,
    )
    with atomic_write(path) as aside:
        surface.export(aside, vertex_normal=True)


def _truncation(seen: Seen, depth: Float32[ndarray, "V H W"], voxel: float) -> float:
    """Return how far behind a surface the field is known [voxels].

    What is thinner gets thicker by it, since those views that look at its other side find themselves behind it: no more
    than the voxels or the pixels, in the middle of what is seen, ask for.
    """
    pixels = depth / seen.frame.intrinsics[:, :1, :1].astype(np.float32)
    covered = np.median(pixels[depth > 0]) if depth.any() else 0.0
    return float(np.clip(_TRUNCATION_PIXELS * covered / voxel, _LEAST_TRUNCATION, _MOST_TRUNCATION))
