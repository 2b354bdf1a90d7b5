"""Culling: what is left out would not have been seen, and pictures are the same without it."""

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras import geometry as cameras
from nerf_rl.rendering.culling import FrustumCulling
from nerf_rl.rendering.near_plane import near_plane
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.scenes.base import Scene

SIZE = 64


def loaded(bodies: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a floor with a light above it and some more bodies, positions propagated."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco>
          <statistic extent="2" center="0 0 0"/>
          <worldbody>
            <light pos="0 0 3" dir="0 0 -1" directional="true"/>
            <geom type="plane" size="5 5 0.1" rgba="0.6 0.6 0.6 1"/>
            {bodies}
          </worldbody>
        </mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def random_cameras(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return intrinsics and poses of cameras around the table, some so close that much is out of view."""
    rng = np.random.default_rng(seed)
    intrinsics = np.stack([cameras.intrinsics_from_fovy(rng.uniform(20, 70), SIZE, SIZE) for _ in range(count)])
    poses = [
        cameras.look_at(
            np.array([0.0, 0.6, 0.2]) + rng.uniform(-0.4, 0.4, 3),
            rng.uniform(0.15, 1.2),
            rng.uniform(0, 360),
            rng.uniform(-80, 20),
        )
        for _ in range(count)
    ]
    return intrinsics, np.stack(poses)


def draw_everything(culling: FrustumCulling, data: mujoco.MjData, intrinsics: np.ndarray, poses: np.ndarray):
    return np.zeros((len(intrinsics), len(data.geom_xpos)), bool)


def test_pictures_are_those_of_drawing_everything(drawer_open: Scene, monkeypatch: pytest.MonkeyPatch):
    data, views = drawer_open.data, 16
    renderer = MultiViewRenderer(drawer_open.model, SIZE, SIZE, views, "plain")
    left_out = 0
    for state in range(3):
        drawer_open.env.reset(seed=state)
        intrinsics, poses = random_cameras(state, views)
        culled = renderer.render(data, intrinsics, poses)
        left_out += int(FrustumCulling(drawer_open.model, SIZE, SIZE, 0.01).outside(data, intrinsics, poses).sum())
        with monkeypatch.context() as patch:
            patch.setattr(FrustumCulling, "outside", draw_everything)
            patch.setattr(
                "nerf_rl.rendering.renderer._shown", lambda labels, geoms: np.ones((len(labels), geoms), bool)
            )
            everything = renderer.render(data, intrinsics, poses)
        for mine, whole in zip(culled, everything, strict=True):
            np.testing.assert_array_equal(mine, whole)
    renderer.close()
    assert left_out > 0.5 * 3 * views * (drawer_open.model.geom_group < 3).sum()


def test_a_box_at_the_corner_of_a_view_is_judged_by_its_own_shape_not_by_a_sphere():
    """A long thin mesh passes the view's corner: its sphere is in view, its box crosses no side plane wholly."""
    points = "-1 -.01 -.01  1 -.01 -.01  1 .01 -.01  -1 .01 -.01  -1 -.01 .01  1 -.01 .01  1 .01 .01  -1 .01 .01"
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><mesh name="rod" vertex="{points}"/></asset><worldbody>
          <geom name="corner" type="mesh" mesh="rod" pos="0.48 0.48 1" euler="0 0 -45"/>
          <geom name="across" type="mesh" mesh="rod" pos="0.35 0.35 1" euler="0 0 -45"/>
        </worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    intrinsics = cameras.intrinsics_from_fovy(45.0, SIZE, SIZE)  # at 1 m it sees 0.41 m to each side
    outside = FrustumCulling(model, SIZE, SIZE, 0.01).outside(data, intrinsics[None], np.eye(4)[None])[0]
    assert outside.tolist() == [True, False]


def test_what_stands_behind_glass_is_drawn():
    glass = '<geom type="box" pos="0 0 0.5" size="0.3 0.3 0.02" rgba="0.2 0.2 0.9 0.4"/>'
    ball = '<geom type="sphere" pos="0 0 0.2" size="0.1" rgba="1 0 0 1"/>'
    pose = cameras.look_at(np.array([0.0, 0.0, 0.2]), 0.9, 90.0, -89.0)[None]
    intrinsics = cameras.intrinsics_from_fovy(30.0, SIZE, SIZE)[None]
    seen = []
    for bodies in (glass, glass + ball):
        model, data = loaded(bodies)
        renderer = MultiViewRenderer(model, SIZE, SIZE, 1)
        seen.append(renderer.render(data, intrinsics, pose))
        renderer.close()
    np.testing.assert_array_equal(seen[0].geom, seen[1].geom)  # the glass hides the ball's label
    centre = (0, SIZE // 2, SIZE // 2)
    assert seen[1].rgb[centre][1] < seen[0].rgb[centre][1] - 20  # and lets its red through, which is no grey


def test_in_full_quality_what_is_out_of_view_still_casts_its_shadow():
    pose = cameras.look_at(np.array([0.0, 0.0, 0.0]), 0.5, 90.0, -60.0)[None]
    intrinsics = cameras.intrinsics_from_fovy(30.0, SIZE, SIZE)[None]
    brightness = []
    for bodies in ("", '<geom type="box" pos="0 0 1.5" size="0.5 0.5 0.1"/>'):
        model, data = loaded(bodies)
        renderer = MultiViewRenderer(model, SIZE, SIZE, 1, "full")
        brightness.append(renderer.render(data, intrinsics, pose).rgb.mean())
        renderer.close()
    assert brightness[1] < brightness[0] - 10


@pytest.mark.parametrize("quality", ["fast", "smooth"])
def test_what_moves_is_not_cut_off_by_the_near_plane_of_a_large_model(quality: str):
    """On a ground of 60 m, a ball is seen from 0.4 m as on one of 2 m, and its depth is what a ray measures."""
    pose = cameras.look_at(np.array([0.0, 0.0, 0.1]), 0.4, 30.0, -30.0)
    intrinsics = cameras.intrinsics_from_fovy(45.0, SIZE, SIZE)
    seen = []
    for half in (1, 30):
        model = mujoco.MjModel.from_xml_string(
            f"""<mujoco><worldbody><light pos="0 0 3"/>
              <geom type="box" size="{half} {half} 0.5" pos="0 0 -0.5"/>
              <body pos="0 0 0.1"><freejoint/><geom size="0.1" rgba="1 0 0 1"/></body>
            </worldbody></mujoco>"""
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        renderer = MultiViewRenderer(model, SIZE, SIZE, 1, quality)
        seen.append(renderer.render(data, intrinsics[None], pose[None]))
        renderer.close()
        usual = model.vis.map.znear * model.stat.extent
        assert near_plane(model) == usual if half == 1 else near_plane(model) < 0.01 < 0.4 < usual
    assert (seen[0].geom == 1).mean() > 0.1
    np.testing.assert_array_equal(seen[1].geom == 1, seen[0].geom == 1)
    np.testing.assert_allclose(seen[1].depth[0, SIZE // 2, SIZE // 2], 0.3, atol=2e-3)
    same = (seen[0].geom >= 0) & (seen[0].geom == seen[1].geom)  # the large ground goes on behind the small one's end
    np.testing.assert_allclose(seen[1].depth[same], seen[0].depth[same], atol=1e-4)


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder", "ellipsoid", "box"])
def test_what_has_been_made_larger_is_drawn_as_large_as_it_is(kind: str):
    """Boxes of the compiled model are those of the sizes it was compiled with."""
    model, data = loaded(f'<geom type="{kind}" pos="0 0 0.3" size="0.02 0.02 0.02" rgba="1 0 0 1"/>')
    model.geom_size[1] = 0.3, 0.25, 0.2
    mujoco.mj_forward(model, data)
    away = cameras.look_at(np.array([0.55, 0.0, 0.3]), 0.6, 90.0, 0.0)  # the geom's middle is out of view
    intrinsics = cameras.intrinsics_from_fovy(75.0, SIZE, SIZE)
    renderer = MultiViewRenderer(model, SIZE, SIZE, 1, "plain")
    seen = renderer.render(data, intrinsics[None], away[None])
    renderer.close()
    fresh, other = loaded(f'<geom type="{kind}" pos="0 0 0.3" size="0.3 0.25 0.2" rgba="1 0 0 1"/>')
    renderer = MultiViewRenderer(fresh, SIZE, SIZE, 1, "plain")
    expected = renderer.render(other, intrinsics[None], away[None])
    renderer.close()
    assert 0.01 < (expected.geom == 1).mean() < 0.5
    np.testing.assert_array_equal(seen.geom, expected.geom)
