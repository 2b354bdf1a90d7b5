"""Which episodes are held out: whole ones, since the frames of one show much the same."""

import numpy as np


def validation_episodes(episodes: int, fraction: float, seed: int) -> frozenset[int]:
    """Return the episodes held out for validation: at least one if any are asked for and there are two.

    Args:
        episodes: how many there are.
        fraction: share of them to hold out.
        seed: of the choice.
    """
    count = round(fraction * episodes)
    if fraction > 0 and episodes > 1:
        count = min(max(count, 1), episodes - 1)
    order = np.random.default_rng([seed, 2**32]).permutation(episodes)
    return frozenset(int(episode) for episode in order[:count])
