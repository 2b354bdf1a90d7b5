"""Smooth pictures: what is thinner than a pixel does not flicker, and labels and depth are those of MuJoCo's rays."""

import mujoco
import numpy as np
import pytest
from test_renderer import BOXES, MARKER, act_randomly, first_hit, loaded, random_cameras

from nerf_rl.cameras import geometry as cameras
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.semantics import semantic_classes
from nerf_rl.scenes.base import Scene


def test_a_smooth_pixel_is_the_mean_of_four_and_has_the_label_and_depth_of_its_centre():
    model, data = loaded(f"<geom {MARKER}/>")
    intrinsics, poses = random_cameras(np.random.default_rng(13), 2, 48, (0.0, 0.0, 0.1))
    finer = intrinsics.copy()
    finer[:, :2] *= 2
    views = {}
    for name, size, seen_by in (("smooth", 48, intrinsics), ("fast", 48, intrinsics), ("finer", 96, finer)):
        renderer = MultiViewRenderer(model, size, size, 2, "smooth" if name == "smooth" else "fast")
        views[name] = renderer.render(data, seen_by, poses)
        renderer.close()
    means = views["finer"].rgb.reshape(2, 48, 2, 48, 2, 3).mean((2, 4))
    assert np.abs(views["smooth"].rgb - means).max() <= 1  # which is rounded
    np.testing.assert_array_equal(views["smooth"].geom, views["fast"].geom)
    np.testing.assert_array_equal(views["smooth"].depth, views["fast"].depth)
    assert (np.abs(views["smooth"].rgb.astype(int) - views["fast"].rgb).max(-1) > 20).mean() > 0.01


def test_a_thing_thinner_than_a_pixel_does_not_flicker_in_smooth_pictures_as_it_moves():
    rod = '<geom type="capsule" size="0.004" fromto="{x} -0.4 0.5 {x} 0.4 0.5" rgba="1 1 1 1"/>'  # 0.4 pixels wide
    intrinsics = cameras.intrinsics_from_fovy(45.0, 48, 48)[None]
    pose = cameras.look_at(np.array([0.0, 0.0, 0.5]), 1.0, 90.0, -80.0)[None]
    flicker = {}
    for quality in ("fast", "smooth"):
        brightness = []
        for x in np.linspace(0, 0.02, 7):
            model, data = loaded(rod.format(x=x))
            renderer = MultiViewRenderer(model, 48, 48, 1, quality)
            brightness.append(renderer.render(data, intrinsics, pose).rgb.mean())
            renderer.close()
        flicker[quality] = np.std(brightness)
    assert flicker["smooth"] < 0.5 * flicker["fast"]


def rays(
    model: mujoco.MjModel, data: mujoco.MjData, intrinsics: np.ndarray, pose: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the geom [size, size] that MuJoCo's ray through each pixel's centre hits (-1: none), and its depth [m]."""
    eye = cameras.camera_position(pose)
    directions = cameras.pixel_directions(intrinsics, pose, cameras.pixel_centres(size, size))
    hits = [first_hit(model, data, eye, direction) for direction in directions]  # of unit planar depth
    geom, depth = zip(*hits, strict=True)
    return np.array(geom).reshape(size, size), np.array(depth).reshape(size, size)


@pytest.mark.parametrize("quality", ["fast", "smooth"])
def test_only_in_smooth_quality_no_background_is_labelled_in_the_gaps_of_meshes(drawer_open: Scene, quality: str):
    size, model, data = 64, drawer_open.model, drawer_open.data
    act_randomly(drawer_open, 15)
    classes = semantic_classes(model, drawer_open.parts)
    poses = np.stack(
        [cameras.look_at(np.array([0.0, 0.68, 0.2]), 1.2, *pair) for pair in [(20.0, -30.0), (90.0, -70.0)]]
    )
    intrinsics = np.stack([cameras.intrinsics_from_fovy(45.0, size, size)] * 2)
    renderer = MultiViewRenderer(model, size, size, 2, quality)
    views = renderer.render(data, intrinsics, poses)
    renderer.close()
    found = [rays(model, data, *camera, size) for camera in zip(intrinsics, poses, strict=True)]
    geom, depth = (np.stack(each) for each in zip(*found, strict=True))
    expected, seen = classes.label(geom.astype(np.int32)), classes.label(views.geom)
    robot = expected == classes.names.index("robot")
    agreement, error = (seen == expected)[robot].mean(), np.abs(views.depth - depth)[robot].mean()
    assert robot.sum() > 500
    if quality == "smooth":
        assert agreement > 0.99 and (seen == expected).mean() >= 0.999 and error < 0.1
    else:  # the background is metres behind
        assert agreement < 0.985 and error > 0.3


def test_in_smooth_quality_the_back_of_a_plane_hides_nothing_and_the_inside_of_a_mesh_is_its_own():
    corners, faces = "-1 -1 0  1 -1 0  1 1 0  -1 1 0  0 0 0.5", "0 1 4  1 2 4  2 3 4  3 0 4"
    tent = f'<asset><mesh name="shell" vertex="{corners}" face="{faces}"/></asset>'
    xml = BOXES.replace("<worldbody>", f"{tent}<worldbody>")
    body = '<body pos="0 0 -2"><geom type="mesh" mesh="shell" rgba="0.9 0.9 0.1 1" contype="0" conaffinity="0"/></body>'
    model = mujoco.MjModel.from_xml_string(xml.format(extra=body))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    size = 32
    below = cameras.look_at(np.array([0.0, 0.0, -2.0]), 2.0, 90.0, 80.0)  # up into the shell, towards the floor's back
    intrinsics = cameras.intrinsics_from_fovy(60.0, size, size)
    renderer = MultiViewRenderer(model, size, size, 1, "smooth")
    views = renderer.render(data, intrinsics[None], below[None])
    renderer.close()
    geom, depth = rays(model, data, intrinsics, below, size)
    shell = model.ngeom - 1
    assert 100 < (geom == shell).sum() < 0.95 * size**2 and not (geom == 0).any()
    assert (views.geom[0] == geom).mean() > 0.99
    both = (views.geom[0] == geom) & (geom >= 0)
    np.testing.assert_allclose(views.depth[0][both], depth[both], rtol=1e-2)
