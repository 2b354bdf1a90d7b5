"""What episodes brought from each step on: the least that the step is worth to a policy that knows better."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def returns_to_go(
    reward: Float[ndarray, "T"], discount: Float[ndarray, "T"], steps: int, last_value: float
) -> Float[ndarray, "T"]:
    """Return the discounted sum of rewards from each step of a finished episode to its end, and the value from there.

    G_t = R_t + d_t G_(t+n), where R_t is the n-step return of the transition from step t on, d_t the discount behind
    it, and G at the end ``last_value``.

    Args:
        reward: R, of the episode's n-step transitions in their order; those at the end are shorter.
        discount: d, 0 where the episode was terminated.
        steps: n.
        last_value: of the last observation, to which the rest of a truncated episode is left.
    """
    found = np.zeros(len(reward))
    for t in reversed(range(len(reward))):
        found[t] = reward[t] + discount[t] * (found[t + steps] if t + steps < len(reward) else last_value)
    return found


def steady_value(reward: Float[ndarray, "T"], discount: Float[ndarray, "T"], steps: int) -> float:
    """Return what it is worth to go on for ever as in the last steps of an episode.

    Args:
        reward, discount, steps: as of :func:`returns_to_go`; the last transition that spans all of the steps counts, or
            the first of a shorter episode.
    """
    last = max(0, len(reward) - steps)
    return float(reward[last] / (1.0 - discount[last])) if discount[last] < 1.0 else np.inf
