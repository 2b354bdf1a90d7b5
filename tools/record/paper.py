"""Record the experiments of rl/paper/experiments.yaml: result file, figures and the tables of docs/results/paper.md.

Run from a checkout's root after `make paper`, or during it for what is finished:

    .venv/bin/python -m tools.record.paper
"""

import csv
import sys
from pathlib import Path
from statistics import median
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from nerf_rl.files.atomic import atomic_write
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.metrics import wilson_interval
from tools.page_tables import PAPER_PAGE, markdown_table, write_tables
from tools.record.demo import read_result
from tools.record.run_paper import Run, read_experiments, runs_of

RESULTS = Path("rl/results")
FIGURES = {
    "success": "success rate of evaluations",
    "episode_return": "return of training episodes",
    "episode_length": "length of training episodes",
    "critic_loss": "critic loss",
}
SOLVED = 1.0  # success rate of an evaluation


def main() -> None:
    """Write the record of all finished runs; weak seeds are in it."""
    experiments = read_experiments()
    finished = {}
    for name, experiment in experiments.items():
        runs = [run for run in runs_of(name, experiment) if (run.folder / SUMMARY).is_file()]
        if runs:
            finished[name] = runs
    if not finished:
        sys.exit("no finished run under runs/paper; run make paper first")
    results = {name: [read_result(run.folder) for run in runs] for name, runs in finished.items()}
    write_json(RESULTS / "paper.json", results)
    groups: dict[str, list[str]] = {}
    for name in finished:
        groups.setdefault(experiments[name]["group"], []).append(name)
    tables = {}
    for group, names in groups.items():
        # runs that are evaluated once, at their end, have no curves to show
        if any(len(result["evaluations"]) > 1 for name in names for result in results[name]):
            draw(RESULTS / f"paper_{group}.png", {n: finished[n] for n in names}, experiments)
        rows = [row(experiments[name], results[name]) for name in names]
        tables[f"paper-{group}"] = markdown_table(HEADER, rows)
    write_tables(PAPER_PAGE, tables)


HEADER = (
    "experiment",
    "the paper says",
    "seeds solved",
    "episodes to solve, median (least to most)",
    "env steps",
    "success at the end (95 % interval)",
    "at the end after episodes",
    "command",
)


def row(experiment: dict[str, Any], results: list[dict[str, Any]]) -> list[object]:
    """Return one experiment's row: a run is solved at its first evaluation in which every episode succeeds."""
    solved = [first for result in results if (first := first_solved(result)) is not None]
    last = [result["evaluations"][-1] for result in results]
    episodes = sum(e["episodes"] for e in last)
    successes = round(sum(e["success_rate"] * e["episodes"] for e in last))
    low, high = wilson_interval(successes, episodes)
    keys = "".join(f" --{key} {value}" for key, value in experiment.get("keys", {}).items())
    ends = sorted(e["training_episodes"] for e in last)
    return [
        experiment["title"],
        experiment.get("claim", "-"),
        f"{len(solved)} of {len(results)}",
        spread([e["training_episodes"] for e in solved]),
        spread([e["env_steps"] for e in solved]),
        f"{successes / episodes:.1%} ({low:.1%} to {high:.1%})",
        f"{ends[0]:,}" if ends[0] == ends[-1] else f"{ends[0]:,} to {ends[-1]:,}",
        f"`train-rl --config {experiment['recipe']}{keys}`",
    ]


def first_solved(result: dict[str, Any]) -> dict[str, Any] | None:
    """Return the first evaluation in which every episode succeeded."""
    return next((e for e in result["evaluations"] if e["success_rate"] >= SOLVED), None)


def spread(values: list[int]) -> str:
    """Return median and range."""
    return f"{median(values):,.0f} ({min(values):,} to {max(values):,})" if values else "-"


def draw(path: Path, finished: dict[str, list[Run]], experiments: dict[str, dict[str, Any]]) -> None:
    """Draw each seed's curves over training episodes, one colour for each experiment."""
    figure = Figure(figsize=(11, 7), layout="constrained")
    for axes, (quantity, label) in zip(figure.subplots(2, 2).flat, FIGURES.items(), strict=True):
        for index, (name, runs) in enumerate(finished.items()):
            for number, run in enumerate(runs):
                title = experiments[name]["title"] if number == 0 else None
                plot(axes, run, quantity, f"C{index}", title)
        axes.set(xlabel="training episodes", ylabel=label, xscale="log")
        if quantity == "critic_loss":
            axes.set_yscale("log")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8)
    with atomic_write(path) as aside:
        figure.savefig(aside, format="png", dpi=80)


def plot(axes: Axes, run: Run, quantity: str, colour: str, title: str | None) -> None:
    """Draw one run's curve."""
    if quantity == "success":
        evaluations = read_result(run.folder)["evaluations"]
        points = [(e["training_episodes"], e["success_rate"]) for e in evaluations]
    else:
        with open(run.folder / "metrics.csv", newline="", encoding="utf-8") as file:
            rows = [r for r in csv.DictReader(file) if r[quantity]]
        points = [(int(r["episodes"]), float(r[quantity])) for r in rows]
    axes.plot(*zip(*points, strict=True), color=colour, alpha=0.6, linewidth=1, marker=".", markersize=3, label=title)


if __name__ == "__main__":
    main()
