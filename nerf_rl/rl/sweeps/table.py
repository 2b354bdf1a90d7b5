"""A sweep's summary as a table and in words."""

from collections.abc import Sequence
from typing import Any

from nerf_rl.rl.sweeps.runs import GOOD
from nerf_rl.rl.training.evaluation_results import DUE, HIGH, LOW, SUCCESS, with_demonstrations

_MOST_COLUMNS = 10
_NONE = "-"


def seeds_table(summary: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the heads of a table's columns and a row for each seed.

    At most ten evaluations have a column, the last one among them; ``summary.json`` has all.
    """
    score, steps = summary["score"], _shown([point["env_steps"] for point in summary["curve"]])
    told = score == SUCCESS
    final = f"final{with_demonstrations(summary, ' ')}, 95 % interval" if told else "final return"
    heads = ["seed", *(f"{step:,}" for step in steps), final]
    heads += [f"env steps to {GOOD:.0%}", f"seconds to {GOOD:.0%}"] if told else []
    rows = []
    for run in summary["runs"]:
        scores = {evaluation[DUE]: evaluation[score] for evaluation in run["evaluations"]}
        row = [str(run["seed"]), *(_written(scores.get(step), told) for step in steps), _final(run, told)]
        if told:
            good = run["good"] or {"env_steps": None, "seconds": None}
            row += [_count(good["env_steps"]), _count(good["seconds"])]
        rows.append([*row, _count(run["updates"]), _count(run["seconds"])])
    return [*heads, "updates", "seconds"], rows


def aligned(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table for a terminal, with columns aligned to the right."""
    widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in (heads, *rows)]
    return "\n".join(lines)


def describe_summary(summary: dict[str, Any]) -> str:
    """Return a line on all seeds together at their last evaluation."""
    final, good, told = summary["final"], summary["good_seeds"], summary["score"] == SUCCESS
    if final is None:
        return "no seed has been evaluated"
    interval = ""
    if final["iqm_low"] is not None:
        interval = f" [{_written(final['iqm_low'], told)}, {_written(final['iqm_high'], told)}]"
    what = f"{'success' if told else 'return'} at the end{with_demonstrations(summary)}"
    line = f"{what}: interquartile mean {_written(final['iqm'], told)}{interval} of {final['seeds']} seeds"
    line += f", mean {_written(final['mean'], told)}, least {_written(final['least'], told)}"
    if good is None:
        return line
    interval = f"[{good['low']:.0%}, {good['high']:.0%}]"
    return f"{line}; {good['count']} of {good['seeds']} at {GOOD:.0%} or more, {good['share']:.0%} {interval}"


def _shown(steps: list[int]) -> list[int]:
    """Return the steps that have a column: evenly chosen ones, ending with the last."""
    if len(steps) <= _MOST_COLUMNS:
        return steps
    chosen = {len(steps) - 1 - index * len(steps) // _MOST_COLUMNS for index in range(_MOST_COLUMNS)}
    return [steps[index] for index in sorted(chosen)]


def _final(run: dict[str, Any], told: bool) -> str:
    if not run["evaluations"]:
        return _NONE
    last = run["evaluations"][-1]
    if not told:
        return _written(last["mean_return"], told)
    return f"{last[SUCCESS]:.0%} [{last[LOW]:.0%}, {last[HIGH]:.0%}]"


def _written(score: int | float | None, told: bool) -> str:
    if score is None:
        return _NONE
    return f"{score:.0%}" if told else f"{score:.4g}"


def _count(number: int | float | None) -> str:
    return _NONE if number is None else f"{number:,.0f}"
