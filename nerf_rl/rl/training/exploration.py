"""What training does beside what its policy says, less and less of it."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.files.structure import flag, listing, whole
from nerf_rl.rl.config import LATEST_EPISODES, TrainRLConfig
from nerf_rl.rl.experience.noise import EpsilonZGreedy, Noise, linear_schedule

STRUCTURE = {"awaits_success": flag, "lately": listing(flag), "failures": whole()}
"""of what :meth:`Exploration.state_dict` has beside ``explored_from``, which checkpoints of every version hold"""
_HELD_IN_WARM_UP = 0.8  # of the steps
_LONGEST_NOISE = 100_000  # agent steps of pink noise, which is held in memory; it repeats after them


class Exploration:
    """Turns a policy's actions into those of training: noise is added, and some of them are held random ones.

    Both become less by the clock, which begins once ``noise.wait_for_successes`` of the latest training episodes have
    succeeded: an agent that found a place of rest first is to look further, and one success may be luck. So may be two,
    all the more where the second is an echo of the first: after ``noise.renew_after`` failures in a row, whatever
    echoes do meanwhile, it is as at first again.

    Args:
        config: of the run.
        envs: parallel environments.
        action_size: A.
        rng: draws all of it.
    """

    def __init__(self, config: TrainRLConfig, envs: int, action_size: int, rng: np.random.Generator):
        self._config, self._rng, self._shape = config.noise, rng, (envs, action_size)
        steps = min(-(-config.episode_steps // config.action_repeat), _LONGEST_NOISE)
        self._noise = Noise(config.noise, envs, action_size, steps, rng)
        held = (config.noise.epsilon_z_steps, rng, config.noise.epsilon_z_kind)
        self._held = EpsilonZGreedy(envs, action_size, *held)
        self._least = np.zeros(envs)  # standard deviation of each environment's noise in its episode
        self._least_held = np.zeros(envs)  # share of each environment's held actions in its episode
        self._lately: deque[bool] = deque(maxlen=LATEST_EPISODES)
        self._failures = 0  # in a row, since the clock has begun
        self._since, self._awaits_success = 0, config.noise.wait_for_successes > 0

    def begin(self, env_step: int) -> None:
        """Explore as at first, and less and less from this environment step on."""
        self._since, self._awaits_success = env_step, self._config.wait_for_successes > 0
        self._lately.clear()
        self._failures = 0

    def elapsed(self, env_step: int) -> int:
        """Return for how many environment steps exploration has become less."""
        return 0 if self._awaits_success else env_step - self._since

    def scale(self, env_step: int) -> float:
        """Return the noise's standard deviation."""
        return self._noise.scale(self.elapsed(env_step))

    def begin_episode(self, env: int, env_step: int, again: bool = False) -> None:
        """Forget the episode before of one environment.

        Args:
            env: which of the environments.
            env_step: now.
            again: the episode tries a start again that failed, with noise of its own. Much of it is meant for starts
                from which the policy is far from success, little for those from which it all but succeeds. It may have
                held actions, too, however few there are elsewhere by then.
        """
        self._noise.reset(env)
        drawn = self._rng.random() if again and self._config.retries == "drawn" else 1.0
        self._least[env] = drawn * self._config.start if again else 0.0
        self._least_held[env] = self._config.epsilon_z_retries if again else 0.0
        self._held.reset(env, self._decayed(self._config.epsilon_z_start, env_step))

    def end_episode(self, success: bool | None, env_step: int, echoed: bool = False) -> None:
        """Take note of how an episode ended; None where the scene does not tell, which is nothing to wait for.

        Args:
            success: whether it had one.
            env_step: now.
            echoed: it did again what had succeeded, which tells nothing of what the policy can do by now.
        """
        if not self._awaits_success:
            if echoed:
                return
            self._failures = 0 if success is None or success else self._failures + 1
            if self._config.renew_after and self._failures >= self._config.renew_after:
                self.begin(env_step)
            return
        self._lately.append(bool(success))
        if success is None:
            self._awaits_success = False
        elif sum(self._lately) >= self._config.wait_for_successes:
            self._since, self._awaits_success = env_step, False

    def warm_up(self) -> Float[ndarray, "E A"]:
        """Return actions of a time when there is no policy to speak of."""
        random = self._rng.uniform(-1.0, 1.0, self._shape).astype(np.float32)
        return self._held.override(random, _HELD_IN_WARM_UP)

    def around(self, action: Float[ndarray, "E A"], env_step: int) -> Float[ndarray, "E A"]:
        """Return actions near the policy's."""
        noisy = np.clip(action + self._noise.sample(self.elapsed(env_step), self._least), -1.0, 1.0)
        share = np.maximum(self._decayed(self._config.epsilon_z, env_step), self._least_held)
        return self._held.override(noisy.astype(np.float32), share)

    def state_dict(self) -> dict[str, Any]:
        """Return what a checkpoint has to hold between episodes."""
        return {
            "explored_from": self._since,
            "awaits_success": self._awaits_success,
            "lately": list(self._lately),
            "failures": self._failures,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint, perhaps of an earlier version, which waited for nothing."""
        self._since, self._awaits_success = state["explored_from"], state.get("awaits_success", False)
        self._lately = deque(state.get("lately", []), LATEST_EPISODES)
        self._failures = state.get("failures", 0)

    def _decayed(self, start: float, env_step: int) -> float:
        return linear_schedule(start, 0.0, self._config.decay_steps, self.elapsed(env_step))
