"""Which bodies of a model are the robot, its gripper, and the surroundings, and what is placed anew in each episode."""

import re
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.scenes.workspace import drawn_geoms

_GRIPPER = re.compile(r"gripper|hand|finger|claw|jaw|effector", re.IGNORECASE)
_SURROUNDINGS = re.compile(
    r"^(floor|ground|world|arena|room|walls?|table|tablelink|desk|counter|bench|mount|pedestal|stand|sky|lights?)"
    r"([_-]?(top|base|legs?|link|body|\d+))*$",
    re.IGNORECASE,
)
_ARM_JOINTS = 3  # at least, from an arm's base to its hand
_FINGER_JOINTS = 5  # at most, in each finger; an arm has more


class BodyParts(NamedTuple):
    """Ids of bodies, of which what is below a body belongs to it, and of geoms."""

    robot: tuple[int, ...] = ()
    """roots of the trees that are moved by actuators, or led by a mocap body"""
    gripper: tuple[int, ...] = ()
    """bodies that the robot grasps with"""
    surroundings: tuple[int, ...] = ()
    """roots of fixed trees that nothing is done with, such as a table"""
    placed: tuple[int, ...] = ()
    """geoms that no joint moves and that stand elsewhere in each episode all the same, such as a target's"""


def find_parts(model: mujoco.MjModel) -> BodyParts:
    """Return the parts of any model.

    Trees with an actuator are robots, and so are those that a weld or a connection ties to a mocap body: many arms are
    led by their hand. Within them, the bodies nearest to the root with a name of a gripper (hand,
    finger, ...) are grippers; of an arm without such names it is the body where its chain of joints branches into
    fingers. Fixed trees with a name of furniture or of a room's parts are surroundings.
    """
    driven = actuated_bodies(model) | {led for led, _ in _led_and_leading(model)}
    robot = sorted({int(model.body_rootid[body]) for body in driven} - {0})
    gripper: list[int] = []
    for body in range(1, model.nbody):  # parents come before children
        inside = int(model.body_rootid[body]) in robot and body not in robot
        if inside and _GRIPPER.search(model.body(body).name) and not set(chain(model, body)) & set(gripper):
            gripper.append(body)
    if not gripper:
        gripper = [hand for root in robot if (hand := _hand(model, root))]
    moved = {int(model.body_rootid[body]) for body in range(1, model.nbody) if model.body_jntnum[body]}
    roots = {int(model.body_rootid[body]) for body in range(1, model.nbody)}
    surroundings = sorted(root for root in roots - moved if _SURROUNDINGS.match(model.body(root).name))
    return BodyParts(tuple(robot), tuple(gripper), tuple(surroundings))


def named_parts(model: mujoco.MjModel, robot: str, gripper: str, surroundings: tuple[str, ...]) -> BodyParts:
    """Return the parts with these names, as far as the model has them."""

    def ids(*names: str) -> tuple[int, ...]:
        found = (mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in names)
        return tuple(body for body in found if body >= 0)

    return BodyParts(ids(robot), ids(gripper), ids(*surroundings))


def short_name(name: str) -> str:
    """Return a body's name without what tells nothing: a last ``_link``, or the slash of what is attached."""
    return name.rstrip("/").removesuffix("_link")


def chain(model: mujoco.MjModel, body: int) -> list[int]:
    """Return a body and its ancestors up to the root of its tree, without the world."""
    links = []
    while body:
        links.append(body)
        body = int(model.body_parentid[body])
    return links


