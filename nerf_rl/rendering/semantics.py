"""Semantic classes of geoms: from the body tree, or from a recipe's patterns."""

import colorsys
import re
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Int, UInt8
from numpy import ndarray

from nerf_rl.errors import UserError
from nerf_rl.rendering.class_config import ClassConfig, RobotLinks
from nerf_rl.scenes.body_parts import BodyParts, chain, placed_name, short_name
from nerf_rl.scenes.workspace import drawn_geoms

BACKGROUND = "background"
_ROBOT, _GRIPPER = "robot", "gripper"
_MOST_CLASSES = 255


@dataclass(frozen=True)
class SemanticClasses:
    """Class names and the class of each geom; class 0 is the background."""

    names: tuple[str, ...]
    geom_class: UInt8[ndarray, "G"]
    """class id of each geom, and last, reached by geom id -1, that of the background"""

    def label(self, geom: Int[ndarray, "*S"]) -> UInt8[ndarray, "*S"]:
        """Return the class ids of geom ids (-1: nothing hit)."""
        return self.geom_class[geom]


def semantic_classes(
    model: mujoco.MjModel,
    parts: BodyParts,
    patterns: Sequence[ClassConfig] = (),
    robot_links: RobotLinks = "together",
) -> SemanticClasses:
    """Sort the geoms of a model into classes.

    The first pattern found in a geom's path decides. Otherwise geoms below a gripper are *gripper*, others below a
    robot *robot*; a body that moves by a joint of its own is a class of its own with what is fixed to it; what is fixed
    in the same tree (a cabinet around a drawer) is a class by its body's name; a fixed tree that can be seen (a shelf)
    is a class by its root's name; surroundings and what belongs to no body are background. What an environment places
    anew in each episode is none, whatever it belongs to: it has its body's name, or the geom's own in the world. What
    moves and has no name, in something that is seen itself or holds more, is ``object_`` and its body's id; a thing
    that is called as another class, such as *robot*, has ``_object`` behind its name.

    Args:
        model: compiled.
        parts: which bodies are robots, grippers and surroundings, and what is placed.
        patterns: classes by pattern.
        robot_links: ``apart``: a robot's bodies that move by joints of their own are classes, like any other body;
            ``apart_if_alone``: only where nothing moves but robots, and they have no gripper.

    Raises:
        UserError: a pattern is no regular expression or matches no geom, or there are more than 255 classes.
    """
    expressions = [_compile(pattern) for pattern in patterns]
    automatic = _AutomaticClasses(model, parts, robot_links)
    names = [BACKGROUND]
    geom_class = np.zeros(model.ngeom + 1, np.uint8)
    matched, before = set(), dict[int, str]()  # patterns that had a geom, and which class took one from the others
    for geom in range(model.ngeom):
        path = geom_path(model, geom)
        matching = [i for i, expression in enumerate(expressions) if expression.search(path)]
        if not matching:
            name = automatic.name(int(model.geom_bodyid[geom]))
            if name == BACKGROUND and geom in parts.placed:
                name = placed_name(model, geom)
        else:
            name = patterns[matching[0]].name
            matched.add(matching[0])
            before |= dict.fromkeys(matching[1:], name)
        if name not in names:
            names.append(name)
        if len(names) > _MOST_CLASSES:
            raise UserError(f"more than {_MOST_CLASSES} semantic classes; group them by patterns in 'classes'")
        geom_class[geom] = names.index(name)
    for i, pattern in enumerate(patterns):
        if i in before and i not in matched:
            raise UserError(
                f"class '{pattern.name}': all geoms that match '{pattern.pattern}' belong to classes before it in "
                f"'classes', such as '{before[i]}'; put it first"
            )
        if i not in matched:
            paths = sorted({geom_path(model, geom) for geom in range(model.ngeom)})
            raise UserError(
                f"class '{pattern.name}': no geom matches '{pattern.pattern}'; available: {', '.join(paths)}"
            )
    return SemanticClasses(tuple(names), geom_class)


