"""How the robot acts while a dataset is made: random, scripted, or scripted with noise and detours."""

from collections.abc import Iterator
from typing import NamedTuple

import gymnasium
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.config import BehaviourConfig
from nerf_rl.datasets.scenes import Scene
from nerf_rl.errors import UserError

_HOLD = (3, 15)  # steps for which a random action is held, so that it leads somewhere
_DETOUR_PROBABILITY = 0.03  # a step, in noisy episodes


class Moment(NamedTuple):
    """A state on the way, with the step that led to it and the action taken next."""

    step: int
    observation: Float[ndarray, "O"]
    action: Float[ndarray, "A"]
    reward: float
    success: bool


def require_behaviour(scene: Scene, config: BehaviourConfig) -> None:
    """Check that the scene can be acted as configured.

    Raises:
        UserError: a scripted behaviour is asked for and the scene has no scripted policy, or actions are no box.
    """
    if scene.scripted_policy() is None and config.scripted + config.noisy > 0:
        raise UserError(f"{scene.name} has no scripted policy; set behaviour.scripted and behaviour.noisy to 0")
    if not isinstance(scene.env.action_space, gymnasium.spaces.Box):
        raise UserError(f"{scene.name} has no continuous actions")


def act_episode(scene: Scene, config: BehaviourConfig, steps: int, rng: np.random.Generator) -> Iterator[Moment]:
    """Reset the scene and act for some steps; yield ``steps + 1`` moments, the first right after the reset.

    While a moment is held, the scene is in its state, so it can be rendered.
    """
    weights = np.array(config.weights())
    kind = rng.choice(["random", "scripted", "noisy"], p=weights / weights.sum())
    space = scene.env.action_space
    assert isinstance(space, gymnasium.spaces.Box)
    policy = scene.scripted_policy() if kind != "random" else None
    observation, _ = scene.env.reset(seed=int(rng.integers(2**31)))
    reward, success = 0.0, False
    held, held_until = np.zeros(space.shape), 0
    for step in range(steps + 1):
        if step >= held_until and (policy is None or (kind == "noisy" and rng.random() < _DETOUR_PROBABILITY)):
            held, held_until = rng.uniform(space.low, space.high), step + int(rng.integers(*_HOLD))
        if policy is None or step < held_until:
            action = held
        else:
            noise = config.noise * rng.standard_normal(space.shape) if kind == "noisy" else 0.0
            action = np.clip(policy(observation) + noise, space.low, space.high)
        action = action.astype(np.float32)
        yield Moment(step, observation, action, reward, success)
        if step < steps:
            observation, step_reward, terminated, truncated, info = scene.env.step(action)
            reward, success = float(step_reward), success or bool(info.get("success", False))
            if terminated or truncated:
                raise UserError(f"{scene.name} ended an episode after {step + 1} steps; lower --episode_steps")
