"""Semantic classes: from the body tree, or from patterns."""

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest

from nerf_rl.errors import UserError
from nerf_rl.rendering.class_config import ClassConfig, RobotLinks
from nerf_rl.rendering.semantics import geom_path, palette, semantic_classes
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.body_parts import BodyParts, find_parts, named_parts
from nerf_rl.scenes.state_columns import StateColumns

CABINET = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="table"><geom name="board" size="0.1"/></body>
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


def parts(model: mujoco.MjModel) -> BodyParts:
    return named_parts(model, "base", "hand", ("table",))


def class_of(
    model: mujoco.MjModel, parts: BodyParts, patterns: Sequence[ClassConfig] = (), robot_links: RobotLinks = "together"
) -> dict[str, str]:
    """Return the class name of each geom path."""
    classes = semantic_classes(model, parts, patterns, robot_links)
    return {geom_path(model, geom): classes.names[classes.geom_class[geom]] for geom in range(model.ngeom)}


def test_classes_follow_from_the_body_tree(cabinet: mujoco.MjModel):
    assert class_of(cabinet, parts(cabinet)) == {
        "floor": "background",
        "table/board": "background",
        "lamp/shade": "lamp",
        "cabinet/case": "cabinet",
        "cabinet/door/panel": "door",
        "cabinet/door/knob/ball": "door",
        "ball_link/": "ball",
        "base/foot": "robot",
        "base/arm/link": "robot",
        "base/arm/hand/palm": "gripper",
    }


def test_links_of_a_robot_that_move_are_classes_if_they_are_told_apart(cabinet: mujoco.MjModel):
    before, after = class_of(cabinet, parts(cabinet)), class_of(cabinet, parts(cabinet), robot_links="apart")
    assert {path: name for path, name in after.items() if name != before[path]} == {"base/arm/link": "arm"}
    assert class_of(cabinet, parts(cabinet), robot_links="apart_if_alone") == before


WALKER = """
<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>
  <body name="torso"><freejoint/><geom name="trunk" size="0.1"/>
    <body name="hip"><geom name="side" size="0.1"/>
      <body><joint name="knee"/><geom name="shin" size="0.1"/>
        <body name="{end}"><geom name="foot" size="0.1"/></body></body></body></body>
  {thing}
</worldbody><actuator><motor joint="knee"/></actuator></mujoco>
"""
BALL = '<body name="ball"><freejoint/><geom name="hide" size="0.1"/></body>'
POST = '<body name="post"><geom name="wood" size="0.1"/></body>'
TOLD_APART = {"trunk": "torso", "side": "torso", "shin": "link_3", "foot": "link_3"}
AS_ONE = dict.fromkeys(TOLD_APART, "robot")


@pytest.mark.parametrize(
    "end, thing, links, expected",
    [
        ("sole", "", "apart_if_alone", TOLD_APART),
        ("sole", "", "together", AS_ONE),
        ("sole", POST, "apart_if_alone", TOLD_APART | {"wood": "post"}),
        ("sole", BALL, "apart_if_alone", AS_ONE | {"hide": "ball"}),
        ("sole", BALL, "apart", TOLD_APART | {"hide": "ball"}),
        ("hand", "", "apart_if_alone", AS_ONE | {"foot": "gripper"}),
    ],
)
def test_links_are_told_apart_where_nothing_moves_but_a_robot_without_a_gripper(
    end: str, thing: str, links: RobotLinks, expected: dict[str, str]
):
    model = mujoco.MjModel.from_xml_string(WALKER.format(end=end, thing=thing))
    names = {
        path.rpartition("/")[2]: name for path, name in class_of(model, find_parts(model), robot_links=links).items()
    }
    assert names == {"floor": "background", **expected}


def test_a_cup_and_a_cup_link_are_two_things():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="cup"><freejoint/><geom name="a" size="0.1"/></body>
        <body name="cup_link"><freejoint/><geom name="b" size="0.1"/></body>
        <body name="pan_link"><freejoint/><geom name="c" size="0.1"/></body>
        <body name="tray"><body name="tray_link"><joint/><geom name="d" size="0.1"/></body></body>
        </worldbody></mujoco>"""
    )
    names = class_of(model, BodyParts())
    assert names == {"cup/a": "cup", "cup_link/b": "cup_link", "pan_link/c": "pan", "tray/tray_link/d": "tray"}


def test_what_moves_and_has_no_name_is_a_class_of_its_own():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="cabinet"><geom name="case" size="0.1"/>
        <body><joint/><geom name="upper" size="0.1"/><body><geom name="knob" size="0.1"/></body></body>
        <body><joint/><geom name="lower" size="0.1"/><body name="handle"><geom name="bar" size="0.1"/></body></body>
        <body><geom name="top" size="0.1"/></body></body>
        <body name="dial"><body><joint/><geom name="disc" size="0.1"/></body></body>
        <body><body><joint/><geom name="lever" size="0.1"/></body></body>
        <body><body><joint/><geom name="left" size="0.1"/></body>
        <body><joint/><geom name="right" size="0.1"/></body></body>
        </worldbody></mujoco>"""
    )
    assert {path.rpartition("/")[2]: name for path, name in class_of(model, BodyParts()).items()} == {
        **dict.fromkeys(("case", "top"), "cabinet"),
        **dict.fromkeys(("upper", "knob"), "object_2"),
        "lower": "object_4",
        "bar": "handle",
        "disc": "dial",  # a name around nothing else
        "lever": "object_9",
        "left": "object_12",
        "right": "object_13",
    }


