"""What the results of evaluations look like in the files that keep them, and in words."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nerf_rl.errors import MissingFileError
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.structure import any_number, flag, listing, mapping, number, whole

SUCCESS, LOW, HIGH = "success_rate", "ci_low", "ci_high"
"""of environments that tell of success; other results are without"""
DEMONSTRATIONS = "demonstrations"
"""how many the agent began with; results of agents that had none are without"""
DUE = "due"
"""environment steps at which an evaluation was due; results of earlier versions are without"""
TO_END = "to_end"
"""true where evaluated episodes went on after a success; other results are without"""
EVALUATIONS = listing(
    mapping(
        {"env_steps": whole(), "episodes": whole(1), "mean_return": any_number},
        {**dict.fromkeys((SUCCESS, LOW, HIGH), number(0.0, 1.0)), DEMONSTRATIONS: whole(1), DUE: whole(), TO_END: flag},
        others=True,
    )
)
"""of training, oldest first, as in ``summary.json`` and in checkpoints"""


_SUMMARY = mapping({"evaluations": EVALUATIONS}, others=True)


def read_evaluations(run: Path) -> list[dict[str, Any]]:
    """Return the evaluations of a run, oldest first; none if it has no summary, as while it is trained.

    Raises:
        MissingFileError: its summary is damaged, or of another kind of run.
    """
    path = run / SUMMARY
    if not path.is_file():
        return []
    try:
        summary = read_json(path)
        _SUMMARY(summary, "")
    except (OSError, ValueError) as error:
        raise MissingFileError("the summary of an agent", path, f"it is damaged ({error})", "train it again") from error
    return list(summary["evaluations"])


def tells_success(evaluations: Sequence[Mapping[str, Any]]) -> bool:
    """Tell whether the environment of some evaluations tells of success."""
    return all(SUCCESS in evaluation for evaluation in evaluations)


def due(env_steps: int, keys: Mapping[str, Any]) -> int:
    """Return the environment steps at which an evaluation was due: all environments step at once, so it comes late.

    Args:
        env_steps: at which it came.
        keys: of train-rl, as they were then.
    """
    for step in (keys["env_steps"], env_steps // keys["evaluation_every"] * keys["evaluation_every"]):
        if 0 <= env_steps - step < keys["envs"] * keys["action_repeat"]:
            return step
    return env_steps


def describe_episodes(result: Mapping[str, Any]) -> str:
    """Return what evaluated episodes gave: the success rate with its interval, if there is one, and the return."""
    rate = ""
    if SUCCESS in result:
        rate = f"success {result[SUCCESS]:.0%} [{result[LOW]:.0%}, {result[HIGH]:.0%}] of "
    return f"{rate}{result['episodes']} episodes, return {result['mean_return']:.4g}{with_demonstrations(result)}"


def with_demonstrations(result: Mapping[str, Any], before: str = ", ") -> str:
    """Return what has to stand beside each figure of an agent that began with demonstrations; nothing for others."""
    count = result.get(DEMONSTRATIONS, 0)
    return f"{before}with {count} demonstration{'s' * (count != 1)}" if count else ""
