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


def value_behind(reward: Float[ndarray, "T"], discount: Float[ndarray, "T"], steps: int, expected: float) -> float:
    """Return what may be counted on behind the end of an episode: no more than its last n steps, over and over.

    What the critic expects there is not taken for more than that. What an episode brought bounds the critic's targets
    from below, so a critic that expects too much would be confirmed by each episode that the clock ends, for as long
    as the episode is in memory.

    Args:
        reward, discount, steps: as of :func:`returns_to_go`.
        expected: of the last observation, by the critic.
    """
    last = max(0, len(reward) - steps)
    lost = 1.0 - discount[last]
    return min(expected, float(reward[last] / lost)) if lost > 0 else expected
