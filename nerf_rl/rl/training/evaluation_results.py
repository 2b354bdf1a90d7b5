"""What the results of evaluations look like in the files that keep them, and in words."""

from collections.abc import Mapping, Sequence
from typing import Any

from nerf_rl.files.structure import listing, mapping, number, whole

SUCCESS, LOW, HIGH = "success_rate", "ci_low", "ci_high"
"""of environments that tell of success; other results are without"""
EVALUATIONS = listing(
    mapping(
        {"env_steps": whole(), "episodes": whole(1), "mean_return": number()},
        dict.fromkeys((SUCCESS, LOW, HIGH), number(0.0, 1.0)),
        others=True,
    )
)
"""of training, oldest first, as in ``summary.json`` and in checkpoints"""


def tells_success(evaluations: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether the environment of some evaluations tells of success."""
    return all(SUCCESS in evaluation for evaluation in evaluations)


def describe_episodes(result: Mapping[str, Any]) -> str:
    """Return what evaluated episodes gave: the success rate with its interval, if there is one, and the return."""
    rate = ""
    if SUCCESS in result:
        rate = f"success {result[SUCCESS]:.0%} [{result[LOW]:.0%}, {result[HIGH]:.0%}] of "
    return f"{rate}{result['episodes']} episodes, return {result['mean_return']:.4g}"
