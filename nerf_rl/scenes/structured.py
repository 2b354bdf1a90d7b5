"""Scenes of which nothing is known but the model's structure: parts, columns and cameras follow from it."""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import CameraConfig, RingConfig
from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.scenes.base import Scene, model_digest
from nerf_rl.scenes.body_parts import can_travel, find_parts
from nerf_rl.scenes.state_columns import StateColumns
from nerf_rl.scenes.unit_actions import in_range
from nerf_rl.scenes.workspace import Workspace, around_what_stays, fit_workspace, moving_balls, moving_geoms

_EPISODES, _STEPS, _HOLD = 4, 40, 10  # from which the workspace is fitted
_LEFT_OUT = 0.02  # of where things were then


class StructuredScene(Scene):
    """Base of scenes that are described by their model alone; a subclass sets ``name`` and ``env``, then calls this."""

    def __init__(self) -> None:
        self.env.reset(seed=0)
        self.parts = find_parts(self.model)
        self._columns = StateColumns(self.model, self.parts)
        self.proprio_names, self.privileged_names = self._columns.proprio_names, self._columns.privileged_names

    def proprio(self, observation: Any) -> Float[ndarray, "P"]:
        """Return positions and velocities of the robot's joints."""
        return self._columns.proprio(self.data)

    def privileged(self, observation: Any) -> Float[ndarray, "Q"]:
        """Return positions of the robot's root, its grippers and the objects [m]."""
        return self._columns.privileged(self.render_data())

    def workspace(self) -> Workspace:
        """Return the ball around what moves in a few random episodes; it goes with a robot that travels.

        The first call acts them and resets the environment, so it is no call for the middle of an episode; who needs no
        cameras, such as an agent on the true state, never acts them.
        """
        return self._workspace

    @functools.cached_property
    def _workspace(self) -> Workspace:
        return self._fit_workspace()

    def default_cameras(self) -> list[CameraConfig]:
        """Return a ring of three around the workspace."""
        return RingConfig("view").cameras()

    def provenance(self) -> dict[str, Any]:
        """Return name and versions, and the digest of the compiled model."""
        return {**super().provenance(), "model_sha256": model_digest(self.model)}

    def _fit_workspace(self) -> Workspace:
        """Act at random for a few short episodes, and put a ball around what moves there.

        Where a robot travels, the ball goes with it horizontally, and is large enough for its ups and downs.
        """
        roots = (root for root in self.parts.robot if can_travel(self.model, root))
        base = next((name for root in roots if (name := self.model.body(root).name)), "")
        frame, centres, begins, radii = TrackingFrame(base), [], [], np.zeros(0)
        for begin, shown in self._random_states():
            places, radii = moving_balls(self.model, shown)
            centres.append(places - frame.origin(shown.body(base).xpos) if base else places)
            begins.append(begin)
        if not len(radii):
            return fit_workspace(self.model, self.render_data())
        ball = around_what_stays(np.stack(centres), radii, _LEFT_OUT, self._loose(), np.array(begins))
        if not base:
            return ball
        start = self.render_data().body(base).xpos
        centre = ball.centre + frame.origin(start)
        x, y, z = (round(float(value), 3) for value in centre - start)
        return dataclasses.replace(ball, centre=centre, floating_base=base, from_floating_base=(x, y, z))

    def _loose(self) -> Bool[ndarray, "G"]:
        """Tell which of the moving geoms are of bodies that may go anywhere, and no robot's."""
        roots = [int(self.model.body_rootid[self.model.geom_bodyid[geom]]) for geom in moving_geoms(self.model)]
        loose = [root not in self.parts.robot and can_travel(self.model, root) for root in roots]
        return np.array(loose, dtype=np.bool_)

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
