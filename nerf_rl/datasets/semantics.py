"""Semantic classes of geoms: from the body tree, or from a recipe's patterns."""

import colorsys
import re
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Int, UInt8
from numpy import ndarray

from nerf_rl.datasets.config import ClassConfig
from nerf_rl.errors import UserError

BACKGROUND = "background"
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
    model: mujoco.MjModel, robot_body: str | None, gripper_body: str | None, patterns: Sequence[ClassConfig] = ()
) -> SemanticClasses:
    """Sort the geoms of a model into classes.

    The first pattern found in a geom's path decides. Otherwise geoms below ``gripper_body`` are *gripper*, others below
    ``robot_body`` *robot*; a body that moves by a joint of its own is a class of its own with what is fixed to it; what
    is fixed in the same tree (a cabinet around a drawer) is a class by its body's name; all else is background.

    Raises:
        UserError: a pattern is no regular expression or matches no geom.
    """
    expressions = [_compile(pattern) for pattern in patterns]
    movable_trees = {int(model.body_rootid[body]) for body in range(1, model.nbody) if model.body_jntnum[body]}
    names = [BACKGROUND]
    geom_class = np.zeros(model.ngeom + 1, np.uint8)
    matched = set()
    for geom in range(model.ngeom):
        path = geom_path(model, geom)
        found = next((i for i, expression in enumerate(expressions) if expression.search(path)), None)
        if found is None:
            name = _automatic_class(model, int(model.geom_bodyid[geom]), robot_body, gripper_body, movable_trees)
        else:
            name = patterns[found].name
            matched.add(found)
        if name not in names:
            names.append(name)
        if len(names) > _MOST_CLASSES:
            raise UserError(f"more than {_MOST_CLASSES} semantic classes; group them by patterns in 'classes'")
        geom_class[geom] = names.index(name)
    for i, pattern in enumerate(patterns):
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


def _automatic_class(
    model: mujoco.MjModel, body: int, robot_body: str | None, gripper_body: str | None, movable_trees: set[int]
) -> str:
    chain = [body]  # up to the root of the tree
    while model.body_parentid[chain[-1]]:
        chain.append(int(model.body_parentid[chain[-1]]))
    names = [model.body(link).name for link in chain]
    if gripper_body in names:
        return "gripper"
    if robot_body in names:
        return "robot"
    if model.body_rootid[body] not in movable_trees:
        return BACKGROUND
    moved_by = next((link for link in chain if model.body_jntnum[link]), None)
    named = [model.body(link).name for link in (chain if moved_by is None else [moved_by, *chain])]
    return next((name for name in named if name), BACKGROUND).removesuffix("_link")
