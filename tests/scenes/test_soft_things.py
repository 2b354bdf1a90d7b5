"""Cloth, which is made of many bodies: no reset tears it, and its points are no things of their own."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from nerf_rl.scenes.body_parts import find_parts, soft_points
from nerf_rl.scenes.make import make_scene
from nerf_rl.scenes.scattering import Scattering
from nerf_rl.scenes.state_columns import StateColumns

CLOTH = """<mujoco><worldbody><geom type="plane" size="1 1 0.1"/>
<body name="rail" pos="0 0 0.5"><joint name="rail" type="slide" axis="1 0 0" range="-0.3 0.3"/>{bob}
  <flexcomp name="cloth" type="grid" count="4 4 1" spacing="0.05 0.05 0.05" radius="0.01" mass="0.1" dim="2" {dof}>
    <pin id="0"/><contact selfcollide="none" internal="false"/></flexcomp></body>
<body name="block" pos="0.4 0 0.05"><freejoint/><geom type="box" size="0.05 0.05 0.05"/></body>
</worldbody>{rest}</mujoco>"""
BOB = '<geom size="0.02"/>'
WEIGHT = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
MOTOR = '<actuator><motor joint="rail"/></actuator>'


def stretch(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return how long each edge of the cloth is, as a share of what it was made for."""
    mujoco.mj_forward(model, data)
    return data.flexedge_length / model.flexedge_length0


@pytest.mark.parametrize("scattered", [False, True])
def test_cloth_is_whole_wherever_an_episode_begins(scattered: bool, tmp_path: Path):
    path = tmp_path / "cloth.xml"
    path.write_text(CLOTH.format(bob=BOB, dof="", rest=""))
    scene, rng = make_scene(str(path)), np.random.default_rng(0)
    rails, blocks, scattering = [], [], Scattering(scene)
    for seed in range(4):
        scene.env.reset(seed=seed)
        if scattered:
            scattering.scatter(rng)
        np.testing.assert_allclose(stretch(scene.model, scene.data), 1.0, atol=1e-3)
        rails.append(scene.data.body("rail").xpos[0])
        blocks.append(scene.data.body("block").xpos[0])
    assert np.ptp(rails) > 0.01 and np.ptp(blocks) > 0.01


@pytest.mark.parametrize("rest, proprio", [("", ()), (MOTOR, ("rail", "rail_velocity"))])
def test_points_of_cloth_have_no_columns(rest: str, proprio: tuple[str, ...]):
    model = mujoco.MjModel.from_xml_string(CLOTH.format(bob=BOB, dof="", rest=rest))
    columns = StateColumns(model, find_parts(model))
    assert columns.proprio_names == proprio
    assert {name[:-2] for name in columns.privileged_names} == ({"block"} if proprio else {"block", "rail"})


@pytest.mark.parametrize(
    "bob, dof, points",
    [
        (BOB, "", 15),
        (WEIGHT, "", 15),  # what a point is pinned to may have no geom
        (BOB, 'rigid="true"', 0),
        (WEIGHT, 'rigid="true"', 0),
    ],
)
def test_what_points_are_pinned_to_is_no_point(bob: str, dof: str, points: int):
    model = mujoco.MjModel.from_xml_string(CLOTH.format(bob=bob, dof=dof, rest=""))
    found = soft_points(model)
    assert len(found) == points and not found & {0, model.body("rail").id, model.body("block").id}


def test_the_nodes_between_which_something_soft_is_interpolated_are_points():
    text = CLOTH.format(bob=BOB, dof='dof="trilinear"', rest="").replace("4 4 1", "4 4 4").replace('dim="2"', 'dim="3"')
    model = mujoco.MjModel.from_xml_string(text.replace('<pin id="0"/>', ""))
    assert len(soft_points(model)) == 8
