"""Simplified meshes: shape and creases survive, and nothing but the copy changes."""

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.rendering.level_of_detail import corner_normals, simplify_meshes
from nerf_rl.rendering.renderer import MultiViewRenderer

MESH_ARRAYS = ("mesh_vert", "mesh_face", "mesh_normal", "mesh_facenormal")
MESH_COUNTS = ("mesh_vertnum", "mesh_facenum", "mesh_normalnum")

DETAIL = 1.8  # pixels of a metre for each row of the image: a camera 0.7 m away


def cube(cells: int, half_edge: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and outward faces of a cube whose sides are grids of squares."""
    grid = np.linspace(-half_edge, half_edge, cells + 1)
    vertices, faces = [], []
    for axis in range(3):
        for side in (-1, 1):
            first = len(vertices)
            for u in grid:
                for v in grid:
                    point = np.zeros(3)
                    point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3] = side * half_edge, u, v
                    vertices.append(point)
            for i in range(cells):
                for j in range(cells):
                    a = first + i * (cells + 1) + j
                    b, c, d = a + cells + 1, a + cells + 2, a + 1
                    faces += [(a, b, c), (a, c, d)] if side > 0 else [(a, c, b), (a, d, c)]
    return welded(np.array(vertices), np.array(faces))


def sphere(cells: int, radius: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Return a cube of many squares, blown up into a sphere."""
    vertices, faces = cube(cells)
    return radius * vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def welded(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh with one vertex for each place."""
    _, first, index = np.unique(vertices.round(9), axis=0, return_index=True, return_inverse=True)
    return vertices[first], index.reshape(-1)[faces]


def compiled(*meshes: tuple[np.ndarray, np.ndarray]) -> mujoco.MjModel:
    """Return a model that holds some meshes."""
    assets, geoms = "", ""
    for i, (vertices, faces) in enumerate(meshes):
        numbers = [" ".join(map(str, array.ravel().tolist())) for array in (vertices, faces)]
        assets += f'<mesh name="m{i}" vertex="{numbers[0]}" face="{numbers[1]}"/>'
        geoms += f'<geom type="mesh" mesh="m{i}"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco><asset>{assets}</asset><worldbody>{geoms}</worldbody></mujoco>")


def drawn(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the triangles of a mesh [F, 3, 3], the normals at their corners [F, 3, 3] and the distinct normals."""
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    normals = model.mesh_normal[model.mesh_normaladr[mesh] :][: model.mesh_normalnum[mesh]]
    rows = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    return vertices[model.mesh_face[rows]], normals[model.mesh_facenormal[rows]], normals


def test_a_simplified_cube_has_six_flat_sides_at_right_angles():
    model = compiled(cube(14))
    simplified = simplify_meshes(model, 64, DETAIL * 64)
    assert simplified.mesh_facenum[0] < 0.5 * model.mesh_facenum[0]
    triangles, corners, normals = drawn(simplified, 0)
    assert len(normals) == 6
    cosines = np.abs(normals @ normals.T)
    np.testing.assert_allclose(np.minimum(cosines, 1 - cosines), 0.0, atol=2e-3)
    area = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert np.linalg.norm(area, axis=1).sum() / 2 == pytest.approx(6 * 0.1**2, rel=1e-3)
    flat = area / np.linalg.norm(area, axis=1, keepdims=True)
    np.testing.assert_allclose(np.einsum("fk,fck->fc", flat, corners), 1.0, atol=2e-3)


def test_normals_of_a_simplified_sphere_point_outwards():
    model = compiled(sphere(24))
    simplified = simplify_meshes(model, 192, DETAIL * 192)
    assert simplified.mesh_facenum[0] < 0.35 * model.mesh_facenum[0]
    triangles, corners, _ = drawn(simplified, 0)
    outwards = triangles / np.linalg.norm(triangles, axis=-1, keepdims=True)
    angles = np.rad2deg(np.arccos(np.clip((outwards * corners).sum(-1), -1, 1)))
    assert angles.max() < 10 and angles.mean() < 3
    np.testing.assert_allclose(np.linalg.norm(triangles, axis=-1), 0.05, rtol=0.05)


def test_edges_are_creased_and_gentle_bends_are_smooth():
    for angle, distinct in ((20.0, 1), (60.0, 2)):
        bend = np.deg2rad(angle)
        vertices = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [np.cos(bend), 0, np.sin(bend)]])
        faces = np.array([[0, 1, 2], [1, 0, 3]])
        normals, corners = corner_normals(vertices, faces)
        at_the_edge = {int(corners[0, 0]), int(corners[0, 1]), int(corners[1, 0]), int(corners[1, 1])}
        assert len(at_the_edge) == distinct
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=2e-3)


