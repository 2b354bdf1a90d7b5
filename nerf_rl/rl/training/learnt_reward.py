"""What a learner is told of a step's reward."""

from collections.abc import Mapping
from typing import Any

from jaxtyping import Float
from numpy import ndarray


def learnt_reward(reward: Float[ndarray, "E"], info: Mapping[str, Any], success_bonus: float) -> Float[ndarray, "E"]:
    """Return rewards with what the run adds to those of steps with a success.

    A scene's reward may make so little of its success that an agent is as well off beside it: the hand that presses
    on a drawer's handle has more than half of what it has at the open drawer, and less on all ways from here to there,
    which a discounted sum can hardly tell from staying.

    Args:
        reward: of each environment's step.
        info: of the step, which says of each environment whether it succeeded, if the scene does.
        success_bonus: for such a step.
    """
    return reward + success_bonus * info["success"] if "success" in info else reward
