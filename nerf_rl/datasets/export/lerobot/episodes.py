"""Whole episodes of a dataset: frames of one step after the other, from a reset on."""

import itertools
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import SPLIT_NAMES
from nerf_rl.errors import UserError


class Episode(NamedTuple):
    """Neighbouring frames of a dataset, the first right after a reset."""

    number: int
    """of the dataset's episode; an environment that ended within it was reset, and then several bear one number"""
    split: str
    states: range
    """frames in the dataset, one a state"""

    @property
    def transitions(self) -> int:
        """How many states there are of which the next one is known."""
        return len(self.states) - 1


def whole_episodes(dataset: MultiViewDataset, chosen: Collection[int]) -> list[Episode]:
    """Return the episodes of a dataset, in order.

    Args:
        dataset: to read.
        chosen: numbers of episodes; with none, all.

    Raises:
        UserError: the dataset has no such episode, keeps only some steps of one, or has no step at all.
    """
    number, step, split = dataset.read("episode"), dataset.read("step"), dataset.read_splits()
    for episode in chosen:
        if episode not in number:
            raise UserError(f"{dataset.folder} has no episode {episode}; available: {number.min()} to {number.max()}")
    begins = np.concatenate([[True], (np.diff(number) != 0) | (step[1:] == 0)])
    expected = np.where(begins, 0, np.concatenate([[0], step[:-1] + 1]))
    kept = np.isin(number, list(chosen)) if chosen else np.ones(len(number), bool)
    scattered = np.flatnonzero(kept & (step != expected))
    if len(scattered):
        first, steps = int(scattered[0]), dataset.manifest["config"].get("episode_steps")
        remedy = f": make a dataset with --episode_steps {steps} --frames_per_episode {steps + 1}" if steps else ""
        raise UserError(
            f"{dataset.folder} keeps only some steps of its episodes (of episode {number[first]} step {step[first]} "
            f"but not step {expected[first]}), and LeRobot takes whole episodes{remedy}"
        )
    bounds = [*np.flatnonzero(begins).tolist(), len(number)]
    runs = [range(begin, end) for begin, end in itertools.pairwise(bounds) if kept[begin]]
    episodes = [Episode(int(number[run[0]]), SPLIT_NAMES[split[run[0]]], run) for run in runs if len(run) > 1]
    if not episodes:
        raise UserError(
            f"{dataset.folder} has no episode with a step; make a dataset with --frames_per_episode 2 or more"
        )
    return episodes
