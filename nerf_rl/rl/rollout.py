"""One episode of a trained policy, step by step, with what its cameras saw."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import gymnasium
import mujoco
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position, intrinsics_from_fovy, look_at
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.environments.make import make_env
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.workspace import DRAWN_GROUPS, Workspace, moving_geoms, undrawn

_FOVY = 45.0  # of the view for people [degrees]
_AWAY = 1.1 / 0.9  # as far as a camera that just sees the workspace, and a little more
_SIDES = ((25.0, -30.0), (115.0, -30.0), (205.0, -30.0), (295.0, -30.0), (25.0, -60.0), (25.0, -85.0))
"""azimuths and elevations [degrees] to look from, the first unless a wall is in the way"""


@dataclass
class Rollout:
    """An episode of T observations and T - 1 actions between them."""

    view: UInt8[ndarray, "T S S 3"]
    """what a camera for people saw"""
    images: UInt8[ndarray, "T V H W 3"] | None
    """what the encoder's cameras saw; None for a state agent"""
    latents: Float[ndarray, "T Z"] | None
    """their latents as the encoder gives them (not standardised); None for a state agent"""
    observations: Float[ndarray, "steps O"]
    """what the policy acted on"""
    actions: Float[ndarray, "steps A"]
    rewards: Float[ndarray, "steps"]
    success: Bool[ndarray, "steps"] | None
    """at each action; None where the environment does not tell"""

    def outcome(self) -> str:
        """Return in words how the episode went: its success, if the environment tells of that, or its return."""
        if self.success is None:
            return f"return {self.rewards.sum():.4g}"
        solved = np.flatnonzero(self.success)
        return f"success at step {solved[0] + 1}" if len(solved) else "no success"


def rollout(
    run: Path | str,
    seed: int = 0,
    encoder: str = "",
    view_size: int = 256,
    policy: Policy | None = None,
    device: str = "cpu",
) -> Rollout:
    """Run one episode in this process, until its first success or its end.

    Args:
        run: a run folder of train-rl.
        seed: of the episode.
        encoder: where the encoder is now, if it has moved.
        view_size: height and width of ``view`` [pixels].
        policy: that of ``run``, if the caller has loaded it.
        device: to run the encoder on.

    Raises:
        UserError: no policy there, not its encoder, or an environment that has changed since.
    """
    policy = policy or Policy.load(Path(run), encoder)
    env, scene = make_env(policy.spec, device=device)
    policy.require_spaces(env.observation_space, env.action_space)
    observe: Any = env if policy.spec.encoder is not None else None
    camera = _Camera(env, scene, view_size)
    view: list[ndarray] = []
    images: list[ndarray] = []
    latents: list[ndarray] = []
    observations, actions, rewards = [], [], []
    success: list[bool] = []
    told = False

    def look() -> None:
        view.append(camera.picture())
        if observe is not None:
            images.append(observe.last_images)
            latents.append(observe.last_latent)

    try:
        observation, _ = env.reset(seed=seed)
        look()
        ended = False
        while not ended:
            action = policy.act(observation[None])[0]
            observations.append(observation)
            observation, reward, terminated, truncated, info = env.step(action)
            look()
            actions.append(action)
            rewards.append(float(reward))
            told = told or "success" in info
            success.append(bool(info.get("success", False)))  # some tell of it at the end alone
            ended = terminated or truncated or success[-1]
    finally:
        camera.close()
        env.close()
    return Rollout(
        np.stack(view),
        np.stack(images) if images else None,
        np.stack(latents) if latents else None,
        np.stack(observations),
        np.stack(actions),
        np.array(rewards),
        np.array(success) if told else None,
    )


class _Camera:
    """A view for people: the scene from the side, or what the environment itself renders if it has no MuJoCo scene."""

    def __init__(self, env: gymnasium.Env, scene: Scene | None, size: int):
        self._env, self._scene, self._size = env, scene, size
        self._workspace = None if scene is None else scene.workspace()  # before an episode begins
        self._renderer: MultiViewRenderer | None = (
            None  # of the model that the episode has, which may be one of its own
        )
        self._intrinsics = intrinsics_from_fovy(_FOVY, size, size)[None]
        self._side: tuple[float, float] | None = None

    def picture(self) -> UInt8[ndarray, "S S 3"]:
        """Return what it sees now."""
        if self._scene is None or self._workspace is None:
            frame: Any = self._env.render()
            height, width, _ = frame.shape
            side = min(height, width)
            top, left = (height - side) // 2, (width - side) // 2
            square = frame[top : top + side, left : left + side]
            return cv2.resize(square, (self._size, self._size), interpolation=cv2.INTER_AREA)
        data = self._scene.render_data()
        if self._renderer is None:
            self._renderer = MultiViewRenderer(self._scene.drawn_model, self._size, self._size, 1)
        if self._side is None:
            self._side = _free_side(self._scene.drawn_model, data, self._workspace)
        pose = _pose(data, self._workspace, self._side)
        return self._renderer.render_rgb(data, self._intrinsics, pose)[0]

    def close(self) -> None:
        """Release the renderer."""
        if self._renderer is not None:
            self._renderer.close()


def _free_side(model: mujoco.MjModel, data: mujoco.MjData, workspace: Workspace) -> tuple[float, float]:
    """Return the first side from which at least half as many geoms that move are in sight as from the best one."""
    moving = moving_geoms(model)
    not_in_the_way = {*moving, *np.flatnonzero(undrawn(model)).tolist()}
    drawn = (np.arange(mujoco.mjNGROUP) < DRAWN_GROUPS).astype(np.uint8)
    hit = np.zeros(1, np.int32)

    def in_sight(side: tuple[float, float]) -> int:
        eye = camera_position(_pose(data, workspace, side))[0]
        seen = 0
        for place in data.geom_xpos[moving]:
            distance = mujoco.mj_ray(model, data, eye, place - eye, drawn, 1, -1, hit)  # 1 at the place
            seen += not 0.0 <= distance < 1.0 or int(hit[0]) in not_in_the_way
        return seen

    seen = [in_sight(side) for side in _SIDES]
    return next(side for side, geoms in zip(_SIDES, seen, strict=True) if 2 * geoms >= max(seen))


def _pose(data: mujoco.MjData, workspace: Workspace, side: tuple[float, float]) -> Float[ndarray, "1 4 4"]:
    return look_at(workspace.centre_in(data), _AWAY * workspace.distance(_FOVY), *side)[None]


def film(episode: Rollout) -> UInt8[ndarray, "T height width 3"]:
    """Return the frames of a video: the view for people, and beside it, one below another, the encoder's cameras."""
    if episode.images is None:
        return episode.view
    count, views, height, width, _ = episode.images.shape
    size = episode.view.shape[1]
    tile = size // views
    rows, columns = np.arange(tile) * height // tile, np.arange(tile) * width // tile
    column = np.zeros((count, size, tile, 3), np.uint8)
    column[:, : views * tile] = episode.images[:, :, rows][:, :, :, columns].reshape(count, views * tile, tile, 3)
    return np.concatenate([episode.view, column], axis=2)
