"""How the robot acts while a dataset is made: random, scripted, with noise and detours, or as before."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.config import BehaviourConfig
from nerf_rl.datasets.generation.stored_states import StoredStates, open_states, restore_state
from nerf_rl.errors import UserError
from nerf_rl.scenes.base import Policy, Scene, success_in
from nerf_rl.scenes.scattering import Scattering
from nerf_rl.scenes.simulation import find_simulation
from nerf_rl.scenes.unit_actions import in_range

_SHORTEST_HOLD = 3  # steps for which a random action is held, so that it leads somewhere
_LONGEST_DETOUR = 14  # steps; what comes after it in a noisy episode must still have time to succeed
_DETOUR_PROBABILITY = 0.03  # a step, in noisy episodes
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
KINDS = ("random", "scripted", "noisy", "replay")


class EpisodeStep(NamedTuple):
    """A state on the way, with the step that led to it and the action taken next."""

    step: int
    """environment steps since the last reset"""
    observation: Any
    action: Float[ndarray, "A"]
    """in [-1, 1]"""
    reward: float
    success: bool
    stored: Mapping[str, ndarray] = {}
    """what is known of a replayed state, by array of a shard; it counts instead of what the scene says"""


class Behaviour:
    """How the episodes of a scene are acted.

    Args:
        scene: what acts.
        config: which behaviours, and how often.
        steps: environment steps of an episode.

    Raises:
        UserError: the scene has no scripted policy, no continuous actions, or no states to replay, and needs them.
    """

    def __init__(self, scene: Scene, config: BehaviourConfig, steps: int):
        self._scene, self._config, self._steps = scene, config, steps
        scripted = scene.scripted_policy() is not None
        if not scripted and (config.scripted or config.noisy):
            raise UserError(f"{scene.name} has no scripted policy; leave out behaviour.scripted and behaviour.noisy")
        if not isinstance(scene.env.action_space, gymnasium.spaces.Box):
            raise UserError(f"{scene.name} has no continuous actions")
        weights = np.array(config.weights(scripted))
        if weights.sum() == 0:
            raise UserError(f"{scene.name} has no scripted policy; raise behaviour.random above 0")
        self._shares = weights / weights.sum()
        self._scattering = Scattering(scene) if config.scattered else None
        self._states: StoredStates | None = None
        self._places: tuple[mujoco.MjModel, ndarray, ndarray] | None = None
        if config.replay:
            self._states = open_states(Path(config.states), scene)
            if self._states.shortest() <= steps:
                raise UserError(
                    f"{config.states} has an episode of {self._states.shortest()} states, too few for "
                    f"--episode_steps {steps}; lower that to at most {self._states.shortest() - 1}"
                )

    def act(self, episode: int, rng: np.random.Generator) -> Iterator[EpisodeStep]:
        """Reset the scene and act; yield one step more than there are steps, the first right after the reset.

        While a step is held, the scene is in its state, so it can be rendered. An environment that ends an episode
        early is reset and acted on, and steps count from there; the state that it ended in comes before the reset's.

        Args:
            episode: its number, which decides what is replayed.
            rng: decides everything else.
        """
        if self._places is not None:  # which a replayed episode moved, and not every reset puts back
            model, *places = self._places
            model.body_pos[:], model.body_quat[:] = places
        kind = rng.choice(KINDS, p=self._shares)
        if kind == "replay":
            return self._replay(episode, rng)
        return self._step(self._scene.scripted_policy() if kind != "random" else None, kind == "noisy", rng)

    def _step(self, policy: Policy | None, noisy: bool, rng: np.random.Generator) -> Iterator[EpisodeStep]:
        env, space = self._scene.env, self._scene.env.action_space
        assert isinstance(space, gymnasium.spaces.Box)
        observation = self._reset(rng)
        reward, success, over, since_reset = 0.0, False, False, 0
        held, held_until = np.zeros(space.shape), 0
        longest = self._config.longest_hold if policy is None else _LONGEST_DETOUR
        for step in range(self._steps + 1):
            if step >= held_until and (policy is None or (noisy and rng.random() < _DETOUR_PROBABILITY)):
                held = rng.uniform(-1.0, 1.0, space.shape)
                held_until = step + int(rng.integers(_SHORTEST_HOLD, longest + 1))
            if policy is None or step < held_until:
                action = held
            else:
                noise = self._config.noise * rng.standard_normal(space.shape) if noisy else 0.0
                action = np.clip(policy(observation) + noise, -1.0, 1.0)
            action = action.astype(np.float32)
            yield EpisodeStep(since_reset, observation, action, reward, success)
            if step == self._steps:
                return
            if over:  # the state that an episode ended in has been seen, and no action is taken in it
                observation = self._reset(rng)
                reward, success, over, since_reset = 0.0, False, False, 0
                policy, held_until = self._scene.scripted_policy() if policy is not None else None, 0
                continue
            observation, step_reward, terminated, truncated, info = env.step(in_range(action, space))
            self._require_stable(step + 1)
            reward, since_reset = float(step_reward), since_reset + 1
            success, over = success or bool(success_in(info)), terminated or truncated

    def _reset(self, rng: np.random.Generator) -> Any:
        """Begin an episode; return the first observation."""
        observation, _ = self._scene.env.reset(seed=int(rng.integers(2**31)))
        if self._scattering is not None and rng.random() < self._config.scattered:
            self._scattering.scatter(rng)
            observation = self._scene.observation()
        return observation

    def _replay(self, episode: int, rng: np.random.Generator) -> Iterator[EpisodeStep]:
        assert self._states is not None
        scene, states = self._scene, self._states
        scene.env.reset(seed=int(rng.integers(2**31)))
        self._places = scene.model, scene.model.body_pos.copy(), scene.model.body_quat.copy()
        still = np.zeros(scene.env.action_space.shape or (), np.float32)
        for row in states.rows(episode % states.trajectories(), self._steps + 1):
            restore_state(scene, row)
            yield EpisodeStep(int(row["step"]), scene.observation(), still, 0.0, False, row)

    def _require_stable(self, step: int) -> None:
        """Refuse what MuJoCo has given up on: it warns on values beyond all bounds and starts from its reference."""
        found = find_simulation(self._scene.env)
        if found is not None and any(found.data.warning[kind].number for kind in _DIVERGED):
            raise UserError(
                f"the simulation of {self._scene.name} diverges at step {step}: positions or accelerations are not "
                "finite; lower the model's timestep or its actuators' control ranges"
            )