@pytest.mark.parametrize("joint", ["<freejoint/>", ""])
def test_a_thing_by_the_name_of_another_class_joins_it_not(joint: str):
    names = ("background", "robot", "gripper")
    things = "".join(f'<body name="{name}">{joint}<geom name="{name}" size="0.1"/></body>' for name in names)
    text = CABINET.replace("</worldbody>", f"{things}</worldbody>")
    model = mujoco.MjModel.from_xml_string(text)
    found = class_of(model, parts(model))
    own = {name: found[f"{name}/{name}"] for name in names}
    behind = "background_object" if joint else "background"  # a wall is, by that name
    assert own == {"background": behind, "robot": "robot_object", "gripper": "gripper_object"}
    found = class_of(model, BodyParts())  # there is no robot
    assert [found[f"{name}/{name}"] for name in names] == [behind, "robot", "gripper"]


def test_patterns_come_before_links(cabinet: mujoco.MjModel):
    patterns = [ClassConfig("robot", "^base/arm/link")]
    assert class_of(cabinet, parts(cabinet), patterns, robot_links="apart")["base/arm/link"] == "robot"


def test_drawer_open_has_robot_gripper_case_and_drawer(drawer_open: Scene):
    model = drawer_open.model
    classes = semantic_classes(model, drawer_open.parts)
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
    classes = class_of(cabinet, parts(cabinet), patterns)
    assert classes["cabinet/door/knob/ball"] == "knob"
    assert classes["cabinet/door/panel"] == classes["lamp/shade"] == "furniture"
    assert classes["base/arm/link"] == "robot"


def test_a_pattern_may_put_geoms_into_the_background(cabinet: mujoco.MjModel):
    classes = semantic_classes(cabinet, parts(cabinet), [ClassConfig("background", "cabinet/case")])
    assert classes.names.count("background") == 1 and "cabinet" not in classes.names
    assert classes.geom_class[cabinet.geom("case").id] == 0


def test_a_pattern_without_a_match_is_answered_with_the_paths(cabinet: mujoco.MjModel):
    with pytest.raises(UserError, match=r"class 'window': no geom matches 'glass'; available: .*cabinet/door/panel"):
        semantic_classes(cabinet, BodyParts(), [ClassConfig("window", "glass")])


def test_a_pattern_whose_geoms_an_earlier_one_takes_is_answered_with_that(cabinet: mujoco.MjModel):
    patterns = [ClassConfig("lamp", "lamp"), ClassConfig("furniture", "cabinet"), ClassConfig("knob", "knob/ball$")]
    with pytest.raises(UserError, match=r"class 'knob': all geoms .* before it in 'classes', such as 'furniture'"):
        semantic_classes(cabinet, BodyParts(), patterns)


def test_a_class_has_a_name():
    with pytest.raises(UserError, match="'classes' need names"):
        ClassConfig("", "door")


def test_a_broken_pattern_is_named(cabinet: mujoco.MjModel):
    with pytest.raises(UserError, match=r"class 'door': '\(' is no regular expression"):
        semantic_classes(cabinet, BodyParts(), [ClassConfig("door", "(")])


def test_labels_are_looked_up_by_geom_and_nothing_hit_is_background(cabinet: mujoco.MjModel):
    classes = semantic_classes(cabinet, parts(cabinet))
    geoms = np.arange(-1, cabinet.ngeom - 1, dtype=np.int32).reshape(2, -1)
    expected = [0 if geom < 0 else classes.geom_class[geom] for geom in geoms.ravel()]
    labels = classes.label(geoms)
    np.testing.assert_array_equal(labels.ravel(), expected)
    assert labels.shape == geoms.shape and labels.dtype == np.uint8 and labels[0, 0] == 0


def test_colours_of_classes_differ_visibly():
    colours = palette(12).astype(int)
    distances = np.linalg.norm(colours[:, None] - colours[None], axis=-1) + 1e3 * np.eye(12)
    assert distances.min() > 20
    np.testing.assert_array_equal(palette(3), colours[:3])


