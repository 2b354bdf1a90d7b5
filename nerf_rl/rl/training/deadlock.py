"""A watch on training episodes: has anything become better lately?"""

import collections
import math
from collections.abc import Mapping
from typing import Any

from nerf_rl.files.structure import any_number, listing, mapping, optional, whole

_EPISODES = 10  # whose mean is compared with the best such mean
_GAIN = 0.02  # of the range of means so far: a smaller rise is noise

STRUCTURE = mapping(
    {
        "returns": listing(any_number, 0, _EPISODES),
        "best": optional(any_number),
        "worst": optional(any_number),
        "since": whole(),
    }
)
"""of its state in a checkpoint"""


class DeadlockMonitor:
    """Tells for how many environment steps there was no success, or no better return where success is not told.

    Where it is told, a rising return is no sign of life: it rises while exploration falls and the policy rests.
    """

    def __init__(self) -> None:
        self._returns: collections.deque[float] = collections.deque(maxlen=_EPISODES)
        self._best, self._worst = -math.inf, math.inf
        self._since = 0

    def end_episode(self, env_steps: int, episode_return: float, success: bool | None) -> None:
        """Take in a training episode.

        Args:
            env_steps: at its end.
            episode_return: its return.
            success: whether it had one; None where the environment does not tell.
        """
        if success is not None:
            self._since = env_steps if success else self._since
            return
        self._returns.append(episode_return)
        if len(self._returns) < _EPISODES:
            return
        mean = sum(self._returns) / _EPISODES
        self._worst = min(self._worst, mean)
        if mean > self._best + _GAIN * (self._best - self._worst if math.isfinite(self._best) else 0.0):
            self._best, self._since = mean, env_steps

    def stuck_for(self, env_steps: int) -> int:
        """Return the environment steps since then."""
        return env_steps - self._since

    def forgive(self, env_steps: int) -> None:
        """Count anew from here on: something has been done about it."""
        self._since = env_steps

    def state_dict(self) -> dict[str, Any]:
        """Return what a resumed run needs, as JSON has it."""
        best, worst = (value if math.isfinite(value) else None for value in (self._best, self._worst))
        return {"returns": list(self._returns), "best": best, "worst": worst, "since": self._since}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Put back what :meth:`state_dict` returned."""
        self._returns.extend(state["returns"])
        self._best = -math.inf if state["best"] is None else state["best"]
        self._worst = math.inf if state["worst"] is None else state["worst"]
        self._since = state["since"]