def geom_path(model: mujoco.MjModel, geom: int) -> str:
    """Return the names of the bodies from the world down to the geom, then its mesh or own name, joined by slashes."""
    parts = []
    body = int(model.geom_bodyid[geom])
    while body:
        parts.append(model.body(body).name)
        body = int(model.body_parentid[body])
    is_mesh = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH
    own = model.geom(geom).name or (model.mesh(int(model.geom_dataid[geom])).name if is_mesh else "")
    return "/".join([*reversed(parts), own])


def palette(count: int) -> UInt8[ndarray, "count 3"]:
    """Return distinct colours for classes: grey for the background, then hues a golden angle apart."""
    colours = [(0.35, 0.35, 0.35)]
    colours += [colorsys.hsv_to_rgb((0.02 + 0.618034 * i) % 1.0, 0.75, 0.95) for i in range(count - 1)]
    return (np.array(colours[:count]) * 255).round().astype(np.uint8)


def _compile(pattern: ClassConfig) -> re.Pattern[str]:
    try:
        return re.compile(pattern.pattern)
    except re.error as error:
        raise UserError(f"class '{pattern.name}': '{pattern.pattern}' is no regular expression ({error})") from error


class _AutomaticClasses:
    """Names the class of a body by where it stands in the tree."""

    def __init__(self, model: mujoco.MjModel, parts: BodyParts, robot_links: RobotLinks):
        self._model, self._parts = model, parts
        self._movable = {int(model.body_rootid[body]) for body in range(1, model.nbody) if model.body_jntnum[body]}
        self._drawn = {int(model.geom_bodyid[geom]) for geom in drawn_geoms(model)}
        self._seen = {int(model.body_rootid[body]) for body in self._drawn}
        self._with_geoms = {model.body(int(body)).name for body in model.geom_bodyid}
        alone = self._movable <= set(parts.robot) and not parts.gripper
        self._links_apart = robot_links == "apart" or (robot_links == "apart_if_alone" and alone)
        of_robot = {_ROBOT: parts.robot, _GRIPPER: parts.gripper}
        self._taken = {BACKGROUND, *(name for name, bodies in of_robot.items() if bodies)}

    def name(self, body: int) -> str:
        """Return the name of a body's class."""
        model, root = self._model, int(self._model.body_rootid[body])
        links = chain(model, body)
        moved_by = [link for link in links if model.body_jntnum[link]][:1]
        if set(links) & set(self._parts.gripper):
            return _GRIPPER
        if set(links) & set(self._parts.robot):
            if self._links_apart and moved_by:
                return self._first_name(moved_by) or f"link_{moved_by[0]}"
            return _ROBOT
        if not body or root in self._parts.surroundings:
            return BACKGROUND
        if root in self._movable:
            return self._told_apart(self._movable_name(links, moved_by))
        if root not in self._seen or model.body_mocapid[root] >= 0:
            return BACKGROUND
        name = self._first_name(links[::-1]) or f"fixture_{root}"
        return name if name == BACKGROUND else self._told_apart(name)  # who calls a wall that means it

    def _movable_name(self, links: list[int], moved_by: list[int]) -> str:
        """Return the name of a body that moves or of what is fixed in such a tree.

        What moves and has no name is called as what is around it, unless that is around anything else.

        Args:
            links: the body and its ancestors.
            moved_by: the first of them that has a joint, if one has.
        """
        together = links[: links.index(moved_by[0]) + 1] if moved_by else links
        name = self._first_name([*moved_by, *together])
        if name or not moved_by:
            return name or f"object_{links[-1]}"
        around = next((link for link in links if self._model.body(link).name), links[-1])
        chains = [chain(self._model, body) for body in self._drawn]
        if any(around in other and moved_by[0] not in other for other in chains):
            return f"object_{moved_by[0]}"
        return self._first_name([around]) or f"object_{around}"

    def _told_apart(self, name: str) -> str:
        """Return a thing's name, with an end if a class of another kind is called so."""
        return f"{name}_object" if name in self._taken else name

    def _first_name(self, links: list[int]) -> str:
        """Return the first name of some bodies, shortened, unless another body is called so."""
        names = (self._model.body(link).name for link in links)
        name = next((name for name in names if name), "")
        short = short_name(name)
        return name if short in self._with_geoms else short