def test_fixed_trees_that_cannot_be_seen_are_background_and_unnamed_ones_are_fixtures():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <body name="ghost"><geom name="a" size="0.1" group="4"/></body>
        <body name="target" mocap="true"><geom name="b" size="0.1"/></body>
        <body><geom name="c" size="0.1"/></body>
        <body><freejoint/><geom name="d" size="0.1"/></body>
        </worldbody></mujoco>"""
    )
    names = class_of(model, BodyParts())
    assert names == {"ghost/a": "background", "target/b": "background", "/c": "fixture_3", "/d": "object_4"}


def test_parts_of_an_unknown_model_follow_from_actuators_and_names():
    model = mujoco.MjModel.from_xml_path("datasets/scenes/blocks.xml")
    found = find_parts(model)
    assert [model.body(body).name for body in found.robot] == ["arm"]
    assert [model.body(body).name for body in found.gripper] == ["hand"]
    assert [model.body(body).name for body in found.surroundings] == ["table"]
    names = set(class_of(model, found).values())
    assert names == {"background", "robot", "gripper", "shelf", "red_block", "green_block", "blue_block"}


def test_tendons_sites_and_bodies_that_actuators_pull_make_a_robot_too():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody>
        <body name="by_tendon"><joint name="j"/><geom size="0.1"/></body>
        <body name="by_site"><joint/><geom size="0.1"/><site name="s"/></body>
        <body name="by_body"><joint/><geom size="0.1"/></body>
        <body name="thing"><joint/><geom size="0.1"/></body></worldbody>
        <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
        <actuator><motor tendon="t"/><motor site="s"/><adhesion body="by_body" ctrlrange="0 1"/></actuator></mujoco>"""
    )
    assert [model.body(body).name for body in find_parts(model).robot] == ["by_tendon", "by_site", "by_body"]


LED = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="1 1 1"/>
  <body name="robot0:mocap" mocap="true"/>
  <body name="robot0:base_link"><joint name="slide" type="slide"/><geom name="foot" size="0.1"/>
    <body name="robot0:shoulder_link"><joint name="shoulder"/><geom name="upper" size="0.1"/>
      <body name="robot0:elbow_link"><joint name="elbow"/><geom name="lower" size="0.1"/>
        <body name="robot0:gripper_link"><geom name="palm" size="0.1"/><site name="tip"/>
          <body name="robot0:l_finger_link"><joint name="left" type="slide"/><geom name="l" size="0.1"/></body>
          <body name="robot0:r_finger_link"><joint name="right" type="slide"/><geom name="r" size="0.1"/></body>
        </body></body></body></body>
  <body name="object0"><freejoint/><geom name="cube" size="0.1"/></body>
  <body name="door"><joint name="hinge"/><geom name="panel" size="0.1"/></body>
  </worldbody><equality>{equality}</equality>{rest}</mujoco>"""
WELD = '<weld body1="robot0:mocap" body2="robot0:gripper_link"/>'
FINGERS = '<actuator><position joint="left"/><position joint="right"/></actuator>'
SITES = """<worldbody><body name="leader" mocap="true"><site name="lead"/></body></worldbody>"""


@pytest.mark.parametrize(
    "equality, rest",
    [
        (WELD, ""),
        (WELD, FINGERS),
        ('<weld body1="robot0:gripper_link" body2="robot0:mocap"/>', ""),
        ('<connect body1="robot0:mocap" body2="robot0:elbow_link" anchor="0 0 0"/>', ""),
        ('<weld site1="lead" site2="tip"/>', SITES),
        (WELD + '<weld body1="object0" body2="door"/>', ""),
        ("", FINGERS),
    ],
)
def test_an_arm_that_is_led_by_a_mocap_body_is_one_robot_with_a_gripper(equality: str, rest: str):
    model = mujoco.MjModel.from_xml_string(LED.format(equality=equality, rest=rest))
    found = find_parts(model)
    assert [model.body(body).name for body in found.robot] == ["robot0:base_link"]
    classes = {path.rpartition("/")[2]: name for path, name in class_of(model, found).items()}
    assert classes == {
        "floor": "background",
        **dict.fromkeys(("foot", "upper", "lower"), "robot"),
        **dict.fromkeys(("palm", "l", "r"), "gripper"),
        "cube": "object0",
        "panel": "door",
    }
    columns = StateColumns(model, found)
    assert columns.proprio_names[:5] == ("slide", "shoulder", "elbow", "left", "right")
    assert {name[:-2] for name in columns.privileged_names} == {
        "robot0:base",
        "robot0:gripper",
        "object0",
        "door",
    }


@pytest.mark.parametrize(
    "equality",
    [
        '<weld body1="robot0:mocap" body2="object0" active="false"/>',
        '<weld body1="object0" body2="door"/>',
        '<joint joint1="hinge" joint2="left"/>',
    ],
)
def test_constraints_that_no_mocap_body_leads_make_no_robot(equality: str):
    assert find_parts(mujoco.MjModel.from_xml_string(LED.format(equality=equality, rest=""))).robot == ()
