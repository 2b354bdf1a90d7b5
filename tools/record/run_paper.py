"""Run the experiments of rl/paper/experiments.yaml: one `nerf-rl train-rl` for each seed, a few at a time.

Run from a checkout's root; what is finished is skipped, and what was interrupted goes on:

    .venv/bin/python -m tools.record.run_paper                       # all of them
    .venv/bin/python -m tools.record.run_paper reach-ppo --jobs 1    # some of them
"""

import argparse
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from nerf_rl.files.outputs import SUMMARY

EXPERIMENTS = Path("rl/paper/experiments.yaml")
RUNS = Path("runs/paper")


@dataclass(frozen=True)
class Run:
    """One seed of one experiment."""

    experiment: str
    seed: int
    recipe: str
    keys: dict[str, Any]

    @property
    def folder(self) -> Path:
        """Where it is written."""
        return RUNS / self.experiment / f"seed-{self.seed}"

    @property
    def command(self) -> list[str]:
        """The arguments of nerf-rl."""
        keys = [word for key, value in self.keys.items() for word in (f"--{key}", str(value))]
        return ["train-rl", "--config", self.recipe, *keys, "--seed", str(self.seed), "--out", str(self.folder)]


def main() -> None:
    """Run what is left; exit with 1 if a run failed."""
    experiments = read_experiments()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"experiments, of: {', '.join(experiments)}")
    parser.add_argument("--jobs", type=int, default=max(1, (os.cpu_count() or 2)), help="runs at a time")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(experiments):
        parser.error(f"unknown experiment {', '.join(sorted(unknown))}; available: {', '.join(experiments)}")
    chosen = arguments.names or list(experiments)
    runs = [run for name in chosen for run in runs_of(name, experiments[name])]
    left = [run for run in runs if not (run.folder / SUMMARY).is_file()]
    print(f"{len(runs) - len(left)} of {len(runs)} runs are finished", flush=True)
    failed = 0
    with ThreadPoolExecutor(arguments.jobs) as pool:
        futures = {pool.submit(execute, run): run for run in left}
        for done, future in enumerate(as_completed(futures), 1):
            run, (code, seconds) = futures[future], future.result()
            failed += code != 0
            outcome = f"{seconds:.0f} s" if code == 0 else f"FAILED, see {log_of(run)}"
            print(f"{done}/{len(left)} {run.experiment} seed {run.seed}: {outcome}", flush=True)
    sys.exit(1 if failed else 0)


def read_experiments() -> dict[str, dict[str, Any]]:
    """Return the experiments by name."""
    return yaml.safe_load(EXPERIMENTS.read_text(encoding="utf-8"))["experiments"]


def runs_of(name: str, experiment: dict[str, Any]) -> list[Run]:
    """Return the runs of an experiment."""
    return [Run(name, seed, experiment["recipe"], experiment.get("keys", {})) for seed in experiment["seeds"]]


def log_of(run: Run) -> Path:
    """Return where a run's output goes."""
    return run.folder.with_suffix(".log")


def execute(run: Run) -> tuple[int, float]:
    """Run it, resuming if possible; return its exit code and the time it took [s]."""
    start = time.monotonic()
    run.folder.parent.mkdir(parents=True, exist_ok=True)
    with open(log_of(run), "a", encoding="utf-8") as log:
        command = [Path(sys.executable).parent / "nerf-rl", *run.command, "--resume", "true"]
        code = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL).returncode
    return code, time.monotonic() - start


if __name__ == "__main__":
    main()
