"""What succeeded, done again from other starts."""

from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy import ndarray
from torch import Tensor

from nerf_rl.errors import BEGIN_ANEW, MissingFileError
from nerf_rl.files.tensor_files import require_tensors

REMEMBERED = 100  # successes
_AFTER_SUCCESS = 5  # actions that are kept, too: what was opened is to be open
_NOISE = 0.1  # standard deviation
_SIMILAR = 5  # successes, of which the quickest is done again
_SHORTENED, _LEFT_OUT = 0.7, 0.5  # share of the echoes, and the most of their actions


class _Success(NamedTuple):
    start: Float[ndarray, "O"]
    """first observation"""
    actions: Float[ndarray, "T A"]


class Echoes:
    """Remembers what successful episodes did, and does it again, without looking, in an episode that begins alike.

    The first success comes by luck, and by luck alone the second comes no sooner; an agent that is to learn from one
    success in ten episodes takes long. The actions of a success, as they were, often succeed from a start that differs
    a little from its own, and this success reaches a little further. So an agent that fails soon has successes to learn
    from, wherever it fails (after episodic control, Lengyel and Dayan 2007, and the return to where it has been of
    Go-Explore, Ecoffet et al. 2021).

    Luck wanders and rests. Most echoes leave out a stretch of what was done, and of similar successes the quickest is
    done again, so that what is remembered becomes direct: a way that takes long is worth little to begin with.

    Args:
        envs: parallel environments.
        remembered: successes, the latest.
        rng: draws the noise on what is done again.
    """

    def __init__(self, envs: int, remembered: int, rng: np.random.Generator):
        self._rng = rng
        self._successes: deque[_Success] = deque(maxlen=remembered)
        self._start: list[ndarray] = [np.zeros(0, np.float32)] * envs
        self._plan: list[ndarray] = [np.zeros((0, 0), np.float32)] * envs
        self._acted: list[list[ndarray]] = [[] for _ in range(envs)]
        self._until: list[int | None] = [None] * envs

    def __len__(self) -> int:
        return len(self._successes)

    def begin(self, env: int, observation: Float[ndarray, "O"], echo: bool) -> None:
        """Begin an episode.

        Args:
            env: in which environment.
            observation: its first one.
            echo: do what a success did that began with a similar observation; there must be one.
        """
        self._start[env], self._acted[env], self._until[env] = observation.astype(np.float32), [], None
        self._plan[env] = self._shortened(self._similar(observation)) if echo else np.zeros((0, 0), np.float32)

    def act(self, action: Float[ndarray, "E A"], success: Bool[ndarray, "E"]) -> Float[ndarray, "E A"]:
        """Return what the environments are to do, and take note of it.

        Args:
            action: what they do where nothing is done again, or all of it has been.
            success: of each episode so far.
        """
        action = action.copy()
        for env, (plan, acted) in enumerate(zip(self._plan, self._acted, strict=True)):
            if len(acted) < len(plan):
                noise = self._rng.normal(0.0, _NOISE, plan.shape[1])
                action[env] = np.clip(plan[len(acted)] + noise, -1.0, 1.0)
            if success[env] and self._until[env] is None:
                self._until[env] = len(acted) + _AFTER_SUCCESS
            acted.append(action[env].copy())
        return action

    def end(self, env: int, success: bool) -> None:
        """Remember an episode that is over, if it succeeded."""
        if success:
            self._successes.append(_Success(self._start[env], np.stack(self._acted[env][: self._until[env]])))

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a checkpoint has to hold between episodes, of the successes; nothing as long as there is none."""
        if not self._successes:
            return {}
        return {
            "start": torch.from_numpy(np.stack([success.start for success in self._successes])),
            "length": torch.tensor([len(success.actions) for success in self._successes]),
            "action": torch.from_numpy(np.concatenate([success.actions for success in self._successes])),
        }

    def load_state_dict(self, state: Mapping[str, Tensor], sizes: tuple[int, int], source: Path) -> None:
        """Go on from a checkpoint, perhaps of an earlier version, which remembered nothing.

        Args:
            state: of the checkpoint.
            sizes: O and A.
            source: the checkpoint, to be named if it does not fit.

        Raises:
            MissingFileError: it is of another run, or damaged.
        """
        if not state:
            return
        count, numbers = (state[name].numel() if name in state else 0 for name in ("length", "action"))
        like = {"start": torch.zeros(count, sizes[0]), "length": torch.zeros(count, dtype=torch.int64)}
        require_tensors(state, like | {"action": torch.zeros(numbers // sizes[1], sizes[1])}, source)
        length = state["length"]
        if not count or length.min() < 1 or length.sum() != len(state["action"]):
            raise MissingFileError("a checkpoint", source, "what succeeded is damaged in it", BEGIN_ANEW)
        actions = state["action"].split(length.tolist())
        self._successes.extend(_Success(s.numpy(), a.numpy()) for s, a in zip(state["start"], actions, strict=True))

    def _similar(self, observation: Float[ndarray, "O"]) -> Float[ndarray, "T A"]:
        """Return the actions of the quickest of the successes whose first observations are nearest to one."""
        nearest = sorted(self._successes, key=lambda success: float(np.linalg.norm(success.start - observation)))
        return min((success.actions for success in nearest[:_SIMILAR]), key=len)

    def _shortened(self, actions: Float[ndarray, "T A"]) -> Float[ndarray, "S A"]:
        """Return actions, mostly without a stretch of those before the success."""
        before = len(actions) - _AFTER_SUCCESS
        most = int(_LEFT_OUT * before)
        if most < 1 or self._rng.random() >= _SHORTENED:
            return actions
        length = self._rng.integers(1, most + 1)
        first = self._rng.integers(0, before - length + 1)
        return np.delete(actions, slice(first, first + length), axis=0)
