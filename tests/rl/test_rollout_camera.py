"""From where people look at an episode."""

from pathlib import Path

import numpy as np
import pytest

from nerf_rl.rl.rollout import _Camera
from nerf_rl.scenes.make import make_scene


def _red_pixels(folder: Path, walls: str) -> int:
    """Return how much of a red arm is seen in a room."""
    path = folder / "room.xml"
    path.write_text(
        f"""<mujoco><worldbody><light pos="0 0 3"/><body name="arm"><joint name="hinge" type="hinge" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0.1 0.3 0 0.1" size="0.03" rgba="1 0 0 1"/></body>{walls}</worldbody>
        <actuator><position joint="hinge" ctrlrange="-1 1"/></actuator></mujoco>"""
    )
    scene = make_scene(str(path))
    camera = _Camera(scene.env, scene, 64)
    scene.env.reset(seed=0)
    picture = camera.picture().astype(np.int64)
    camera.close()
    return int((picture[..., 0] > 2 * picture[..., 1] + 20).sum())


def _wall(x: float, y: float, along_x: bool) -> str:
    size = "2 0.01 2" if along_x else "0.01 2 2"
    return f'<geom type="box" pos="{x} {y} 0" size="{size}" rgba="0.5 0.5 0.5 1"/>'


def test_a_wall_before_the_usual_view_is_looked_past(tmp_path: Path):
    usual = _red_pixels(tmp_path, "")
    assert usual > 40
    for x, y, along_x in ((0.5, 0, False), (-0.5, 0, False), (0, 0.5, True), (0, -0.5, True)):
        assert _red_pixels(tmp_path, _wall(x, y, along_x)) > 0.4 * usual
    room = _wall(0.5, 0, False) + _wall(-0.5, 0, False) + _wall(0, 0.5, True) + _wall(0, -0.5, True)
    assert _red_pixels(tmp_path, room) > 0.4 * usual  # from above


@pytest.mark.parametrize("name", ["metaworld/drawer-open-v3", "gym/Reacher-v5", "gym/Ant-v5"])
def test_where_nothing_is_in_the_way_the_view_is_the_usual_one(name: str):
    """From the side a flat arm has few pixels, which is no reason to look from elsewhere."""
    scene = make_scene(name)
    camera = _Camera(scene.env, scene, 64)
    scene.env.reset(seed=0)
    camera.picture()
    assert camera._side == (25.0, -30.0)
    camera.close()
