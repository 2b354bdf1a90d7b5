"""Semantic classes: from the body tree, or from patterns."""

import mujoco
import numpy as np
import pytest

from nerf_rl.datasets.config import ClassConfig
from nerf_rl.datasets.scenes import Scene
from nerf_rl.datasets.semantics import geom_path, palette, semantic_classes
from nerf_rl.errors import UserError

CABINET = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="lamp"><geom name="shade" size="0.1"/></body>
    <body name="cabinet">
      <geom name="case" size="0.1"/>
      <body name="door"><joint/><geom name="panel" size="0.1"/><body name="knob"><geom name="ball"
      size="0.1"/></body></body>
    </body>
    <body name="ball_link"><freejoint/><geom size="0.1"/></body>
    <body name="base"><geom name="foot" size="0.1"/><body name="arm"><joint/><geom name="link" size="0.1"/>
      <body name="hand"><geom name="palm" size="0.1"/></body></body></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def cabinet() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(CABINET)


def class_of(model: mujoco.MjModel, *arguments, **named) -> dict[str, str]:
    """Return the class name of each geom path."""
    classes = semantic_classes(model, *arguments, **named)
    return {geom_path(model, geom): classes.names[classes.geom_class[geom]] for geom in range(model.ngeom)}


def test_classes_follow_from_the_body_tree(cabinet: mujoco.MjModel):
    assert class_of(cabinet, "base", "hand") == {
        "floor": "background",
        "lamp/shade": "background",
        "cabinet/case": "cabinet",
        "cabinet/door/panel": "door",
        "cabinet/door/knob/ball": "door",
        "ball_link/": "ball",
        "base/foot": "robot",
        "base/arm/link": "robot",
        "base/arm/hand/palm": "gripper",
    }


def test_drawer_open_has_robot_gripper_case_and_drawer(drawer_open: Scene):
    model = drawer_open.model
    classes = semantic_classes(model, drawer_open.robot_body, drawer_open.gripper_body)
    assert sorted(classes.names) == ["background", "drawer", "drawercase", "gripper", "robot"]
    assert classes.names[0] == "background"
    for geom in range(model.ngeom):
        name, path = classes.names[classes.geom_class[geom]], geom_path(model, geom)
        assert (name == "drawer") == ("drawer_link" in path)
        assert (name == "gripper") == ("/right_hand/" in path)
        assert (name == "robot") == (path.startswith("base/") and "/right_hand/" not in path)
        assert (name == "drawercase") == ("drawercase_link" in path and "drawer_link" not in path)


def test_the_first_matching_pattern_decides_before_the_tree(cabinet: mujoco.MjModel):
    patterns = [ClassConfig("knob", "knob/ball$"), ClassConfig("furniture", "^(cabinet|lamp)/")]
    classes = class_of(cabinet, "base", "hand", patterns=patterns)
    assert classes["cabinet/door/knob/ball"] == "knob"
    assert classes["cabinet/door/panel"] == classes["lamp/shade"] == "furniture"
    assert classes["base/arm/link"] == "robot"


def test_a_pattern_may_put_geoms_into_the_background(cabinet: mujoco.MjModel):
    classes = semantic_classes(cabinet, "base", "hand", [ClassConfig("background", "cabinet/case")])
    assert classes.names.count("background") == 1 and "cabinet" not in classes.names
    assert classes.geom_class[cabinet.geom("case").id] == 0


def test_a_pattern_without_a_match_is_answered_with_the_paths(cabinet: mujoco.MjModel):
    with pytest.raises(UserError, match=r"class 'window': no geom matches 'glass'; available: .*cabinet/door/panel"):
        semantic_classes(cabinet, None, None, [ClassConfig("window", "glass")])


def test_a_broken_pattern_is_named(cabinet: mujoco.MjModel):
    with pytest.raises(UserError, match=r"class 'door': '\(' is no regular expression"):
        semantic_classes(cabinet, None, None, [ClassConfig("door", "(")])


def test_labels_are_looked_up_by_geom_and_nothing_hit_is_background(cabinet: mujoco.MjModel):
    classes = semantic_classes(cabinet, "base", "hand")
    geoms = np.arange(-1, cabinet.ngeom, dtype=np.int32).reshape(2, -1)
    expected = [0 if geom < 0 else classes.geom_class[geom] for geom in geoms.ravel()]
    labels = classes.label(geoms)
    np.testing.assert_array_equal(labels.ravel(), expected)
    assert labels.shape == geoms.shape and labels.dtype == np.uint8 and labels[0, 0] == 0


def test_colours_of_classes_differ_visibly():
    colours = palette(12).astype(int)
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=-1) + 1e3 * np.eye(12)
    assert distances.min() > 20
    np.testing.assert_array_equal(palette(3), colours[:3])
