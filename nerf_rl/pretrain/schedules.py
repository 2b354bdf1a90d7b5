"""How learning rates move along a run."""

import math

_WARM_UP = 0.03  # share of the schedule in which the rate rises
_LAST_RATE = 0.02  # of the peak rate


def warm_cosine(done: float) -> float:
    """Return a rate as a share of its peak, at a share of the run: a linear rise, then a cosine."""
    if done < _WARM_UP:
        return 0.1 + 0.9 * done / _WARM_UP
    cosine = 0.5 + 0.5 * math.cos(math.pi * (done - _WARM_UP) / (1.0 - _WARM_UP))
    return _LAST_RATE + (1.0 - _LAST_RATE) * cosine
