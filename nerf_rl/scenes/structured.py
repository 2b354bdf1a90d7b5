"""Scenes of which nothing is known but the model's structure: parts, columns and cameras follow from it."""

import functools
from collections.abc import Iterator
from typing import Any

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import CameraConfig, RingConfig
from nerf_rl.scenes.base import Scene, model_digest
from nerf_rl.scenes.body_parts import PlacedGeoms, find_parts
from nerf_rl.scenes.state_columns import StateColumns
from nerf_rl.scenes.unit_actions import in_range
from nerf_rl.scenes.workspace import Workspace
from nerf_rl.scenes.workspace_fit import WorkspaceFit

_EPISODES, _STEPS, _HOLD = 4, 40, 10  # from which the workspace is fitted
_BEGINNINGS = 4  # of episodes, from which it is known what stands elsewhere in each


class StructuredScene(Scene):
    """Base of scenes that are described by their model alone; a subclass sets ``name`` and ``env``, then calls this."""

    def __init__(self) -> None:
        self.env.reset(seed=0)
        self.parts = find_parts(self.model)
        self.parts = self.parts._replace(placed=self._find_placed())
        self._model_digest = model_digest(self.model)  # before other episodes write into it
        self._columns = StateColumns(self.model, self.parts)
        self.proprio_names, self.privileged_names = self._columns.proprio_names, self._columns.privileged_names

    def proprio(self, observation: Any) -> Float[ndarray, "P"]:
        """Return positions and velocities of the robot's joints."""
        return self._columns.proprio(self.data)

    def privileged(self, observation: Any) -> Float[ndarray, "Q"]:
        """Return positions of the robot's root, its grippers and the objects [m]."""
        return self._columns.privileged(self.render_data())

    def workspace(self) -> Workspace:
        """Return the ball around what moves, or what an arm handles, in random episodes; it goes with what travels.

        The first call acts them and resets the environment, so it is no call for the middle of an episode; who needs no
        cameras, such as an agent on the true state, never acts them.
        """
        return self._workspace

    @functools.cached_property
    def _workspace(self) -> Workspace:
        fit = WorkspaceFit(self.model, self.parts)
        for begins, shown in self._random_states():
            fit.add(shown, begins)
        return fit.workspace(self.render_data())

    def default_cameras(self) -> list[CameraConfig]:
        """Return a ring of three around the workspace."""
        return RingConfig("view").cameras()

    def provenance(self) -> dict[str, Any]:
        """Return name and versions, and the digest of the compiled model."""
        return {**super().provenance(), "model_sha256": self._model_digest}

    def _find_placed(self) -> tuple[int, ...]:
        """Return what an environment puts elsewhere in each episode, though no joint moves it.

        The scene is then as after its first reset.
        """
        self.render_data()  # so that one model stands for all that are compiled at resets from the next one on
        self.env.reset(seed=1)
        places = PlacedGeoms(self.drawn_model, self.parts)
        places.add(self.render_data())
        for seed in range(2, _BEGINNINGS + 1):
            self.env.reset(seed=seed)
            if self.drawn_model is not places.model:
                break  # of other parts, which cannot be compared
            places.add(self.render_data())
        self.env.reset(seed=0)
        return places.found()

    def _random_states(self) -> Iterator[tuple[bool, mujoco.MjData]]:
        """Yield states of random episodes, as long as they are finite, and whether an episode begins with them.

        The scene is then as after its first reset.
        """
        rng, space = np.random.default_rng(0), self.env.action_space
        mujoco.set_mju_user_warning(lambda message: None)  # it would write MUJOCO_LOG.TXT; who acts in earnest tells
        for episode in range(_EPISODES):
            self.env.reset(seed=episode)
            yield True, self.render_data()
            for step in range(_STEPS):
                if not isinstance(space, gymnasium.spaces.Box):
                    break
                if step % _HOLD == 0:
                    action = in_range(rng.uniform(-1.0, 1.0, space.shape).astype(np.float32), space)
                _, _, terminated, truncated, _ = self.env.step(action)
                shown = self.render_data()
                if terminated or truncated or not np.isfinite(shown.geom_xpos).all():
                    break
                yield False, shown
        self.env.reset(seed=0)
