"""From a scene's name to the environments that agents act in: observation, action repeat, time limit, processes."""

import dataclasses
import functools
import multiprocessing
import signal
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode
from numpy import ndarray

from nerf_rl.errors import UserError
from nerf_rl.machine.gl import use_one_software_thread
from nerf_rl.rl.config import PandaReachConfig
from nerf_rl.rl.environments.encoder_match import compare_scenes
from nerf_rl.rl.environments.goals import GoalTask
from nerf_rl.rl.environments.panda_reach import PANDA_REACH, PandaReach, reach_task
from nerf_rl.scenes.base import METAWORLD, Scene
from nerf_rl.scenes.make import make_scene


@dataclass(frozen=True)
class EnvSpec:
    """What decides an agent's environment; picklable, so that worker processes can build it."""

    scene: str
    """metaworld/TASK or panda/reach"""
    encoder: str | None
    """path of the encoder, or None to observe the true state"""
    action_repeat: int
    """environment steps for which an action is held"""
    episode_steps: int
    """environment steps after which an episode is truncated"""
    panda: PandaReachConfig = field(default_factory=PandaReachConfig)
    """panda/reach only"""

    @property
    def goal_task(self) -> GoalTask | None:
        """What hindsight needs to know of the task; None for scenes whose goals cannot be exchanged."""
        return reach_task(self.panda) if self.scene == PANDA_REACH else None


def spec_from_json(content: dict[str, Any]) -> EnvSpec:
    """Return the specification behind ``dataclasses.asdict(spec)``."""
    return EnvSpec(**{**content, "panda": PandaReachConfig(**content.get("panda", {}))})


class ActionRepeat(gymnasium.Wrapper):
    """Holds an action for several steps, stopping at the end of the episode.

    Rewards are summed. The information is reduced to ``success`` (at any of the steps) and ``env_steps`` (how many
    there were), which is all that crosses the border between processes.
    """

    def __init__(self, env: gymnasium.Env, repeat: int):
        super().__init__(env)
        self._repeat = repeat

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, _ = self.env.reset(seed=seed, options=options)
        return observation, {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold the action."""
        total, success, steps = 0.0, False, 0
        terminated = truncated = False
        observation: Any = None
        while steps < self._repeat and not (terminated or truncated):
            observation, reward, terminated, truncated, info = self.env.step(action)
            total += float(reward)
            success = success or bool(info.get("success", False))
            steps += 1
        return observation, total, terminated, truncated, {"success": success, "env_steps": steps}


class StateObservation(gymnasium.ObservationWrapper):
    """The environment's own observation as float32."""

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        box = env.observation_space
        assert isinstance(box, gymnasium.spaces.Box)
        # Meta-World's bounds change with the task's goal, so they cannot be compared between processes.
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, box.shape, np.float32)

    def observation(self, observation: ndarray) -> ndarray:
        """Return the same numbers as float32."""
        return observation.astype(np.float32)


def make_env(spec: EnvSpec, encoder: Any = None, device: str = "cpu") -> tuple[gymnasium.Env, Scene | None]:
    """Return an agent's environment in this process, and the MuJoCo scene behind it (None for panda/reach).

    Args:
        spec: what to build.
        encoder: the loaded encoder of ``spec.encoder``, if the caller has it already.
        device: to run the encoder on.

    Raises:
        UserError: no such scene, an episode longer than the scene allows, an encoder of another scene.
    """
    if spec.scene != PANDA_REACH and not spec.scene.startswith(METAWORLD):
        available = f"{METAWORLD}TASK, for example {METAWORLD}drawer-open-v3, and {PANDA_REACH}"
        raise UserError(f"unknown scene '{spec.scene}'; available: {available}")
    use_one_software_thread()
    scene = None if spec.scene == PANDA_REACH else _make_scene(spec)
    env: gymnasium.Env = PandaReach(spec.panda) if scene is None else scene.env
    env = ActionRepeat(gymnasium.wrappers.TimeLimit(env, spec.episode_steps), spec.action_repeat)
    if scene is None or spec.encoder is None:
        return StateObservation(env), scene
    from nerf_rl.rl.environments.observation import (
        LatentObservation,  # it loads torch, which a state worker does without
    )

    latent = LatentObservation(env, encoder or spec.encoder, scene.proprio, device)
    compare_scenes(latent.encoder.scene, spec.scene)
    return latent, scene


def check_scene(spec: EnvSpec) -> tuple[str, ...]:
    """Return the names of a scene's proprioception; raise UserError if the scene or its episode cannot be."""
    env, scene = make_env(dataclasses.replace(spec, encoder=None))
    env.close()
    return () if scene is None else scene.proprio_names


def make_vector_env(spec: EnvSpec, count: int, device: str = "cpu") -> AsyncVectorEnv:
    """Return ``count`` environments, each in a spawned process with one thread and its encoder on ``device``.

    They never reset themselves (Gymnasium's ``AutoresetMode.DISABLED``): a step always returns the true observation
    after it, also the last of an episode, and the caller starts episodes with :func:`reset_some`, seed by seed.
    """
    worker = functools.partial(make_worker_env, spec, device)
    return AsyncVectorEnv([worker] * count, context="spawn", autoreset_mode=AutoresetMode.DISABLED)


def reset_some(envs: gymnasium.vector.VectorEnv, which: ndarray, seeds: list[int]) -> ndarray:
    """Start new episodes in the environments where ``which`` [E] is true; return all observations [E, O].

    Args:
        seeds: one for each environment; those of the others are not used.
    """
    mask = np.asarray(which, dtype=np.bool_)
    seed: Any = list(seeds)  # vector environments take a list, although their base class does not say so
    observations, _ = envs.reset(seed=seed, options={"reset_mask": mask})
    return observations


def _make_scene(spec: EnvSpec) -> Scene:
    scene = make_scene(spec.scene)
    longest = getattr(scene.env.unwrapped, "max_path_length", None)
    if longest is not None and spec.episode_steps > longest:
        raise UserError(
            f"--episode_steps {spec.episode_steps} is more than the {longest} steps that {spec.scene} allows"
        )
    return scene


def make_worker_env(spec: EnvSpec, device: str = "cpu") -> gymnasium.Env:
    """Return an agent's environment in a worker process of its own, which leaves Ctrl-C to its parent."""
    if multiprocessing.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the learner's to handle; it closes the workers
        if spec.encoder is not None:
            import torch

            torch.set_num_threads(1)
    return make_env(spec, device=device)[0]
