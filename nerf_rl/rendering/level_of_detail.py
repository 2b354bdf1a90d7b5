"""Visual level of detail: a copy of a model whose meshes have as many triangles as images of it can show.

Only the copy that the OpenGL context is built from is simplified; physics and scenes keep the real model. Edges sharper
than a crease angle stay sharp: normals are averaged only over adjacent faces that are nearly parallel.
"""

import copy
import functools

import fast_simplification
import mujoco
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from nerf_rl.scenes.workspace import drawn_geoms

_TRIANGLES_PER_PIXEL = 0.4  # of the mesh's bounding sphere; back faces and detail inside the outline included
_FEWEST_TRIANGLES_PER_ROW = 11.0  # of the image: thin and dented outlines need more than their area says
_PLANE_CELLS = 10  # along the shorter side; light is computed at their corners
_SLICES_PER_ROOT_ROW = 1.8  # of cylinders: 20 for 128 rows, as the error of a circle that fills the image is half a
# pixel then
_STACKS = 4  # of cylinders along their axis, which changes nothing but where light is computed
_SPHERICAL = (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_ELLIPSOID)
_AGGRESSIVENESS = 2.0  # of fast_simplification; its default of 7 is faster and leaves slivers with wrong normals
_CREASE_COSINE = np.cos(np.deg2rad(40.0))


def simplify_meshes(model: mujoco.MjModel, height: int, pixels_per_metre: float) -> mujoco.MjModel:
    """Return a copy of the model with meshes simplified for images of the given height [pixels].

    Args:
        model: compiled.
        height: of an image [pixels].
        pixels_per_metre: of an image, where a camera is nearest to what it shows.

    Meshes with a texture are kept, since simplification would tear their texture coordinates; many have such
    coordinates and no texture. Planes are divided less, and so are cylinders where nothing is spherical: MuJoCo cuts
    each into a thousand triangles and more, whatever its size. Spheres stay as they are, because their depth would
    suffer.
    """
    simplified = copy.deepcopy(model)
    planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    spacing = simplified.geom_size[:, 2]
    spacing[planes] = np.maximum(spacing[planes], 2 * model.geom_size[planes, :2].min(1) / _PLANE_CELLS)
    quality = simplified.vis.quality
    drawn = drawn_geoms(model)
    if not np.isin(model.geom_type[drawn], _SPHERICAL).any():  # the divisions are the same for all shapes of a model
        quality.numslices = min(quality.numslices, round(_SLICES_PER_ROOT_ROW * height**0.5))
        quality.numstacks = min(quality.numstacks, _STACKS)
    textured = _textured_meshes(model)
    for mesh in range(model.nmesh):
        if mesh in textured:
            continue
        vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        radius = np.linalg.norm(vertices - vertices.mean(0), axis=1).max()
        covered = np.pi * (pixels_per_metre * radius) ** 2
        target = int(max(_FEWEST_TRIANGLES_PER_ROW * height, _TRIANGLES_PER_PIXEL * covered))
        if target < model.mesh_facenum[mesh]:
            _replace_mesh(simplified, model, mesh, target)
    return simplified


def _textured_meshes(model: mujoco.MjModel) -> set[int]:
    """Return the meshes that some geom shows with a texture."""
    meshes = np.flatnonzero((model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_matid >= 0))
    textured = meshes[(model.mat_texid[model.geom_matid[meshes]] >= 0).any(axis=1)]
    return {mesh for mesh in model.geom_dataid[textured].tolist() if model.mesh_texcoordnum[mesh]}


def _replace_mesh(simplified: mujoco.MjModel, model: mujoco.MjModel, mesh: int, target: int) -> None:
    """Write a simplified mesh over the arrays of the original, which are long enough by construction."""
    first_vertex, first_face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    first_normal, normal_count = model.mesh_normaladr[mesh], model.mesh_normalnum[mesh]
    vertices = model.mesh_vert[first_vertex:][: model.mesh_vertnum[mesh]]
    faces = model.mesh_face[first_face:][: model.mesh_facenum[mesh]]
    distinct, vertices, faces, normals, corners = _simplify(vertices.tobytes(), faces.tobytes(), target)
    if not 0 < len(faces) <= model.mesh_facenum[mesh] or len(vertices) > distinct or len(normals) > normal_count:
        return
    simplified.mesh_texcoordadr[mesh], simplified.mesh_texcoordnum[mesh] = -1, 0
    simplified.mesh_facenum[mesh] = len(faces)
    simplified.mesh_vertnum[mesh] = len(vertices)
    simplified.mesh_normalnum[mesh] = len(normals)
    simplified.mesh_vert[first_vertex:][: len(vertices)] = vertices
    simplified.mesh_face[first_face:][: len(faces)] = faces
    simplified.mesh_normal[first_normal:][: len(normals)] = normals
    simplified.mesh_facenormal[first_face:][: len(faces)] = corners


@functools.lru_cache(maxsize=256)
def _simplify(vertices: bytes, faces: bytes, target: int) -> tuple[int, ndarray, ndarray, ndarray, ndarray]:
    """Simplify a mesh; remembered, since renderers are made again and again of the same meshes, each in 0.2 s.

    Args:
        vertices: float32 [V, 3].
        faces: int32 [F, 3].
        target: triangles to end with.

    Returns:
        How many vertices were distinct, then the new mesh: vertices, faces, normals, and the normal of each corner.
    """
    found = np.frombuffer(vertices, np.float32).reshape(-1, 3), np.frombuffer(faces, np.int32).reshape(-1, 3)
    welded, index = np.unique(found[0], axis=0, return_inverse=True)  # simplification needs shared vertices
    fewer, triangles = fast_simplification.simplify(
        welded, index[found[1]].astype(np.int32), target_count=target, agg=_AGGRESSIVENESS
    )
    triangles = triangles[_area_vectors(fewer, triangles).any(axis=1)]  # a triangle without area has no normal
    normals, corners = corner_normals(fewer, triangles.astype(np.int64))
    return len(welded), fewer, triangles, normals, corners


def corner_normals(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]
) -> tuple[Float[ndarray, "M 3"], Int[ndarray, "F 3"]]:
    """Return unit normals and, for each corner of each face, the index of its normal.

    A corner's normal is the mean of the normals of the faces around its vertex, weighted by area, over those faces
    within the crease angle of the corner's own face.
    """
    areas = _area_vectors(vertices, faces)
    units = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-12)

    # all pairs (corner, face) that share a vertex, through faces sorted by vertex
    corner_vertex = faces.ravel()
    order = np.argsort(corner_vertex, kind="stable")
    count = np.bincount(corner_vertex, minlength=len(vertices))
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    per_corner = count[corner_vertex]
    corner = np.repeat(np.arange(faces.size), per_corner)
    within = np.arange(len(corner)) - np.repeat(np.cumsum(per_corner) - per_corner, per_corner)
    neighbour = order[start[corner_vertex[corner]] + within] // 3

    smooth = np.einsum("ij,ij->i", units[corner // 3], units[neighbour]) >= _CREASE_COSINE
    total = np.zeros((faces.size, 3))
    np.add.at(total, corner[smooth], areas[neighbour[smooth]])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    normals = np.where(length > 1e-12, total / np.maximum(length, 1e-12), units[np.arange(faces.size) // 3])
    distinct, index = np.unique(normals.round(3).astype(np.float32), axis=0, return_inverse=True)
    return distinct, index.reshape(faces.shape)


def _area_vectors(vertices: ndarray, faces: ndarray) -> Float[ndarray, "F 3"]:
    """Return the normals of triangles, twice as long as their areas."""
    corners = vertices[faces].astype(np.float64)
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
