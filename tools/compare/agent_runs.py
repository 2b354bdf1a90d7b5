"""Agents that tools compare: trained if they are missing, and kept in result files by their seeds."""

import csv
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import PROVENANCE
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION
from nerf_rl.rl.sweeps.runs import read_run

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


def row(run: Path) -> dict[str, Any]:
    """Return what is told of a run, what it saw by, how many of its last training episodes succeeded, what made it."""
    provenance = read_json(run / PROVENANCE)
    versions = {name: provenance[name] for name in ("git_revision", "packages", "processor")}
    facts = {"encoder": read_json(run / POLICY_DESCRIPTION)["encoder_digest"]}
    return {**read_run(run), **facts, "late_training_success": late_training_success(run), **versions}


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
    known = read_json(result)[name] if result.exists() else []
    same = [each for each in known if all(each[key] == value for key, value in what.items())]
    kept = {run["seed"]: run for each in same for run in each["runs"]} | {run["seed"]: run for run in runs}
    own = {**what, **facts, "runs": [kept[seed] for seed in sorted(kept)]}
    entries = sorted([*(each for each in known if each not in same), own], key=order)
    write_json(result, {**head, name: entries})
    return entries
