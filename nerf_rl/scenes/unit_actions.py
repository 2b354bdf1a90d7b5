"""Actions in [-1, 1], in which behaviours act and datasets are written, as an environment takes them."""

import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float
from numpy import ndarray

_UNLIMITED = 1.0  # of actions without limits


def in_range(action: Float[ndarray, "*A"], space: Box) -> Float[ndarray, "*A"]:
    """Return what an environment takes for an action in [-1, 1], from the lower to the upper limit of its actions.

    Where there is no limit, the range ends at 1 on that side, or two beyond the other limit if that lies farther.
    """
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    low = np.where(np.isfinite(low), low, np.minimum(-_UNLIMITED, high - 2.0 * _UNLIMITED))
    high = np.where(np.isfinite(high), high, np.maximum(_UNLIMITED, low + 2.0 * _UNLIMITED))
    if (low == -1.0).all() and (high == 1.0).all():
        return action  # untouched by rounding
    return np.asarray(low + (action.astype(np.float64) + 1.0) / 2.0 * (high - low)).astype(action.dtype)
