"""Scenes of which nothing is known but the model's structure: parts, columns and cameras follow from it."""

import dataclasses
from typing import Any

from jaxtyping import Float
from numpy import ndarray

from nerf_rl.cameras.rig_config import CameraConfig, RingConfig
from nerf_rl.scenes.base import Scene, model_digest
from nerf_rl.scenes.body_parts import can_travel, find_parts
from nerf_rl.scenes.state_columns import StateColumns
from nerf_rl.scenes.workspace import Workspace, fit_workspace


class StructuredScene(Scene):
    """Base of scenes that are described by their model alone; a subclass sets ``name`` and ``env``, then calls this."""

    def __init__(self) -> None:
        self.env.reset(seed=0)
        self.parts = find_parts(self.model)
        self._columns = StateColumns(self.model, self.parts)
        self.proprio_names, self.privileged_names = self._columns.proprio_names, self._columns.privileged_names
        self._workspace = self._fit_workspace()

    def proprio(self, observation: Any) -> Float[ndarray, "P"]:
        """Return positions and velocities of the robot's joints."""
        return self._columns.proprio(self.data)

    def privileged(self, observation: Any) -> Float[ndarray, "Q"]:
        """Return positions of the robot's root, its grippers and the objects [m]."""
        return self._columns.privileged(self.render_data())

    def workspace(self) -> Workspace:
        """Return the ball around what moves, as it was after the first reset; it goes with a robot that travels."""
        return self._workspace

    def default_cameras(self) -> list[CameraConfig]:
        """Return a ring of three around the workspace."""
        return RingConfig("view").cameras()

    def provenance(self) -> dict[str, Any]:
        """Return name and versions, and the digest of the compiled model."""
        return {**super().provenance(), "model_sha256": model_digest(self.model)}

    def _fit_workspace(self) -> Workspace:
        shown = self.render_data()
        ball = fit_workspace(self.model, shown)
        roots = (root for root in self.parts.robot if can_travel(self.model, root))
        name = next((name for root in roots if (name := self.model.body(root).name)), "")
        if not name:
            return ball
        x, y, z = (round(float(value), 3) for value in ball.centre - shown.body(name).xpos)
        return dataclasses.replace(ball, floating_base=name, from_floating_base=(x, y, z))
