"""Rendering: pixels, labels and depth agree with the camera matrices and with MuJoCo's own ray casting."""

import itertools
from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
import torch
from torchmetrics.functional.classification import multiclass_jaccard_index

from nerf_rl.cameras import geometry as cameras
from nerf_rl.metrics import psnr_db
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.semantics import semantic_classes
from nerf_rl.scenes.base import Scene

DRAWN_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)

BOXES = """
<mujoco>
  <statistic extent="2" center="0 0 0"/>
  <visual><map znear="0.01" zfar="10"/></visual>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <geom type="plane" size="5 5 0.1" rgba="0.3 0.4 0.5 1"/>
    <geom type="box" pos="0.1 0 0.2" size="0.1 0.2 0.2" euler="10 20 30" rgba="0.8 0.2 0.2 1"/>
    <geom type="box" pos="-0.3 0.2 0.1" size="0.1 0.1 0.1" euler="0 0 50" rgba="0.2 0.8 0.2 1"/>
    {extra}
  </worldbody>
</mujoco>
"""
MARKER = 'type="sphere" pos="-0.1 -0.2 0.3" size="0.1" rgba="1 1 0 1"'


def random_cameras(
    rng: np.random.Generator, count: int, size: int, lookat: tuple[float, float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return intrinsics [count, 3, 3] and camera_from_world [count, 4, 4] of cameras around a point."""
    intrinsics = [cameras.intrinsics_from_fovy(rng.uniform(35, 55), size, size) for _ in range(count)]
    poses = [
        cameras.look_at(
            np.array(lookat) + rng.uniform(-0.1, 0.1, 3),
            rng.uniform(0.8, 1.2),
            rng.uniform(0, 360),
            rng.uniform(-75, -15),
        )
        for _ in range(count)
    ]
    return np.stack(intrinsics), np.stack(poses)


def first_hit(
    model: mujoco.MjModel, data: mujoco.MjData, origin: np.ndarray, direction: np.ndarray, without: int | None = None
) -> tuple[int, float]:
    """Return the drawn geom that a ray hits first (-1: none) and its distance in lengths of the direction.

    Args:
        without: a geom to leave out, with all of its body.
    """
    geom = np.array([-1], np.int32)
    excluded = -1 if without is None else int(model.geom_bodyid[without])
    distance = mujoco.mj_ray(model, data, origin, direction, DRAWN_GROUPS, 1, excluded, geom)
    return int(geom[0]), distance


def loaded(extra: str = "") -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the scene of boxes, positions propagated."""
    model = mujoco.MjModel.from_xml_string(BOXES.format(extra=extra))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture
def boxes() -> Iterator[tuple[mujoco.MjModel, mujoco.MjData, MultiViewRenderer]]:
    """Boxes on a plane, with a renderer of 48 pixels and 4 views."""
    model, data = loaded()
    renderer = MultiViewRenderer(model, 48, 48, 4)
    yield model, data, renderer
    renderer.close()


def act_randomly(scene: Scene, seed: int) -> None:
    """Bring the scene into a random state."""
    rng = np.random.default_rng(seed)
    scene.env.reset(seed=seed)
    for _ in range(int(rng.integers(0, 40))):
        scene.env.step(rng.uniform(-1, 1, 4).astype(np.float32))


@pytest.mark.parametrize("meshes", ["simplified", "full"])
def test_every_visible_geom_centre_is_found_under_its_own_label(drawer_open: Scene, meshes: str):
    size, views = 96, 10
    model, data = drawer_open.model, drawer_open.data
    nearest = 0.1 if meshes == "full" else 0.5  # [m]; simplified for a distance of 0.7 m
    quality = "plain" if meshes == "full" else "fast"  # plain: exactly the shapes that rays are cast at
    renderer = MultiViewRenderer(model, size, size, views, quality)
    rng = np.random.default_rng(0)
    found, missed, inside, seen = 0, [], 0, set()
    for state in range(3):
        act_randomly(drawer_open, state)
        intrinsics, poses = random_cameras(rng, views, size, (0.0, 0.6, 0.15))
        rendered = renderer.render(data, intrinsics, poses).geom
        pixels, depth = cameras.project(
            cameras.projection_matrix(intrinsics, poses), np.broadcast_to(data.geom_xpos, (views, model.ngeom, 3))
        )
        for view, geom in np.ndindex(views, model.ngeom):
            x, y = pixels[view, geom]
            if depth[view, geom] < nearest or not (1 <= x < size - 1 and 1 <= y < size - 1):
                continue
            # visible by MuJoCo's ray casting: straight from the camera to the centre, without any projection
            eye, centre = cameras.camera_position(poses[view]), data.geom_xpos[geom]
            hit, reached = first_hit(model, data, eye, centre - eye)
            if hit != geom or reached > 1:  # beyond its centre, an open mesh is hit from inside, which is not drawn
                continue
            behind, reached_behind = first_hit(model, data, eye, centre - eye, without=geom)
            if behind >= 0 and reached_behind - reached < 1e-3:  # coplanar surfaces: either may be drawn
                continue
            one_pixel = depth[view, geom] / intrinsics[view, 0, 0] * poses[view, :2, :3]
            around = [centre + i * one_pixel[0] + j * one_pixel[1] for i, j in itertools.product((-1, 0, 1), repeat=2)]
            clear = all(first_hit(model, data, eye, point - eye)[0] == geom for point in around)
            if meshes == "simplified" and not clear:
                continue
            reach = 0 if clear and meshes == "full" else 1  # an outline may pass between a centre and its pixel's
            row, column = int(y), int(x)
            labels = rendered[view, row - reach : row + reach + 1, column - reach : column + reach + 1]
            found += 1
            inside += clear
            seen.add(model.geom_bodyid[geom])
            if geom not in labels:
                missed.append((state, view, geom, labels.tolist()))
    renderer.close()
    assert not missed
    assert found > 150 and inside > 100 and len(seen) > 12


def test_the_centroid_of_a_small_spheres_pixels_is_its_projection():
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.25, 0.25, (8, 3))
    spheres = "".join(f'<geom size="0.02" pos="{x} {y} {z}"/>' for x, y, z in points)
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{spheres}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    size, count, at_once = 128, 100, 25
    renderer = MultiViewRenderer(model, size, size, at_once)
    intrinsics, poses = random_cameras(rng, count, size, (0.0, 0.0, 0.0))
    parts = [slice(first, first + at_once) for first in range(0, count, at_once)]
    labels = np.concatenate([renderer.render(data, intrinsics[part], poses[part]).geom for part in parts])
    renderer.close()
    pixels, depth = cameras.project(
        cameras.projection_matrix(intrinsics, poses), np.broadcast_to(points, (count, 8, 3))
    )
    radius = 0.02 * intrinsics[:, 0, 0, None] / depth  # [pixels]
    centres = cameras.pixel_centres(size, size)
    checked = 0
    for view, sphere in np.ndindex(count, 8):
        position = pixels[view, sphere]
        reach = radius[view, sphere] + 2
        others = np.delete(np.arange(8), sphere)
        hidden = np.linalg.norm(pixels[view, others] - position, axis=1) < radius[view, others] + reach
        if hidden.any() or (position < reach).any() or (position > size - reach).any():
            continue
        own = centres[labels[view].ravel() == sphere]
        assert len(own) >= 8
        np.testing.assert_allclose(own.mean(0), position, atol=0.5)
        checked += 1
    assert checked > 330


def test_depth_is_the_planar_distance_that_ray_casting_finds(boxes):
    model, data, renderer = boxes
    intrinsics, poses = random_cameras(np.random.default_rng(2), 4, 48, (0.0, 0.0, 0.1))
    views = renderer.render(data, intrinsics, poses)
    pixels = cameras.pixel_centres(48, 48)
    checked = 0
    for view in range(4):
        eye = cameras.camera_position(poses[view])
        directions = cameras.pixel_directions(intrinsics[view], poses[view], pixels)
        hits = [first_hit(model, data, eye, direction) for direction in directions]
        geom = np.array([hit[0] for hit in hits]).reshape(48, 48)
        distance = np.array([hit[1] for hit in hits]).reshape(48, 48)  # directions have unit planar depth
        inner = np.ones((48, 48), bool)  # away from outlines and edges, where a pixel's centre may see another face
        for axis, step in itertools.product((0, 1), (-1, 1)):
            inner &= np.roll(geom, step, axis) == geom
        inner &= (distance > 0) & (distance < 2.0)
        np.testing.assert_allclose(views.depth[view][inner], distance[inner], atol=1e-3)
        np.testing.assert_array_equal(views.geom[view][inner], geom[inner])
        checked += int(inner.sum())
    assert checked > 4000


def test_unprojected_pixels_two_metres_away_lie_within_a_millimetre_of_the_surface(boxes):
    _, data, renderer = boxes
    rng = np.random.default_rng(13)
    poses = [
        cameras.look_at(rng.uniform(-0.1, 0.1, 3), 2.0, rng.uniform(0, 360), rng.uniform(-80, -40)) for _ in range(4)
    ]
    intrinsics = np.stack([cameras.intrinsics_from_fovy(30.0, 48, 48)] * 4)
    views = renderer.render(data, intrinsics, np.stack(poses))
    checked = 0
    for view, pose in enumerate(poses):
        directions = cameras.pixel_directions(intrinsics[view], pose, cameras.pixel_centres(48, 48))
        points = cameras.camera_position(pose) + views.depth[view].reshape(-1, 1) * directions
        floor = (views.geom[view] == 0).ravel()
        np.testing.assert_allclose(points[floor, 2], 0.0, atol=1e-3)
        checked += int((floor & (np.abs(views.depth[view].ravel() - 2.0) < 0.3)).sum())
    assert checked > 3000


@pytest.mark.parametrize("quality, margin, least", [("plain", 0, 0.9999), ("fast", 2, 0.998)])
def test_labels_are_those_of_mujocos_own_segmentation(drawer_open: Scene, quality: str, margin: int, least: float):
    size, model, data = 128, drawer_open.model, drawer_open.data
    act_randomly(drawer_open, 14)
    angles = [(20.0, -30.0), (160.0, -30.0), (90.0, -70.0)]
    renderer, stock = MultiViewRenderer(model, size, size, 3, quality), mujoco.Renderer(model, size, size)
    stock.enable_segmentation_rendering()
    lookat = np.array([0.0, 0.68, 0.12])
    poses = np.stack([cameras.look_at(lookat, 0.9, *pair) for pair in angles])
    intrinsics = np.stack([cameras.intrinsics_from_fovy(float(model.vis.global_.fovy), size, size)] * 3)
    labels = renderer.render(data, intrinsics, poses).geom
    option = mujoco.MjvOption()
    option.sitegroup[:] = 0
    agree = []
    for view, (azimuth, elevation) in enumerate(angles):
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance, camera.azimuth, camera.elevation = lookat, 0.9, azimuth, elevation
        stock.update_scene(data, camera, option)
        reference = stock.render()[..., 0]
        inner = np.ones((size, size), bool)
        for rows, columns in itertools.product(range(-margin, margin + 1), repeat=2):
            inner &= np.roll(reference, (rows, columns), (0, 1)) == reference
        agree.append((labels[view] == reference)[inner])
    renderer.close()
    stock.close()
    assert np.concatenate(agree).mean() >= least
    assert len(np.concatenate(agree)) > 0.7 * labels.size


def test_where_nothing_is_hit_the_label_is_minus_one_and_the_depth_is_the_far_plane():
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='0.1'/></worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = MultiViewRenderer(model, 32, 32, 1)
    away = cameras.look_at(np.array([2.0, 0.0, 0.0]), 1.0, 0.0, 0.0)
    views = renderer.render(data, cameras.intrinsics_from_fovy(45.0, 32, 32)[None], away[None])
    renderer.close()
    assert (views.geom == -1).all()
    np.testing.assert_allclose(views.depth, renderer.far, rtol=1e-5)


def test_a_large_site_does_not_change_the_images_but_a_geom_in_its_place_does(boxes):
    _, data, renderer = boxes
    intrinsics, poses = random_cameras(np.random.default_rng(3), 4, 48, (0.0, 0.0, 0.1))
    expected = renderer.render(data, intrinsics, poses)
    for kind in ("site", "geom"):
        model, other = loaded(f"<{kind} {MARKER}/>")
        other_renderer = MultiViewRenderer(model, 48, 48, 4)
        views = other_renderer.render(other, intrinsics, poses)
        other_renderer.close()
        unchanged = [np.array_equal(mine, theirs) for mine, theirs in zip(expected, views, strict=True)]
        assert unchanged == [kind == "site"] * 3


def test_however_many_segments_a_tendon_has_the_floor_is_drawn(boxes):
    _, bare, other = boxes
    sites = "".join(f'<site name="s{i}" pos="{0.01 * i} 0 -9"/>' for i in range(1100))
    through = "".join(f'<site site="s{i}"/>' for i in range(1100))
    model, data = loaded(f"{sites}</worldbody><tendon><spatial>{through}</spatial></tendon><worldbody>")
    renderer = MultiViewRenderer(model, 48, 48, 4)
    intrinsics, poses = random_cameras(np.random.default_rng(5), 4, 48, (0.0, 0.0, 0.1))
    views, expected = renderer.render(data, intrinsics, poses), other.render(bare, intrinsics, poses)
    renderer.close()
    assert (expected.geom == 0).any()
    np.testing.assert_array_equal(views.geom, expected.geom)
    np.testing.assert_array_equal(views.rgb, expected.rgb)


@pytest.mark.parametrize("quality", ["fast", "smooth", "full"])
def test_colours_alone_are_those_of_the_complete_rendering(quality: str):
    model, data = loaded()
    renderer = MultiViewRenderer(model, 48, 48, 4, quality)
    intrinsics, poses = random_cameras(np.random.default_rng(4), 3, 48, (0.0, 0.0, 0.1))
    complete = renderer.render(data, intrinsics, poses).rgb
    np.testing.assert_array_equal(renderer.render_rgb(data, intrinsics, poses), complete)
    assert complete.std() > 10
    renderer.close()


def test_two_renderers_used_in_turn_give_what_each_gives_alone(boxes):
    _, data, renderer = boxes
    intrinsics, poses = random_cameras(np.random.default_rng(5), 4, 48, (0.0, 0.0, 0.1))
    alone = [renderer.render(data, intrinsics, poses)]
    model, other_data = loaded(f"<geom {MARKER}/>")
    other = MultiViewRenderer(model, 40, 40, 2)
    other_intrinsics, other_poses = random_cameras(np.random.default_rng(6), 2, 40, (0.0, 0.0, 0.1))
    alone.append(other.render(other_data, other_intrinsics, other_poses))
    for _ in range(2):
        in_turn = [
            renderer.render(data, intrinsics, poses),
            other.render(other_data, other_intrinsics, other_poses),
        ]
        for expected, views in zip(alone, in_turn, strict=True):
            for mine, theirs in zip(expected, views, strict=True):
                np.testing.assert_array_equal(mine, theirs)
    other.close()


def test_what_a_view_shows_does_not_depend_on_the_views_beside_it(boxes):
    _, data, renderer = boxes
    intrinsics, poses = random_cameras(np.random.default_rng(7), 4, 48, (0.0, 0.0, 0.1))
    together = renderer.render(data, intrinsics, poses)
    for view in range(4):
        single = renderer.render(data, intrinsics[view : view + 1], poses[view : view + 1])
        np.testing.assert_array_equal(together.rgb[view], single.rgb[0])
        np.testing.assert_array_equal(together.geom[view], single.geom[0])
        np.testing.assert_allclose(together.depth[view], single.depth[0], rtol=1e-5)


def test_rendering_leaves_the_model_as_it_was(boxes):
    model, data, renderer = boxes
    groups, size = model.geom_group.copy(), (model.vis.global_.offwidth, model.vis.quality.shadowsize)
    intrinsics, poses = random_cameras(np.random.default_rng(8), 1, 48, (2.0, 2.0, 0.1))  # the boxes are out of view
    renderer.render(data, intrinsics, poses)
    np.testing.assert_array_equal(model.geom_group, groups)
    assert (model.vis.global_.offwidth, model.vis.quality.shadowsize) == size


def test_more_cameras_than_the_renderer_was_made_for_are_refused(boxes):
    _, data, renderer = boxes
    intrinsics, poses = random_cameras(np.random.default_rng(9), 5, 48, (0.0, 0.0, 0.1))
    with pytest.raises(ValueError, match="made for 4 views, got 5"):
        renderer.render(data, intrinsics, poses)
    with pytest.raises(ValueError, match="made for 4 views, got 5"):
        renderer.render_rgb(data, intrinsics, poses)


def test_a_closed_renderer_says_so():
    model, data = loaded()
    renderer = MultiViewRenderer(model, 16, 16, 1)
    renderer.close()
    intrinsics, poses = random_cameras(np.random.default_rng(10), 1, 16, (0.0, 0.0, 0.1))
    with pytest.raises(RuntimeError, match="closed"):
        renderer.render(data, intrinsics, poses)


@pytest.mark.parametrize(
    "size, least_agreement, least_iou, least_psnr_db", [(64, 0.985, 0.95, 29), (128, 0.99, 0.975, 33)]
)
def test_simplified_meshes_have_the_masks_and_colours_of_the_full_ones(
    drawer_open: Scene, size: int, least_agreement: float, least_iou: float, least_psnr_db: float
):
    model, data = drawer_open.model, drawer_open.data
    act_randomly(drawer_open, 11)
    classes = semantic_classes(model, drawer_open.parts)
    around = [(20.0, -30.0), (160.0, -30.0), (90.0, -70.0), (40.0, -50.0), (130.0, -20.0), (90.0, -40.0)]
    poses = np.stack([cameras.look_at(np.array([0.0, 0.68, 0.12]), 0.9, *angles) for angles in around])
    intrinsics = np.stack([cameras.intrinsics_from_fovy(45.0, size, size)] * len(poses))
    seen = {}
    for quality in ("fast", "plain"):
        renderer = MultiViewRenderer(model, size, size, len(poses), quality)
        seen[quality] = renderer.render(data, intrinsics, poses)
        renderer.close()
    simplified, full = (classes.label(seen[quality].geom) for quality in ("fast", "plain"))
    assert (simplified == full).mean() >= least_agreement
    labels = [torch.from_numpy(ids).long() for ids in (simplified, full)]
    assert multiclass_jaccard_index(*labels, len(classes.names)) >= least_iou  # the mean over classes that are shown
    difference = (seen["fast"].rgb.astype(float) - seen["plain"].rgb) / 255
    assert psnr_db(float((difference**2).mean())) >= least_psnr_db


def test_full_quality_has_the_labels_of_full_meshes_and_casts_shadows():
    model, data = loaded()
    intrinsics, poses = random_cameras(np.random.default_rng(12), 2, 48, (0.0, 0.0, 0.1))
    views = {}
    for quality in ("fast", "full"):
        renderer = MultiViewRenderer(model, 48, 48, 2, quality)
        views[quality] = renderer.render(data, intrinsics, poses)
        renderer.close()
    np.testing.assert_array_equal(views["full"].geom, views["fast"].geom)  # there is no mesh to simplify
    np.testing.assert_allclose(views["full"].depth, views["fast"].depth, rtol=1e-5)  # the floor is divided otherwise
    floor = views["fast"].geom == 0
    assert (views["full"].rgb[floor].mean(-1) < views["fast"].rgb[floor].mean(-1) - 5).mean() > 0.02


@pytest.mark.parametrize("quality", ["fast", "smooth", "full"])
def test_a_renderer_of_colours_alone_shows_the_same_and_nothing_else(quality: str):
    model, data = loaded()
    cameras_of_two = random_cameras(np.random.default_rng(21), 2, 32, (0.0, 0.0, 0.1))
    colours, both = (MultiViewRenderer(model, 32, 32, 2, quality, None, alone) for alone in (True, False))
    np.testing.assert_array_equal(colours.render_rgb(data, *cameras_of_two), both.render(data, *cameras_of_two).rgb)
    with pytest.raises(ValueError, match="colours alone"):
        colours.render(data, *cameras_of_two)
    colours.close()
    both.close()
