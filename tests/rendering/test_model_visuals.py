"""What a model says of pictures itself, and what it shows beside geoms."""

import mujoco
import numpy as np
import pytest
from test_renderer import loaded, random_cameras

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at, project, projection_matrix
from nerf_rl.rendering.renderer import MultiViewRenderer, Views

SEE_THROUGH = """
<mujoco>
  <statistic extent="2" center="0 0 0" meansize="0.1"/>
  <visual><map znear="0.01" zfar="10"/><scale slidercrank="0.3"/><rgba slidercrank="0 0 1 0.4"/></visual>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <geom type="box" size="0.3 0.3 0.02" rgba="0.8 0.2 0.2 1"/>
    {plane}
    <site name="here" pos="-0.2 0 0.1"/>
    <body name="there" pos="0.2 0 0.1"><joint/><geom size="0.01"/><site name="there"/></body>
    {extra}
  </worldbody>
  {rest}
</mujoco>
"""
PLANE = '<geom name="plane" type="plane" pos="0.4 0.4 0" size="0.05 0.05 0.1"/>'
CLOTH = """<flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" pos="0 0 0.2" dim="2"
    rgba="0 0 1 0.4"/>"""
TENDON = """<tendon><spatial width="0.03" rgba="0 0 1 0.4"><site site="here"/><site site="there"/></spatial></tendon>"""
CRANK = """<actuator><general slidersite="here" cranksite="there" cranklength="0.5"/></actuator>"""


def views_of(model: mujoco.MjModel, data: mujoco.MjData) -> Views:
    """Return what four cameras see."""
    renderer = MultiViewRenderer(model, 48, 48, 4)
    views = renderer.render(data, *random_cameras(np.random.default_rng(5), 4, 48, (0.0, 0.0, 0.1)))
    renderer.close()
    return views


def test_cameras_are_pinholes_where_the_models_own_free_camera_is_not():
    parallel = loaded('</worldbody><visual><global orthographic="true"/></visual><worldbody>')
    for mine, theirs in zip(views_of(*loaded()), views_of(*parallel), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("extra, rest", [(CLOTH, ""), ("", TENDON), ("", CRANK)])
@pytest.mark.parametrize("leads", [False, True])
def test_what_is_seen_through_is_as_faint_beside_a_plane_as_without_one(extra: str, rest: str, leads: bool):
    """Planes are drawn last, by themselves, and whatever came a second time with them was twice as dense."""

    def views(plane: str, extra: str = extra, rest: str = rest) -> tuple[Views, int]:
        model = mujoco.MjModel.from_xml_string(SEE_THROUGH.format(plane=plane, extra=extra, rest=rest))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return views_of(model, data), mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "plane")

    (alone, _), (bare, _) = views(""), views("", "", "")
    beside, plane = views(f'<body mocap="true">{PLANE}</body>' if leads else PLANE)
    elsewhere = beside.geom != plane
    assert not elsewhere.all() and (alone.rgb != bare.rgb).any(-1).mean() > 0.005
    np.testing.assert_array_equal(beside.rgb[elsewhere], alone.rgb[elsewhere])


@pytest.mark.parametrize("quality", ["fast", "smooth", "full"])
def test_the_headlight_shines_from_one_place_for_all_cameras(quality: str):
    """A radiance field has no other way to explain what a thing looks like from all sides."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><statistic extent="2"/><visual><headlight ambient="0 0 0" diffuse="1 1 1" specular="0 0 0"/></visual>
        <worldbody><geom type="sphere" size="0.3" rgba="1 1 1 1"/></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    headings = np.deg2rad([60.0, 120.0])
    K = intrinsics_from_fovy(40.0, 96, 96)
    poses = np.stack([look_at(np.zeros(3), 1.5, np.rad2deg(heading), -30.0) for heading in headings])
    renderer = MultiViewRenderer(model, 96, 96, 2, quality)
    rgb = renderer.render(data, np.stack([K, K]), poses).rgb.astype(int)
    renderer.close()
    normals = np.array([[x, -1.0, z] for x in (-0.4, 0.0, 0.4) for z in (-0.2, 0.4, 0.9)])  # seen by both cameras
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    seen = []
    for picture, pose in zip(rgb, poses, strict=True):
        pixels, _ = project(projection_matrix(K, pose), 0.3 * normals)
        columns, rows = np.floor(pixels).astype(int).T
        seen.append(picture[rows, columns].mean(-1))
    lit = normals @ np.array([0.0, -np.sqrt(0.5), np.sqrt(0.5)])  # along azimuth 90 and elevation -45
    np.testing.assert_allclose(seen[0], seen[1], atol=12)
    np.testing.assert_allclose(np.stack(seen), np.broadcast_to(255 * lit.clip(0), (2, 9)), atol=16)
