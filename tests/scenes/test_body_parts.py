"""Hands of arms whose makers named their grippers otherwise."""

import mujoco
import pytest

from nerf_rl.scenes.body_parts import find_parts, short_name

HINGE, GEOM = '<joint axis="0 1 0"/>', '<geom size="0.02"/>'


def link(name: str, *inside: str, joint: str = HINGE) -> str:
    return f'<body name="{name}" pos="0 0 0.1">{joint}{GEOM}{"".join(inside)}</body>'


def chain(name: str, length: int, *inside: str) -> str:
    """Return so many links, each in the one before."""
    links = "".join(inside)
    for number in reversed(range(length)):
        links = link(f"{name}{number}", links)
    return links


def hands(*roots: str) -> list[str]:
    """Return the names of the grippers of a model in which each joint has a motor."""
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{''.join(roots)}</worldbody></mujoco>")
    for number, joint in enumerate(spec.joints):
        joint.name = f"joint{number}"
        motor = spec.add_actuator(target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gainprm[0] = 1.0
    model = spec.compile()
    return [model.body(body).name for body in find_parts(model).gripper]


ROBOTIQ = link("base", chain("right", 2), chain("left", 2), joint="")  # driver and follower on either side


@pytest.mark.parametrize("length", [3, 7])
def test_the_hand_of_an_arm_is_where_it_branches_into_fingers(length: int):
    assert hands(chain("link", length, link("mount", ROBOTIQ, joint=""))) == ["base"]


def test_each_arm_has_its_hand():
    assert hands(chain("a", 6, ROBOTIQ), chain("b", 6, ROBOTIQ.replace('name="', 'name="b_'))) == ["base", "b_base"]


def test_a_name_tells_more_than_where_an_arm_branches():
    assert hands(chain("link", 4, link("palm", chain("right", 1), link("finger")))) == ["finger"]


@pytest.mark.parametrize(
    "robot",
    [
        chain("link", 7),  # no fingers
        chain("torso", 3, chain("right", 7), chain("left", 7)),  # arms
        link("torso", *(chain(f"leg{number}", 2) for number in range(4)), joint="<freejoint/>"),
        link("torso", *(chain(f"leg{number}", 2) for number in range(4))),  # a stand of legs
        link("cart", chain("link", 4, ROBOTIQ), joint="<freejoint/>"),  # its cameras go with it
    ],
    ids=["arm", "two arms", "walker", "standing", "mobile"],
)
def test_what_is_no_arm_with_fingers_has_no_hand(robot: str):
    assert hands(robot) == []


@pytest.mark.parametrize(
    "name, short", [("arm_link", "arm"), ("duplo2x4/", "duplo2x4"), ("a/b_link", "a/b"), ("/", "")]
)
def test_names_are_told_without_what_files_and_attachments_add(name: str, short: str):
    assert short_name(name) == short
