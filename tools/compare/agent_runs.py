"""Agents that tools compare: trained if they are missing, and kept in result files by their seeds."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import PROVENANCE, SUMMARY
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION
from nerf_rl.rl.sweeps.runs import read_run, run_folder
from nerf_rl.rl.sweeps.seed_list import parse_seeds
from nerf_rl.rl.training.evaluation_results import HIGH, LOW
from tools.result_files import Lines

RECIPE = "rl/demo.yaml"
"""what agents are trained by, unless their keys name another"""
ON_THE_WAY, EPISODES = 30_000, 50
"""environment steps after which longer runs are evaluated, too, and the episodes of every evaluation"""
KEYS = ["--evaluation_every", str(ON_THE_WAY), "--checkpoint_every", str(ON_THE_WAY)]
KEYS += ["--evaluation_episodes", str(EPISODES), "--final_evaluation_episodes", str(EPISODES)]


def train(arguments: list[str]) -> None:
    """Train the seeds of a sweep that are missing; what comes later overrides what comes before."""
    recipe = [] if arguments[0] == "--config" else ["--config", RECIPE]
    command = [sys.executable, "-m", "nerf_rl.cli", "train-rl", *recipe, *arguments, "--resume", "true"]
    subprocess.run(command, check=True)


def trained(folder: Path, seeds: str, arguments: list[str]) -> list[Path]:
    """Return the run folders of a sweep, whose seeds are trained if any is missing."""
    runs = [run_folder(folder, seed) for seed in parse_seeds(seeds)]
    if not all((run / SUMMARY).exists() for run in runs):
        train([*arguments, "--seeds", seeds, "--out", str(folder)])
    return runs


def row(run: Path) -> dict[str, Any]:
    """Return what is told of a run, what it saw by, how many of its last training episodes succeeded, what made it.

    Its folder's name and the intervals of success rates, which follow from the rest, are left out.
    """
    figures = read_run(run)
    figures.pop("run")
    figures["evaluations"] = [
        {name: value for name, value in evaluation.items() if name not in (LOW, HIGH)}
        for evaluation in figures["evaluations"]
    ]
    provenance = read_json(run / PROVENANCE)
    versions = {name: provenance[name] for name in ("git_revision", "packages", "processor")}
    facts = {"encoder": read_json(run / POLICY_DESCRIPTION)["encoder_digest"]}
    return {**figures, **facts, "late_training_success": late_training_success(run), **versions}


def late_training_success(run: Path) -> float:
    """Return the share of the training episodes in the last 5,000 environment steps that succeeded."""
    ends, successes = training_episodes(run)
    return float(successes[ends > ends[-1] - 5000].mean())


def training_episodes(run: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the environment steps at which each training episode ended, and which of them succeeded."""
    with open(run / "monitor.csv", newline="") as file:
        next(file)  # a line on the environment
        episodes = [(int(line["l"]), line["is_success"] == "1") for line in csv.DictReader(file)]
    lengths, successes = zip(*episodes, strict=True)
    return np.cumsum(lengths), np.array(successes)


def read_entries(result: Path, name: str) -> list[dict[str, Any]]:
    """Return the entries of a result file, whose runs tell their packages themselves; none if there is no file."""
    if not result.exists():
        return []
    content = read_json(result)
    for run in (run for entry in content[name] for run in entry["runs"]):
        run["packages"] = content["packages"][run["packages"]]
    return content[name]


def put_runs(
    result: Path,
    name: str,
    head: dict[str, Any],
    what: dict[str, Any],
    facts: dict[str, Any],
    runs: list[dict[str, Any]],
    order: Callable[[dict[str, Any]], Any],
) -> list[dict[str, Any]]:
    """Put runs in place of those of the same seeds in a result file; return all its entries.

    Args:
        result: the file.
        name: of the list of its entries.
        head: that stands before them.
        what: that tells the entry of the runs from all others.
        facts: that the entry says of itself beside.
        runs: with their seeds.
        order: of an entry, what entries are sorted by.
    """
    known = read_entries(result, name)
    same = [each for each in known if all(each[key] == value for key, value in what.items())]
    kept = {run["seed"]: run for each in same for run in each["runs"]} | {run["seed"]: run for run in runs}
    own = {**what, **facts, "runs": [kept[seed] for seed in sorted(kept)]}
    entries = sorted([*(each for each in known if each not in same), own], key=order)
    _write_entries(result, name, head, entries)
    return entries


def _write_entries(result: Path, name: str, head: dict[str, Any], entries: list[dict[str, Any]]) -> None:
    """Write entries, a line for each of their many runs; packages are told once and runs count them, from 0."""
    packages: list[dict[str, str]] = []
    lines, told = Lines(), []
    for entry in entries:
        for run in entry["runs"]:
            if run["packages"] not in packages:
                packages.append(run["packages"])
        places = [lines.place({**run, "packages": packages.index(run["packages"])}) for run in entry["runs"]]
        told.append({**entry, "runs": places})
    lines.write(result, {**head, "packages": packages, name: told})
