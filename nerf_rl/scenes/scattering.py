"""Things that begin elsewhere than a reset puts them: anywhere that they can be."""

from collections.abc import Collection
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.body_parts import chain, soft_points, tied_bodies

_TRIES = 20
_DEEPEST = 2e-3  # into anything else, that a place is free [m]; what lies on a table is in it by less
_REACH = 0.8  # of the workspace's radius, so that things are in all pictures and seldom fall off a table
_HIGHEST = 0.5  # of the workspace's radius, above where they lie, for those that are turned anyhow
_PUT_AWAY = 3.0  # workspace's radii from its middle are too far for a thing that a task makes use of
_HALF_TURN = np.pi  # to either side


class Follower(NamedTuple):
    """A hinge or slide y that an equality constraint lets follow another, x: y = y0 + sum_k a_k (x - x0)^k."""

    joint: int
    leading: int
    """the other joint; -1 for one that is held where it is"""
    coefficients: Float[ndarray, "5"]

    def follow(self, model: mujoco.MjModel, qpos: Float[ndarray, "nq"]) -> None:
        """Put it where the constraint wants it, among the positions of all joints, which are changed in place."""
        own, other = model.jnt_qposadr[[self.joint, self.leading]]
        moved = qpos[other] - model.qpos0[other]
        qpos[own] = model.qpos0[own] + np.polynomial.polynomial.polyval(moved, self.coefficients)


class Scattering:
    """Puts things elsewhere: joints that the robot does not move anywhere in their range, and all in the workspace.

    A reset puts a ball here and a closed door there, and what a few episodes of a hundred do to them is all that is
    ever seen of other places. A free body lies as it does after a reset, turned around the vertical, or, as often, is
    turned anyhow and falls from a little above; one that a reset has put far away stays there, and cloth, and what is
    welded or connected to something, where it is. A joint that an equality constraint lets follow another follows it.

    Args:
        scene: whose things they are; it may be reset.
    """

    def __init__(self, scene: Scene):
        self._scene, model = scene, scene.model
        root, robot = model.body_rootid[model.jnt_bodyid], set(scene.parts.robot)
        self._joints = [joint for joint in loose_joints(model) if int(root[joint]) not in robot]
        self._followers = followers_of(model, self._joints)
        led = [follower.joint for follower in self._followers]
        movers = {int(model.jnt_bodyid[joint]) for joint in (*self._joints, *led)}
        moved = [bool(movers & set(chain(model, body))) for body in range(model.nbody)]
        self._is_thing = np.array([moved[body] for body in model.geom_bodyid], bool)
        self._workspace = scene.workspace()

    def scatter(self, rng: np.random.Generator) -> None:
        """Put the things of the scene's present state elsewhere; leave them where every place that was tried is taken.

        Their velocities stay, which are next to nothing after a reset.
        """
        scene, data = self._scene, self._scene.data
        if not self._joints:
            return
        qpos, qvel = data.qpos.copy(), data.qvel.copy()
        for _ in range(_TRIES):
            drawn = self._drawn(qpos, rng)
            scene.set_state(drawn, qvel)
            if self._is_free():
                return
        scene.set_state(qpos, qvel)

    def _drawn(self, qpos: Float[ndarray, "nq"], rng: np.random.Generator) -> Float[ndarray, "nq"]:
        """Return positions in which those of the things are drawn anew."""
        model, drawn = self._scene.model, qpos.copy()
        for joint in self._joints:
            kind, place = model.jnt_type[joint], int(model.jnt_qposadr[joint])
            if kind == mujoco.mjtJoint.mjJNT_FREE:
                drawn[place : place + 7] = self._anywhere(qpos[place : place + 7], rng)
            elif kind == mujoco.mjtJoint.mjJNT_BALL:
                drawn[place : place + 4] = _turned_anyhow(rng)
            else:
                drawn[place] = rng.uniform(*self._range(joint, qpos[place]))
        for follower in self._followers:
            follower.follow(model, drawn)
        return drawn

    def _range(self, joint: int, now: float) -> tuple[float, float]:
        """Return where a hinge or slide can be [rad or m]; the limits of some slides are far beyond all pictures."""
        model = self._scene.model
        low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.inf, np.inf)
        is_hinge = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        farthest = _HALF_TURN if is_hinge else _REACH * self._workspace.radius
        return max(low, now - farthest), min(high, now + farthest)

    def _anywhere(self, pose: Float[ndarray, "7"], rng: np.random.Generator) -> Float[ndarray, "7"]:
        """Return a place in the workspace and an orientation of a free body."""
        radius = self._workspace.radius
        angle, distance = rng.uniform(-np.pi, np.pi), _REACH * radius * np.sqrt(rng.random())
        x, y, z = self._workspace.centre_in(self._scene.render_data())
        drawn = pose.copy()
        if np.linalg.norm(pose[:3] - (x, y, z)) > _PUT_AWAY * radius:
            return drawn
        drawn[:2] = x + distance * np.cos(angle), y + distance * np.sin(angle)
        if rng.random() < 0.5:
            drawn[3:] = turned_around_vertical(pose[3:], rng)
        else:
            drawn[2] += rng.uniform(0.0, _HIGHEST * radius)
            drawn[3:] = _turned_anyhow(rng)
        return drawn

    def _is_free(self) -> bool:
        """Tell whether no thing is inside anything else, as far as MuJoCo finds contacts."""
        contacts = self._scene.data.contact
        touching = self._is_thing[contacts.geom].any(axis=1) if len(contacts.geom) else np.zeros(0, bool)
        return bool((contacts.dist[touching] > -_DEEPEST).all())


def loose_joints(model: mujoco.MjModel) -> list[int]:
    """Return the joints that may be moved one by one.

    Left out are those of soft material, those between two bodies that are welded or connected to each other, and those
    that follow another joint, see :class:`Follower`. Constraints count that are active from the start.
    """
    held = soft_points(model)
    for one, other in tied_bodies(model):
        held |= set(chain(model, one)) ^ set(chain(model, other))
    led = {follower.joint for follower in _followers(model)}
    return [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) not in held and j not in led]


def followers_of(model: mujoco.MjModel, joints: Collection[int]) -> list[Follower]:
    """Return what follows some joints, or follows what does, each after what it follows."""
    found, moved, left = [], set(joints), _followers(model)
    while ready := [follower for follower in left if follower.leading in moved]:
        found += ready
        moved |= {follower.joint for follower in ready}
        left = [follower for follower in left if follower.joint not in moved]
    return found


def _followers(model: mujoco.MjModel) -> list[Follower]:
    active = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & model.eq_active0.astype(bool)
    return [
        Follower(int(model.eq_obj1id[each]), int(model.eq_obj2id[each]), model.eq_data[each, :5])
        for each in np.flatnonzero(active)
    ]


def turned_around_vertical(quaternion: Float[ndarray, "4"], rng: np.random.Generator) -> Float[ndarray, "4"]:
    """Return an orientation that is turned around the world's vertical, by any angle."""
    half, turned = rng.uniform(-np.pi, np.pi) / 2.0, np.empty(4)
    mujoco.mju_mulQuat(turned, np.array([np.cos(half), 0.0, 0.0, np.sin(half)]), quaternion)
    return turned


def _turned_anyhow(rng: np.random.Generator) -> Float[ndarray, "4"]:
    """Return a quaternion, uniform over all orientations."""
    quaternion = rng.standard_normal(4)
    return quaternion / np.linalg.norm(quaternion)
