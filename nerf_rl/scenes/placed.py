"""What no joint moves, and an environment puts elsewhere in each episode all the same, such as a target."""

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.scenes.body_parts import BodyParts, leading_bodies, short_name
from nerf_rl.scenes.workspace import is_drawn


class PlacedGeoms:
    """Compares where geoms without joints stand at the beginnings of episodes.

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
        without = {*parts.robot, *parts.surroundings, *leading_bodies(model)}
        self._geoms = [
            geom
            for geom in range(model.ngeom)
            if is_drawn(model, geom)
            and model.geom_rbound[geom] > 0
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
