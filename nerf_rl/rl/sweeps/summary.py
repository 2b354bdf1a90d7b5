"""All finished runs of a sweep in one ``summary.json``: each of them, and what they are together."""

from collections.abc import Sequence
from typing import Any

from nerf_rl.metrics import wilson_interval
from nerf_rl.rl.sweeps.aggregates import describe_scores
from nerf_rl.rl.sweeps.runs import GOOD
from nerf_rl.rl.training.evaluation_results import DEMONSTRATIONS, DUE, SUCCESS, tells_success

RETURN = "mean_return"


def summarise(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the summary of runs as :func:`~nerf_rl.rl.sweeps.runs.read_run` returns them.

    Scores are success rates or, where the environment does not tell of success, mean returns.
    """
    runs = sorted(runs, key=lambda run: run["seed"])
    told = bool(runs) and all(tells_success(run["evaluations"]) for run in runs)
    score = SUCCESS if told else RETURN
    last = [run["evaluations"][-1][score] for run in runs if run["evaluations"]]
    shown = next((e[DEMONSTRATIONS] for run in runs for e in run["evaluations"] if DEMONSTRATIONS in e), 0)
    return {
        "score": score,
        **({DEMONSTRATIONS: shown} if shown else {}),
        "final": describe_scores(last) if last else None,
        "good_seeds": _good(last) if told else None,
        "curve": [{"env_steps": due, **describe_scores(scores)} for due, scores in _by_step(runs, score, len(last))],
        "runs": runs,
    }


def _by_step(runs: Sequence[dict[str, Any]], score: str, seeds: int) -> list[tuple[int, list[float]]]:
    """Return the scores of all runs at each number of environment steps at which all of them were evaluated.

    Runs that end after so many episodes do so at different steps, and a mean of other seeds at each of these would
    rise and fall where none of them did.
    """
    scores: dict[int, list[float]] = {}
    for run in runs:
        for due, evaluation in {evaluation[DUE]: evaluation for evaluation in run["evaluations"]}.items():
            scores.setdefault(due, []).append(evaluation[score])
    return sorted((due, found) for due, found in scores.items() if len(found) == seeds)


def _good(last: Sequence[float]) -> dict[str, Any]:
    """Return how many seeds end with a success rate of 95 % or more; Wilson's interval holds for 0 and for all, too."""
    count = sum(rate >= GOOD for rate in last)
    low, high = wilson_interval(count, len(last))
    return {"at_least": GOOD, "count": count, "seeds": len(last), "share": count / len(last), "low": low, "high": high}
