"""A sweep's figure: all seeds and their interquartile mean over environment steps."""

from pathlib import Path
from typing import Any

from nerf_rl.files.atomic import atomic_write
from nerf_rl.rl.training.evaluation_results import SUCCESS, with_demonstrations


def draw_sweep(path: Path, summary: dict[str, Any], title: str) -> None:
    """Draw each seed as a thin line, and their interquartile mean with its 95 % interval.

    Args:
        path: of the PNG.
        summary: as :func:`~nerf_rl.rl.sweeps.summary.summarise` returns it, with runs.
        title: above it.
    """
    from matplotlib.figure import Figure  # takes half a second to import

    score, curve = summary["score"], summary["curve"]
    figure = Figure(figsize=(6, 3.5), layout="constrained")
    axes = figure.subplots()
    for run in summary["runs"]:
        steps = [evaluation["env_steps"] for evaluation in run["evaluations"]]
        scores = [evaluation[score] for evaluation in run["evaluations"]]
        axes.plot(steps, scores, color="0.6", linewidth=0.7, marker=".", markersize=3)
    steps = [point["env_steps"] for point in curve]
    axes.plot(steps, [point["iqm"] for point in curve], marker="o", label="interquartile mean")
    known = [point for point in curve if point["iqm_low"] is not None]
    lows, highs = ([point[name] for point in known] for name in ("iqm_low", "iqm_high"))
    axes.fill_between([point["env_steps"] for point in known], lows, highs, alpha=0.25, label="95 % interval")
    told = score == SUCCESS
    axes.set(xlabel="environment steps", ylabel="success rate" if told else "mean return")
    if told:
        axes.set(ylim=(-0.03, 1.03))
    axes.set_title(f"{title}, {len(summary['runs'])} seeds{with_demonstrations(summary)}")
    axes.legend(fontsize=8)
    with atomic_write(path) as aside:
        figure.savefig(aside, format="png", dpi=120)