def test_the_simulated_model_is_not_touched():
    model = compiled(sphere(24))
    before = {name: getattr(model, name).copy() for name in (*MESH_ARRAYS, *MESH_COUNTS)}
    simplified = simplify_meshes(model, 32, DETAIL * 32)
    assert simplified.mesh_facenum[0] < model.mesh_facenum[0]
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(model, name), value, err_msg=name)


def test_a_mesh_keeps_within_its_own_part_of_the_arrays():
    model = compiled(sphere(24), cube(2), cube(14))
    simplified = simplify_meshes(model, 48, DETAIL * 48)
    assert simplified.mesh_facenum[0] < model.mesh_facenum[0] and simplified.mesh_facenum[2] < model.mesh_facenum[2]
    for mine, theirs in zip(drawn(simplified, 1), drawn(model, 1), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    for name in MESH_COUNTS:
        assert (getattr(simplified, name) <= getattr(model, name)).all(), name
    for mesh in range(3):
        rows = slice(simplified.mesh_faceadr[mesh], simplified.mesh_faceadr[mesh] + simplified.mesh_facenum[mesh])
        assert simplified.mesh_face[rows].max() < simplified.mesh_vertnum[mesh]
        assert simplified.mesh_facenormal[rows].max() < simplified.mesh_normalnum[mesh]


@pytest.mark.parametrize("texture", [False, True])
def test_coordinates_of_a_texture_matter_where_there_is_one(texture: bool):
    """Files of meshes often have such coordinates, and materials of one colour: all of robosuite's robots."""
    vertices, faces = sphere(24)
    numbers = [" ".join(map(str, array.ravel().tolist())) for array in (vertices, faces, vertices[:, :2])]
    mesh = '<mesh name="m" vertex="{}" face="{}" texcoord="{}"/>'.format(*numbers)
    image = '<texture name="t" type="2d" builtin="checker" width="8" height="8" rgb1="1 0 0" rgb2="0 0 1"/>'
    map_ = 'texture="t"' if texture else ""
    material = f'<material name="c" rgba="0.9 0.1 0.1 1" {map_}/>'
    light, geom = '<light pos="0 -1 1" dir="0 1 -1"/>', '<geom type="mesh" mesh="m" material="c"/>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><asset>{image}{material}{mesh}</asset><worldbody>{light}{geom}</worldbody></mujoco>"
    )
    assert model.mesh_texcoordnum[0] > 0
    simplified = simplify_meshes(model, 96, DETAIL * 96)
    assert (simplified.mesh_facenum[0] == model.mesh_facenum[0]) == texture
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = intrinsics_from_fovy(45.0, 96, 96)[None], look_at(np.zeros(3), 0.25, -60.0, -30.0)[None]
    seen = []
    for quality in ("plain", "fast"):
        renderer = MultiViewRenderer(model, 96, 96, 1, quality, DETAIL * 96)
        seen.append(renderer.render_rgb(data, *camera).astype(int))
        renderer.close()
    assert np.ptp(seen[0][..., 0]) > 60
    assert np.abs(seen[0] - seen[1]).mean() < 1.5


def test_larger_images_keep_more_triangles_and_large_enough_ones_all():
    model = compiled(sphere(24))
    counts = [int(simplify_meshes(model, height, DETAIL * height).mesh_facenum[0]) for height in (192, 256, 384, 4096)]
    assert counts[0] < counts[1] < counts[2] < counts[3] == model.mesh_facenum[0]


def test_a_nearer_camera_gets_more_triangles():
    model = compiled(sphere(24))
    counts = [int(simplify_meshes(model, 32, detail).mesh_facenum[0]) for detail in (500.0, 800.0, 1200.0)]
    assert counts == sorted(set(counts))


def test_spheres_that_are_drawn_keep_their_divisions_and_cylinders_alone_do_not():
    divisions = []
    for other in ('type="cylinder" size="1 1"', 'type="sphere" size="1" group="4"', 'type="sphere" size="1"'):
        geoms = f'<geom type="cylinder" size="1 1"/><geom {other}/>'
        model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
        quality = simplify_meshes(model, 64, DETAIL * 64).vis.quality
        divisions.append((quality.numslices, quality.numstacks))
    stock = (model.vis.quality.numslices, model.vis.quality.numstacks)
    assert divisions[2] == stock
    assert divisions[0] == divisions[1] < stock
