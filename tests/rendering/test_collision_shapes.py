"""Shapes for collisions that a model keeps where others keep what is looked at, as robosuite's do."""

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.scenes.workspace import drawn_geoms

SIZE = 48
NO_COLLISIONS = 'contype="0" conaffinity="0"'
FLOOR = '<geom name="floor" type="plane" size="2 2 0.1" group="1" rgba="0.5 0.5 0.5 1"/>'
HULL = '<geom name="hull" type="box" size="0.2 0.1 0.1" rgba="0 0.5 0 1"/>'
LOOK = f'<geom name="look" type="box" size="0.19 0.09 0.09" group="1" rgba="0.8 0.1 0.1 1" {NO_COLLISIONS}/>'
MARK = f'<geom name="mark" type="sphere" size="0.05" pos="0 0 0.1" group="1" rgba="0.8 0.1 0.1 1" {NO_COLLISIONS}/>'
FINGER = HULL.replace("hull", "finger_hull") + LOOK.replace("look", "finger_look")
PAD = '<geom name="pad" type="box" size="0.03 0.1 0.1" rgba="0 0.5 0 1"/>'


def compiled(arm: str, others: str = FINGER, floor: str = FLOOR) -> mujoco.MjModel:
    """Return a model of a floor and a chain of an arm, others beyond it, and a pad at the end."""
    end = f'<body pos="0.4 0 0">{others}<body pos="0.25 0 0">{PAD}</body></body>'
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{floor}<body pos="0 0 0.5"><joint axis="0 0 1"/>{arm}{end}</body></worldbody></mujoco>'
    )


def names(model: mujoco.MjModel) -> set[str]:
    return {model.geom(geom).name for geom in drawn_geoms(model)}


@pytest.mark.parametrize("quality", ["plain", "fast", "smooth", "full"])
def test_what_a_body_looks_like_is_seen_and_not_what_it_collides_with(quality: str):
    model = compiled(HULL + LOOK)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pose = look_at(np.array([0.3, 0.0, 0.5]), 1.5, -60.0, -30.0)[None]
    renderer = MultiViewRenderer(model, SIZE, SIZE, 1, quality)
    views = renderer.render(data, intrinsics_from_fovy(45.0, SIZE, SIZE)[None], pose)
    renderer.close()
    rgb = views.rgb.astype(int)
    assert (rgb[..., 0] > rgb[..., 1] + 40).mean() > 0.03
    assert not (rgb[..., 1] > rgb[..., 0] + 20).any()
    seen = {model.geom(int(geom)).name for geom in np.unique(views.geom) if geom >= 0}
    assert seen == {"floor", "look", "finger_look"}


def test_a_group_is_hidden_whole_or_not_at_all():
    assert names(compiled(HULL + LOOK)) == {"floor", "look", "finger_look"}  # nor the pad, which has no look of its own
    all_there = {"floor", "hull", "finger_hull", "finger_look", "pad"}
    assert names(compiled(HULL)) == all_there  # most of the group has no look of its own
    assert names(compiled(HULL + MARK)) == all_there | {"mark"}
    assert names(compiled(HULL + LOOK.replace(NO_COLLISIONS, ""))) == all_there | {"look"}
    looked_at = PAD.replace("pad", "wing").replace("/>", f" {NO_COLLISIONS}/>")
    assert names(compiled(HULL + LOOK, FINGER + looked_at)) == all_there | {"look", "wing"}
    on_the_same_floor = compiled(HULL + LOOK, floor=FLOOR.replace('group="1"', ""))
    assert names(on_the_same_floor) == {"floor", "look", "finger_look"}
