"""Columns of the true state that a latent agent sees because its user asked for them by name, such as a goal.

Nothing of objects and goals reaches a latent agent but what cameras show. Where they cannot show it, as with the goal
of a Fetch environment, which is a marker that is not drawn, ``train-rl --observe`` lets it through.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.errors import UnknownNameError
from nerf_rl.rl.environments.goals import ACHIEVED, DESIRED
from nerf_rl.scenes.base import Scene

_AXES = ("_x", "_y", "_z")
Read = Callable[[Any], Float[ndarray, "C"]]
"""From the environment's observation to some columns of the true state."""


class ObservedColumns:
    """Some columns of a scene's true state.

    Args:
        scene: that has them.
        wanted: names of privileged columns (``goal_x``), of groups of them (``goal`` for ``goal_x``, ``goal_y`` and
            ``goal_z``), and in a goal environment ``desired_goal`` and ``achieved_goal``.

    Attributes:
        names: of the columns, in the order in which they are asked for.

    Raises:
        UnknownNameError: the scene has no such columns; it says which there are.
    """

    def __init__(self, scene: Scene, wanted: Sequence[str]):
        self._scene = scene
        groups: dict[str, list[int]] = {}
        for place, name in enumerate(scene.privileged_names):
            groups.setdefault(name, []).append(place)
            if name.endswith(_AXES):
                groups.setdefault(name[:-2], []).append(place)
        goals = _goal_sizes(scene)
        self._reads: list[Read] = []
        names: list[str] = []
        for name in dict.fromkeys(wanted):
            if name in goals:
                self._reads.append(_part(name))
                names += [f"{name}_{i}" for i in range(goals[name])]
            elif name in groups:
                self._reads.append(self._privileged(groups[name]))
                names += [scene.privileged_names[place] for place in groups[name]]
            else:
                raise UnknownNameError("column of the true state to observe", name, {*groups, *goals})
        self.names = tuple(names)

    def __call__(self, observation: Any) -> Float[ndarray, "C"]:
        """Return the columns' values now.

        Args:
            observation: of the scene's environment.
        """
        return np.concatenate([np.zeros(0), *(read(observation) for read in self._reads)])

    def _privileged(self, places: list[int]) -> Read:
        return lambda observation: self._scene.privileged(observation)[places]


def _goal_sizes(scene: Scene) -> dict[str, int]:
    """Return how many numbers each goal in a scene's observation has, if that is a dictionary with goals."""
    space = scene.env.observation_space
    parts = space.spaces if isinstance(space, Dict) else {}
    goals = {part: parts.get(part) for part in (DESIRED, ACHIEVED)}
    return {part: int(np.prod(goal.shape)) for part, goal in goals.items() if isinstance(goal, Box)}


def _part(name: str) -> Read:
    return lambda observation: np.ravel(observation[name])
