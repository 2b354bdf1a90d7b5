"""Where training episodes begin: at new places, and again where an earlier one failed."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from nerf_rl.files.structure import flag, listing, whole
from nerf_rl.rl.training.episodes import training_seed

STRUCTURE = {"failed_starts": listing(whole()), "ever_succeeded": flag}
"""of what :meth:`Starts.state_dict` has beside ``episode_index``, which the checkpoints of every version hold"""
_REMEMBERED = 20  # of the failures; older ones are of a policy that has learnt since


class Starts:
    """Gives each training episode the seed with which its environment is reset.

    A policy that can do its task from most starts hardly explores any more, and fails at the others for good. So a
    start that failed is tried once more, the oldest first, and the episode is to explore as if it were the first one
    (after prioritised level replay, Jiang et al. 2021, with failure for a score). What fails before anything has
    succeeded tells nothing of its start.

    Args:
        seed: of the run.
        envs: parallel environments.
        retry_share: most of the episodes that are such retries.
        rng: draws which episodes these are.

    Attributes:
        retried: which environments [E] are in such an episode.
    """

    def __init__(self, seed: int, envs: int, retry_share: float, rng: np.random.Generator):
        self._seed, self._share, self._rng = seed, retry_share, rng
        self._index, self._running = [0] * envs, [0] * envs
        self._failed: deque[int] = deque(maxlen=_REMEMBERED)
        self._ever_succeeded = False
        self.retried: Bool[ndarray, "E"] = np.zeros(envs, np.bool_)

    def begin(self, env: int) -> int:
        """Return the seed of the next episode of an environment."""
        self.retried[env] = bool(self._failed) and self._rng.random() < self._share
        if self.retried[env]:
            self._running[env] = self._failed.popleft()
        else:
            self._running[env] = training_seed(self._seed, env, self._index[env])
            self._index[env] += 1
        return self._running[env]

    def end(self, env: int, success: bool | None) -> None:
        """Take note of how an environment's episode ended; None where that is not told."""
        self._ever_succeeded |= bool(success)
        if self._share and self._ever_succeeded and success is False and not self.retried[env]:
            self._failed.append(self._running[env])

    def break_off(self, env: int) -> None:
        """Take note that an environment's episode is not acted to its end: what it tried again is left to try."""
        if self.retried[env]:
            self._failed.append(self._running[env])
            self.retried[env] = False

    def state_dict(self) -> dict[str, Any]:
        """Return what a checkpoint has to hold between episodes."""
        failed = {"failed_starts": list(self._failed), "ever_succeeded": self._ever_succeeded}
        return {"episode_index": self._index, **failed}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint, perhaps of an earlier version, which tried nothing again."""
        self._index = list(state["episode_index"])
        self._failed = deque(state.get("failed_starts", []), _REMEMBERED)
        self._ever_succeeded = state.get("ever_succeeded", False)
