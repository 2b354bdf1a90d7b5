"""The ball that cameras are fitted to: around what an arm handles, with cameras that look it in the face."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.cameras.rig_config import CameraConfig, RandomCameraConfig, RigConfig
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene
from nerf_rl.scenes.workspace import Workspace, opacity
from nerf_rl.scenes.workspace_fit import WorkspaceFit

HEADINGS = (0.0, 90.0, -130.0)


def arm(folder: Path, heading: float = 0.0, base: str = "", swing: float = 0.2, unused: str = "") -> Scene:
    """Return a scene of a robot of 1.4 m, whose hand is over a table with a block.

    Args:
        folder: for the model.
        heading: of the hand as seen from the base [degrees].
        base: joints of the robot's base.
        swing: of the arm, to either side [rad].
        unused: where another block lies; it is left out if that is nowhere.
    """
    path = folder / "arm.xml"
    block = '<freejoint/><geom type="box" size="0.03 0.03 0.03"/></body>'
    motor = '<motor joint="drive" gear="500"/>' if "drive" in base else ""
    path.write_text(
        f"""<mujoco><compiler angle="degree"/><worldbody><geom type="plane" size="3 3 0.1"/>
        <body name="robot" euler="0 0 {heading}">{base}
          <body name="torso"><joint name="lift" type="slide" axis="0 0 1" range="-0.02 0.02"/>
            <geom type="cylinder" size="0.2 0.7" pos="0 0 0.7" mass="50"/>
            <body name="upper_arm" pos="0 0 0.7"><joint name="pan" axis="0 0 1" range="-90 90"/>
              <geom type="capsule" fromto="0.2 0 0 0.7 0 0" size="0.03"/>
              <body name="hand" pos="0.7 0 0"><geom type="box" size="0.03 0.03 0.03"/></body></body></body>
          <body name="table" pos="0.7 0 0.25"><geom type="box" size="0.3 0.3 0.25"/></body></body>
        <body name="block" pos="{0.7 * np.cos(np.deg2rad(heading))} {0.7 * np.sin(np.deg2rad(heading))} 0.53">
          {block}{f'<body name="unused" pos="{unused}">{block}' if unused else ""}</worldbody>
        <actuator><position joint="lift" kp="5000" ctrlrange="-0.02 0.02"/>
        <position joint="pan" kp="100" kv="20" ctrlrange="-{swing} {swing}"/>{motor}</actuator></mujoco>"""
    )
    return make_scene(str(path))


@pytest.mark.parametrize("heading", HEADINGS)
def test_cameras_see_what_an_arm_handles_from_before_it(heading: float, tmp_path: Path):
    scene = arm(tmp_path, heading)
    ball, ahead = scene.workspace(), np.array([np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading))])
    assert ball.radius < 0.35  # the robot's own is 0.7 m
    np.testing.assert_allclose(ball.centre, [*(0.7 * ahead), 0.62], atol=0.1)
    assert ball.facing is not None and abs((ball.facing - heading + 180) % 360 - 180) < 8.0
    recipe = yaml.safe_load(Path("datasets/gym.yaml").read_text())["rig"]
    cameras = [
        CameraConfig(c["name"], azimuth=float(c["azimuth"]), elevation=float(c["elevation"])) for c in recipe["cameras"]
    ]
    random = RandomCameraConfig(count=40)
    for rig in (RigConfig(cameras, random=random, azimuths=recipe["azimuths"]), RigConfig(random=random)):
        places = camera_position(make_rig(rig, 32, scene).poses(scene.render_data(), np.random.default_rng(0)))
        beside = np.linalg.norm(places[:, :2], axis=1)  # of the robot's axis
        assert beside.min() > 0.3
        if rig.cameras:
            assert ((places[:, :2] - ball.centre[:2]) @ ahead > 0.0).all()
        else:  # a ring: one before it, and one behind on either side
            side = (places[:3, :2] - ball.centre[:2]) @ np.array([ahead, [-ahead[1], ahead[0]]]).T
            assert side[0, 0] > 0.3 and (side[1:, 0] < 0.0).all() and side[1, 1] * side[2, 1] < 0.0


def test_azimuths_are_the_worlds_unless_the_recipe_says_otherwise_and_where_a_point_is_given(tmp_path: Path):
    scene = arm(tmp_path, 90.0)

    def heading(azimuths: str, **place: list[float]) -> float:
        rig = make_rig(RigConfig([CameraConfig("a", azimuth=30.0, **place)], azimuths=azimuths), 32, scene)
        x, y = rig.poses(scene.render_data(), np.random.default_rng(0))[0, 2, :2]
        return float(np.rad2deg(np.arctan2(y, x)))

    assert heading("world") == pytest.approx(30.0)
    assert heading("robot") == pytest.approx(30.0 + 180.0 - 360.0, abs=8.0)  # 270 is where it faces at no turn
    assert heading("robot", lookat=[0.0, 0.0, 1.0]) == pytest.approx(30.0)


@pytest.mark.parametrize(
    "base, swing", [('<joint name="drive" type="slide" axis="1 0 0"/>', 0.2), ("<freejoint/>", 0.2), ("", 1.4)]
)
def test_all_of_a_robot_is_seen_that_drives_or_falls_or_whose_arm_swings_wide(base: str, swing: float, tmp_path: Path):
    ball = arm(tmp_path, base=base, swing=swing).workspace()
    assert ball.facing is None and ball.radius > 0.7


def test_a_marker_that_falls_while_an_environment_begins_is_not_looked_for():
    """Its environment puts it where the goal is when it draws itself, and lets it fall through all else."""
    pytest.importorskip("gymnasium_robotics")
    scene = make_scene("gym/gymnasium_robotics:HandManipulateBlock-v1")
    ball = scene.workspace()
    hand = scene.data.body("robot0:palm").xpos
    assert scene.data.body("target").xpos[2] < hand[2] - 0.5
    assert ball.radius < 0.2 and np.linalg.norm(ball.centre - hand) < ball.radius


def test_what_a_task_does_not_use_and_puts_away_is_not_looked_for(tmp_path: Path):
    """Robosuite puts it ten metres off, and cameras that saw it would show the arm as a dot."""

    def ball(unused: str) -> Workspace:
        scene = arm(tmp_path, unused=unused)
        data = mujoco.MjData(scene.model)
        mujoco.mj_forward(scene.model, data)
        fit = WorkspaceFit(scene.model, scene.parts)
        fit.add(data, True)
        return fit.workspace(data)

    alone, away, near = ball(""), ball("10 10 0.03"), ball("1.2 0.5 0.03")
    np.testing.assert_allclose([*away.centre, away.radius], [*alone.centre, alone.radius])
    assert np.linalg.norm(near.centre - [1.2, 0.5, 0.03]) < near.radius


ROOM = """<mujoco><option gravity="0 0 0"/>
<asset><material name="clear" rgba="1 0 0 0"/><material name="dim" rgba="0 1 0 0.2"/></asset>
<worldbody>
  <body name="block" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1" rgba="0 0 1 1"/></body>
  <body name="cage"><joint type="slide" axis="0 0 1"/>
    <geom type="box" size="5 5 5" contype="0" conaffinity="0" {}/></body>
</worldbody></mujoco>"""
HIDDEN = ['material="clear"', 'rgba="1 0 0 0"', 'material="dim" rgba="1 0 0 0"']
SHOWN = ['material="dim"', 'material="clear" rgba="1 0 0 0.1"', 'material="clear" rgba="0.5 0.5 0.5 0.9"']


@pytest.mark.parametrize("colour", [*HIDDEN, *SHOWN])
def test_what_is_drawn_of_no_colour_is_not_looked_for(colour: str, tmp_path: Path):
    path = tmp_path / "room.xml"
    path.write_text(ROOM.format(colour))
    scene = make_scene(str(path))
    drawn = mujoco.MjvScene(scene.model, 100)
    mujoco.mjv_updateScene(
        scene.model, scene.data, mujoco.MjvOption(), None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, drawn
    )
    by_mujoco = {geom.objid: geom.rgba[3] for geom in drawn.geoms[: drawn.ngeom]}
    np.testing.assert_allclose(opacity(scene.model), [by_mujoco.get(geom, 0.0) for geom in range(2)])
    assert (scene.workspace().radius < 1.0) == (colour in HIDDEN)
