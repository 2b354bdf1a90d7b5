"""Where training episodes begin, and when they end: more of them where the agent fails, fewer where it rests."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from nerf_rl.files.structure import flag, listing, whole
from nerf_rl.rl.training.episodes import training_seed

STRUCTURE = {"failed_starts": listing(whole()), "ever_succeeded": flag, "recent": listing(flag)}
"""of what :meth:`Curriculum.state_dict` has beside ``episode_index``, which checkpoints of every version hold"""
_REMEMBERED = 20  # of the failures; older ones are of a policy that has learnt since
_RECENT = 20  # of the episodes at new places
_RARE = 5  # successes among these


class Curriculum:
    """Gives each training episode the seed with which its environment is reset, and ends it after a success.

    A policy that can do its task from most starts hardly explores any more, and fails at the others for good. So a
    start that failed is tried once more, the oldest first, and the episode is to explore as if it were the first one
    (after prioritised level replay, Jiang et al. 2021, with failure for a score). What fails before anything has
    succeeded tells nothing of its start.

    As long as hardly anything succeeds at new places, the retry may do again what has succeeded from a start that is
    like it (an echo, see :class:`nerf_rl.rl.training.echoes.Echoes`). Where successes come by themselves, echoes would
    take the place of tries.

    To rest at the goal teaches less than another episode does, so episodes end soon after a success. But the first
    successes go on: only what they bring to the end tells the agent what it had not known, that they are worth more.

    Args:
        seed: of the run.
        envs: parallel environments.
        retry_share: most of the episodes that are such retries.
        steps_after_success: environment steps for which an episode goes on after a success, once at least half of the
            latest episodes at new places have succeeded; with None all go on.
        rng: draws which episodes are retries, and which of these are echoes.
        echo_share: of the retries that are echoes.

    Attributes:
        retried: which environments [E] are in a retry.
        echoed: which of these retries are echoes.
    """

    def __init__(
        self,
        seed: int,
        envs: int,
        retry_share: float,
        steps_after_success: int | None,
        rng: np.random.Generator,
        echo_share: float = 0.0,
    ):
        self._seed, self._share, self._enough, self._rng = seed, retry_share, steps_after_success, rng
        self._echo_share = echo_share
        self._index, self._running = [0] * envs, [0] * envs
        self._failed: deque[int] = deque(maxlen=_REMEMBERED)
        self._recent: deque[bool] = deque(maxlen=_RECENT)
        self._ever_succeeded = False
        self._after_success = np.zeros(envs, np.int64)
        self.retried: Bool[ndarray, "E"] = np.zeros(envs, np.bool_)
        self.echoed: Bool[ndarray, "E"] = np.zeros(envs, np.bool_)

    def begin(self, env: int, successes: int = 0) -> int:
        """Return the seed of the next episode of an environment.

        Args:
            env: which of the environments.
            successes: that a retry could do again.
        """
        self._after_success[env] = 0
        self.retried[env] = bool(self._failed) and self._rng.random() < self._share
        echoes = bool(self.retried[env]) and successes > 0 and sum(self._recent) < _RARE
        self.echoed[env] = echoes and self._rng.random() < self._echo_share
        if self.retried[env]:
            self._running[env] = self._failed.popleft()
        else:
            self._running[env] = training_seed(self._seed, env, self._index[env])
            self._index[env] += 1
        return self._running[env]

    def step(self, success: Bool[ndarray, "E"], env_steps: Int[ndarray, "E"]) -> Bool[ndarray, "E"]:
        """Return which episodes have gone on for long enough.

        Args:
            success: of each so far, before the steps just taken.
            env_steps: just taken.
        """
        self._after_success += np.where(success, env_steps, 0)
        if self._enough is None or 2 * sum(self._recent) < _RECENT:
            return np.zeros_like(success)
        return self._after_success >= self._enough

    def end(self, env: int, success: bool | None) -> None:
        """Take note of how an environment's episode ended; None where that is not told."""
        self._ever_succeeded |= bool(success)
        if success is None or self.retried[env]:
            return
        self._recent.append(success)
        if self._share and self._ever_succeeded and not success:
            self._failed.append(self._running[env])

    def break_off(self, env: int) -> None:
        """Take note that an environment's episode is not acted to its end: what it tried again is left to try."""
        if self.retried[env]:
            self._failed.append(self._running[env])
            self.retried[env] = False

    def state_dict(self) -> dict[str, Any]:
        """Return what a checkpoint has to hold between episodes."""
        failed = {"failed_starts": list(self._failed), "ever_succeeded": self._ever_succeeded}
        return {"episode_index": self._index, **failed, "recent": list(self._recent)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint, perhaps of an earlier version, which had no curriculum."""
        self._index = list(state["episode_index"])
        self._failed = deque(state.get("failed_starts", []), _REMEMBERED)
        self._recent = deque(state.get("recent", []), _RECENT)
        self._ever_succeeded = state.get("ever_succeeded", False)
