"""Fitting a workspace to what moves, and to what is done there, in a few random episodes."""

import dataclasses

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from nerf_rl.cameras.tracking_frame import TrackingFrame
from nerf_rl.scenes.body_parts import BodyParts, can_travel, chain
from nerf_rl.scenes.workspace import Workspace, around, fit_workspace, moving_balls, moving_geoms

_LEFT_OUT = 0.02  # of where things were
_FALLS = 0.5  # downwards [m/s]
_MUCH_LARGER = 1.5  # times the radius around what an arm handles has a ball around all of it, if that is left alone
_STANDS = 0.1  # of that radius, as far as the base of such an arm may go
_BESIDE = 0.5  # of that radius, as far off as its base is from the middle, if it stands beside
_PUT_AWAY = 2.0  # times as far as an arm gets is out of its reach, wherever the table stands


class WorkspaceFit:
    """Collects states of episodes, and puts a ball around what moves in them.

    Args:
        model: of the scene.
        parts: its robot and gripper, and what is placed.
    """

    def __init__(self, model: mujoco.MjModel, parts: BodyParts):
        self._model, self._parts = model, parts
        travellers = (root for root in parts.robot if can_travel(model, root))
        self._base = next((name for root in travellers if (name := model.body(root).name)), "")
        self._frame = TrackingFrame(self._base)
        bodies = [int(model.geom_bodyid[geom]) for geom in moving_geoms(model, parts.placed)]
        self._roots = [int(model.body_rootid[body]) for body in bodies]
        grasps = [bool(set(chain(model, body)) & set(parts.gripper)) for body in bodies]
        self._is_arm = np.array([root in parts.robot for root in self._roots], np.bool_) & ~np.array(grasps, np.bool_)
        self._is_loose = np.array(
            [root not in parts.robot and can_travel(model, root) for root in self._roots], dtype=np.bool_
        )
        self._arm = int(model.body_rootid[parts.gripper[0]]) if parts.gripper else 0
        self._places: list[Float[ndarray, "G 3"]] = []
        self._origins: list[Float[ndarray, "3"]] = []
        self._stands: list[Float[ndarray, "3"]] = []
        self._begins: list[bool] = []
        self._falls: list[Bool[ndarray, "G"]] = []
        self._radii = np.zeros(0)

    def add(self, shown: mujoco.MjData, begins: bool) -> None:
        """Take a state with propagated positions, and whether an episode begins with it; the first one does."""
        places, self._radii = moving_balls(self._model, shown, self._parts.placed)
        origin = self._origin(shown)
        self._places.append(places - origin)
        self._origins.append(origin)
        self._stands.append(shown.xpos[self._arm].copy())
        self._begins.append(begins)
        if begins:
            self._falls.append(self._falling(shown))

    def workspace(self, shown: mujoco.MjData) -> Workspace:
        """Return the ball around what moves, or around what an arm handles if that is much smaller.

        A mobile robot with an arm is more than a metre high, and of a block on the table before it four pixels would be
        left in a picture that shows all of it. Cameras that see no more than hand and block are near to the robot, and
        might be behind its back or within it, so which way it faces is told, too.

        Where a robot travels, the ball goes with it horizontally, and is large enough for its ups and downs. What falls
        when each episode begins is not looked at: it is a marker that an environment puts to its place where it draws.
        Nor is a thing that is far out of an arm's reach all the time, where Robosuite puts what a task does not use.

        Args:
            shown: the state in which cameras are to be placed, with positions propagated.
        """
        if not len(self._radii):
            return fit_workspace(self._model, shown)
        stays = ~np.all(self._falls, axis=0) & ~self._put_away()
        stays = stays if stays.any() else ~stays
        ball, handled = self._around(stays), stays & ~self._is_arm
        if self._parts.gripper and handled.any():
            ball = self._around_what_is_handled(ball, self._around(handled))
        if not self._base:
            return ball
        centre, start = ball.centre + self._origin(shown), shown.body(self._base).xpos
        x, y, z = (round(float(value), 3) for value in centre - start)
        return dataclasses.replace(ball, centre=centre, floating_base=self._base, from_floating_base=(x, y, z))

    def _around(self, chosen: Bool[ndarray, "G"]) -> Workspace:
        places, radii = np.stack(self._places)[:, chosen], self._radii[chosen]
        return _around_what_stays(places, radii, self._is_loose[chosen], np.array(self._begins))

    def _around_what_is_handled(self, whole: Workspace, handled: Workspace) -> Workspace:
        """Return the smaller ball, and which way the robot faces if it stands beside, or the whole one."""
        stands = np.stack(self._stands)
        way = np.linalg.norm(stands - stands[_first_states(np.array(self._begins))], axis=-1).max()
        if way > _STANDS * handled.radius or whole.radius <= _MUCH_LARGER * handled.radius:
            return whole
        x, y = (handled.centre - (stands - np.stack(self._origins)).mean(axis=0))[:2]
        if np.hypot(x, y) <= _BESIDE * handled.radius:
            return handled
        return dataclasses.replace(handled, facing=float(np.rad2deg(np.arctan2(y, x))))

    def _put_away(self) -> Bool[ndarray, "G"]:
        """Tell which of the moving geoms are loose and nowhere near an arm that stands, in any state."""
        if self._base or not self._parts.gripper:
            return np.zeros(len(self._radii), np.bool_)
        away = np.linalg.norm(np.stack(self._places) - np.stack(self._stands)[:, None], axis=-1)
        of_robot = np.isin(self._roots, self._parts.robot)
        reach = (away + self._radii)[:, of_robot].max(initial=0.0)
        return self._is_loose & ((away - self._radii).min(axis=0) > _PUT_AWAY * reach)

    def _origin(self, shown: mujoco.MjData) -> Float[ndarray, "3"]:
        return self._frame.origin(shown.body(self._base).xpos) if self._base else np.zeros(3)

    def _falling(self, shown: mujoco.MjData) -> Bool[ndarray, "G"]:
        """Tell which of the moving geoms are loose and fall in a state."""
        model, down = self._model, np.zeros(self._model.nbody)
        for joint in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
            down[model.body_rootid[model.jnt_bodyid[joint]]] = -shown.qvel[model.jnt_dofadr[joint] + 2]
        return self._is_loose & (down[self._roots] > _FALLS)


def _around_what_stays(
    centres: Float[ndarray, "T G 3"],
    radii: Float[ndarray, "G"],
    loose: Bool[ndarray, "G"],
    begins: Bool[ndarray, "T"],
) -> Workspace:
    """Return a ball around geoms in T states, without the ways of what fell out of the scene.

    A block that slips from a hand without a floor below is metres away within a second, and cameras that saw all of its
    way would show the hand as a dot. Where loose things make the ball more than twice as large as it is with them where
    their episodes began, it is that one; but dice that are all that there is are looked for where they fall to.

    Args:
        centres, radii: as of :func:`around`.
        loose: which geoms are of bodies that may go anywhere, and no robot's.
        begins: which states are an episode's first; the first of all is one.
    """
    ball = around(centres, radii, _LEFT_OUT)
    if loose.all():
        return ball
    kept = around(np.where(loose[:, None], centres[_first_states(begins)], centres), radii, _LEFT_OUT)
    return kept if ball.radius > 2.0 * kept.radius else ball


def _first_states(begins: Bool[ndarray, "T"]) -> Int[ndarray, "T"]:
    """Return the position of the first state of each state's episode."""
    return np.flatnonzero(begins)[np.cumsum(begins) - 1]