def actuated_bodies(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the bodies that actuators act on."""
    bodies: set[int] = set()
    for actuator in range(model.nu):
        target, kind = int(model.actuator_trnid[actuator, 0]), model.actuator_trntype[actuator]
        if kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT):
            bodies.add(int(model.jnt_bodyid[target]))
        elif kind in (mujoco.mjtTrn.mjTRN_SITE, mujoco.mjtTrn.mjTRN_SLIDERCRANK):
            bodies.add(int(model.site_bodyid[target]))
        elif kind == mujoco.mjtTrn.mjTRN_BODY:
            bodies.add(target)
        elif kind == mujoco.mjtTrn.mjTRN_TENDON:
            first = int(model.tendon_adr[target])
            for wrap in range(first, first + int(model.tendon_num[target])):
                thing = int(model.wrap_objid[wrap])
                if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                    bodies.add(int(model.jnt_bodyid[thing]))
                elif model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_SITE:
                    bodies.add(int(model.site_bodyid[thing]))
    return bodies


def _led_and_leading(model: mujoco.MjModel) -> list[tuple[int, int]]:
    pairs: list[tuple[int, int]] = []
    for tied in tied_bodies(model):
        for led, leading in (tied, tied[::-1]):
            root = int(model.body_rootid[leading])
            if model.body_mocapid[root] >= 0 > model.body_mocapid[model.body_rootid[led]]:
                pairs.append((led, root))
    return pairs


def tied_bodies(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Return the ids of the bodies that are welded or connected to each other, by pairs; one may be the world, 0."""
    pairs: list[tuple[int, int]] = []
    for constraint in range(model.neq):
        ties = model.eq_type[constraint] in (mujoco.mjtEq.mjEQ_WELD, mujoco.mjtEq.mjEQ_CONNECT)
        if not (ties and model.eq_active0[constraint]):
            continue
        one, other = int(model.eq_obj1id[constraint]), int(model.eq_obj2id[constraint])
        if model.eq_objtype[constraint] == mujoco.mjtObj.mjOBJ_SITE:
            one, other = int(model.site_bodyid[one]), int(model.site_bodyid[other])
        pairs.append((one, other))
    return pairs


def _hand(model: mujoco.MjModel, root: int) -> int:
    """Return the body at which an arm that stands on its root branches into fingers; 0 if there is none.

    Makers name the parts of their grippers as they like (a Robotiq's are base, driver, coupler, follower and pad).
    """
    joints = np.zeros(model.nbody, np.int64)  # of a body and all that is below it
    for body in range(model.nbody - 1, 0, -1):  # children come after parents
        joints[body] += model.body_jntnum[body]
        joints[model.body_parentid[body]] += joints[body]
    hand, before = root, int(model.body_jntnum[root])
    while len(branches := [child for child in np.flatnonzero(model.body_parentid == hand) if joints[child]]) == 1:
        hand = int(branches[0])
        before += int(model.body_jntnum[hand])
    fingers = branches and all(joints[branch] <= _FINGER_JOINTS for branch in branches)
    return hand if fingers and before >= _ARM_JOINTS and not can_travel(model, root) else 0


def can_travel(model: mujoco.MjModel, body: int) -> bool:
    """Tell whether a body moves by a joint without limits that carries it away."""
    first = int(model.body_jntadr[body])
    carrying = (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_SLIDE)
    joints = range(first, first + int(model.body_jntnum[body]))
    return any(model.jnt_type[joint] in carrying and not model.jnt_limited[joint] for joint in joints)


def soft_points(model: mujoco.MjModel) -> set[int]:
    """Return the ids of the bodies that are each a point of cloth or of what else is soft, and carry nothing more.

    Their joints are the material's: moved one by one, they tear it. A body that points are pinned to has others below
    it, and what is called a flex and is rigid has all of its points on one body.
    """
    points = np.concatenate([model.flex_vertbodyid, model.flex_nodebodyid])
    alone = np.flatnonzero(np.bincount(points[points >= 0], minlength=model.nbody) == 1)
    return set(alone.tolist()) - set(model.geom_bodyid.tolist()) - set(model.body_parentid.tolist())


class PlacedGeoms:
    """Finds what no joint moves and an environment puts elsewhere in each episode all the same, such as a target.

    Compares where geoms without joints stand at the beginnings of episodes.

    Environments write a place into their model (``body_pos``, ``geom_pos``) or into ``mocap_pos``. Surroundings are
    left out, such as a table whose height differs, and so are mocap bodies that lead the robot.

    Args:
        model: of the scene.
        parts: its robot and its surroundings.

    Attributes:
        model: the same.
    """

    def __init__(self, model: mujoco.MjModel, parts: BodyParts):
        self.model = model
        without = {*parts.robot, *parts.surroundings, *(leading for _, leading in _led_and_leading(model))}
        self._geoms = [
            geom
            for geom in drawn_geoms(model)
            if model.geom_rbound[geom] > 0
            and model.body_weldid[model.geom_bodyid[geom]] == 0
            and int(model.body_rootid[model.geom_bodyid[geom]]) not in without
        ]
        self._places: list[Float[ndarray, "G 12"]] = []

    def add(self, shown: mujoco.MjData) -> None:
        """Take the state in which an episode begins, with positions propagated."""
        places = shown.geom_xpos[self._geoms], shown.geom_xmat[self._geoms]
        self._places.append(np.concatenate(places, axis=1))

    def found(self) -> tuple[int, ...]:
        """Return the geoms that did not stand in one place in all of them."""
        elsewhere = (np.stack(self._places) != self._places[0]).any(axis=(0, 2))
        return tuple(geom for geom, moved in zip(self._geoms, elsewhere, strict=True) if moved)


def placed_name(model: mujoco.MjModel, geom: int) -> str:
    """Return what such a geom is called: as the root of its tree, or by its own name in the world."""
    root = int(model.body_rootid[model.geom_bodyid[geom]])
    if root:
        return short_name(model.body(root).name) or f"fixture_{root}"
    return model.geom(geom).name or f"object_{geom}"
