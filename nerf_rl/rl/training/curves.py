"""What a training run writes for people: metrics.csv, summary.json and the learning curve."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from nerf_rl.files.atomic import atomic_write, write_text
from nerf_rl.loggers import CurveLogger
from nerf_rl.rl.training.evaluation_results import (
    DUE,
    HIGH,
    LOW,
    SUCCESS,
    TO_END,
    tells_success,
    with_demonstrations,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMNS = (
    "env_steps",
    "seconds",
    "episodes",
    "episode_return",
    "episode_length",
    "episode_success",
    "noise",
    "beta",
    "critic_loss",
    "q",
    "td_error",
    "critic_gradient",
    "actor_loss",
    "pre_tanh",
    "actor_gradient",
    "saturated",
    "dead_units",
    "action_gradient",
    "priority_spread",
    "stuck_for",
    "updates_per_second",
)


class MetricsLog:
    """Means of scalars between two rows of ``metrics.csv``.

    Args:
        path: the file; rows beyond ``env_steps`` are dropped, so that a resumed run has each step once.
        env_steps: where the run goes on.
        loggers: which get the rows and the evaluations as well.
    """

    def __init__(self, path: Path, env_steps: int = 0, loggers: Sequence[CurveLogger] = ()):
        self._path, self.loggers = path, loggers
        rows = []
        if env_steps and path.is_file():
            rows = [row for row in _whole_rows(path) if int(row["env_steps"]) <= env_steps]
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(path, text.getvalue())
        self._gathered: dict[str, list[float]] = {}

    def gather(self, scalars: dict[str, float]) -> None:
        """Take scalars in."""
        for name, value in scalars.items():
            self._gathered.setdefault(name, []).append(value)

    def write(self, **now: float | int) -> None:
        """Append a row: the means of what was gathered since the last one, and the values of ``now``.

        What an algorithm of the user's own gathers beyond the columns of the file goes to the loggers alone.
        """
        row: dict[str, float | int] = {n: float(np.mean(values)) for n, values in self._gathered.items()}
        row |= now
        self._gathered = {}
        with open(self._path, "a", newline="", encoding="utf-8") as file:
            formatted = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in row.items()}
            csv.DictWriter(file, COLUMNS, extrasaction="ignore", lineterminator="\n").writerow(formatted)
        self._pass_on("train", row)

    def write_evaluation(self, result: Mapping[str, Any]) -> None:
        """Pass an evaluation on; ``summary.json`` keeps it."""
        self._pass_on("evaluation", result)

    def _pass_on(self, group: str, row: Mapping[str, Any]) -> None:
        """Give a row to the loggers, with the environment steps as its step."""
        figures = {f"{group}/{name}": float(value) for name, value in row.items() if name not in ("env_steps", DUE)}
        for logger in self.loggers:
            logger.log_metrics(figures, step=int(row["env_steps"]))
            logger.save()


def _whole_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of ``metrics.csv`` that were written to their end; a crash may have left others behind them."""
    lines = path.read_text(encoding="utf-8", errors="replace").replace("\0", "").splitlines(keepends=True)
    read = csv.DictReader(line for line in lines if line.endswith("\n"))
    return [row for row in read if None not in row.values() and str(row.get("env_steps")).isdecimal()]


def draw_learning_curve(path: Path, evaluations: list[dict[str, Any]], title: str) -> None:
    """Draw return over environment steps and, if it is known, success rate with its 95 % interval."""
    from matplotlib.figure import Figure  # takes half a second to import

    told = tells_success(evaluations)
    figure = Figure(figsize=(4 + 4 * told, 3), layout="constrained")
    axes = figure.subplots(1, 1 + told, squeeze=False)[0]
    if told:
        draw_success(axes[0], evaluations)
    draw_returns(axes[-1], evaluations)
    axes[0].set_title(title)
    with atomic_write(path) as aside:
        figure.savefig(aside, format="png", dpi=120)


def draw_success(axes: "Axes", evaluations: Sequence[Mapping[str, Any]]) -> None:
    """Draw success rate, with its 95 % interval, over environment steps."""
    steps = [e["env_steps"] for e in evaluations]
    axes.plot(steps, [e[SUCCESS] for e in evaluations], marker="o")
    axes.fill_between(steps, [e[LOW] for e in evaluations], [e[HIGH] for e in evaluations], alpha=0.2)
    shown = with_demonstrations(evaluations[-1], "\n") if evaluations else ""
    axes.set(ylim=(-0.03, 1.03), xlabel="environment steps", ylabel=f"success rate{shown}")


def draw_returns(axes: "Axes", evaluations: Sequence[Mapping[str, Any]]) -> None:
    """Draw mean return over environment steps."""
    stopped = tells_success(evaluations) and not any(evaluation.get(TO_END) for evaluation in evaluations)
    label = "mean return until success" if stopped else "mean return"
    steps = [e["env_steps"] for e in evaluations]
    axes.plot(steps, [e["mean_return"] for e in evaluations], marker="o", color="tab:orange")
    axes.set(xlabel="environment steps", ylabel=label)
