"""Compare the samplers of `nerf-rl tune` on rl/paper/tune.yaml, and what they find with the paper's values.

Run from a checkout's root; what is finished is skipped. It writes rl/results/tuning.json and tuning.png, and the table
in docs/results/paper.md:

    .venv/bin/python -m tools.compare.samplers --jobs 2

Each sampler searches with the same budget from several seeds. What each search found, and the values that the paper's
own whale optimisation found (its Table 2), then train the same agent from new seeds, with more evaluation episodes.
"""

import argparse
import csv
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import yaml
from matplotlib.figure import Figure

from nerf_rl.files.atomic import atomic_write
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import PROVENANCE, SUMMARY
from nerf_rl.tuning.results import TRIALS
from tools.page_tables import PAPER_PAGE, markdown_table, write_tables

RECIPE = Path("rl/paper/tune.yaml")
RUNS = Path("runs/paper/tuning")
RESULTS = Path("rl/results")
SEARCHES = {
    "whale": ["--sampler", "whale"],
    "TPE": ["--sampler", "tpe"],
    "CMA-ES": ["--sampler", "cmaes"],
    "random": ["--sampler", "random"],
}
REPEATS = (0, 1, 2)
TABLE_2 = {
    "learner.actor_rate": 7.08e-4,
    "learner.critic_rate": 5.32e-3,
    "learner.gamma": 0.958,
    "learner.tau": 7.57e-3,
    "learner.batch_size": 174,
    "noise.start": 0.477,
    "replay.capacity": 60_167,
}
TEST_SEEDS = range(100, 105)  # none that a search has used
TEST_EPISODES = 50
PAPER = "the paper's Table 2"


def main() -> None:
    """Search, test what was found, record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=max(1, os.cpu_count() or 2), help="searches or tests at a time")
    jobs = parser.parse_args().jobs
    searches = [(name, repeat) for repeat in REPEATS for name in SEARCHES]
    with ThreadPoolExecutor(jobs) as pool:
        if not all(list(pool.map(lambda search: run_search(*search), searches))):
            sys.exit(f"a search failed; see the logs in {RUNS}")
        found = {(name, repeat): read_json(folder(name, repeat) / SUMMARY)["best_params"] for name, repeat in searches}
        candidates = {**found, (PAPER, 0): TABLE_2}
        tests = [(name, repeat, values, seed) for (name, repeat), values in candidates.items() for seed in TEST_SEEDS]
        if not all(list(pool.map(lambda test: run_test(*test), tests))):
            sys.exit(f"a test failed; see the logs in {RUNS}")
    record(candidates)


def folder(name: str, repeat: int) -> Path:
    """Return where a search is."""
    return RUNS / f"{''.join(c if c.isalnum() else '-' for c in name.lower())}-{repeat}"


def test_folder(name: str, repeat: int, seed: int) -> Path:
    """Return where a test is."""
    return folder(name, repeat).with_name(f"{folder(name, repeat).name}-test-{seed}")


def run_search(name: str, repeat: int) -> bool:
    """Run a search, unless it is finished; return whether it succeeded."""
    keys = ["--config", str(RECIPE), *SEARCHES[name], "--seed", str(repeat)]
    return execute(folder(name, repeat), ["tune", *keys])


def run_test(name: str, repeat: int, values: dict[str, Any], seed: int) -> bool:
    """Train with the values from a new seed, unless that is done; return whether it succeeded."""
    search = yaml.safe_load(RECIPE.read_text(encoding="utf-8"))
    keys = {
        **search["overrides"],
        **values,
        "evaluation_to_end": "true",
        "final_evaluation_episodes": TEST_EPISODES,
        "seed": seed,
    }
    words = [word for key, value in keys.items() for word in (f"--{key}", str(value))]
    return execute(test_folder(name, repeat, seed), ["train-rl", "--config", search["recipe"], *words])


def execute(out: Path, arguments: list[str]) -> bool:
    """Run nerf-rl into a folder, going on where it was interrupted."""
    if (out / SUMMARY).is_file():
        return True
    out.parent.mkdir(parents=True, exist_ok=True)
    with open(out.with_suffix(".log"), "a", encoding="utf-8") as log:
        command = [Path(sys.executable).parent / "nerf-rl", *arguments, "--out", str(out), "--resume", "true"]
        done = subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, check=False)
    print(out.name, "done" if done.returncode == 0 else "FAILED", flush=True)
    return done.returncode == 0


def record(candidates: dict[tuple[str, int], dict[str, Any]]) -> None:
    """Write the result file and the table."""
    entries = []
    for (name, repeat), values in candidates.items():
        tests = [read_json(test_folder(name, repeat, seed) / SUMMARY)["evaluations"][-1] for seed in TEST_SEEDS]
        entry = {
            "name": name,
            "repeat": repeat,
            "values": values,
            "test_returns": [test["mean_return"] for test in tests],
            "test_success": [test["success_rate"] for test in tests],
            "test_provenance": read_json(test_folder(name, repeat, TEST_SEEDS[0]) / PROVENANCE),
        }
        if name in SEARCHES:
            summary = read_json(folder(name, repeat) / SUMMARY)
            entry |= {key: summary[key] for key in ("best_value", "trials", "env_steps", "trial_seconds")}
            entry["provenance"] = read_json(folder(name, repeat) / PROVENANCE)
        entries.append(entry)
    content = {"recipe": str(RECIPE), "test_seeds": list(TEST_SEEDS), "test_episodes": TEST_EPISODES}
    write_json(RESULTS / "tuning.json", {**content, "entries": entries})
    draw(RESULTS / "tuning.png")
    write_tables(PAPER_PAGE, {"tuning": table(entries)})


def draw(path: Path) -> None:
    """Draw how far each search was from a return of 0 as it went on; it is never above 0."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for index, name in enumerate(SEARCHES):
        for repeat in REPEATS:
            steps, best = best_so_far(folder(name, repeat) / TRIALS)
            label = name if repeat == REPEATS[0] else None
            axes.step(steps, [-value for value in best], where="post", color=f"C{index}", alpha=0.8, label=label)
    axes.set(xlabel="environment steps of the search", ylabel="minus the best return so far", yscale="log")
    axes.legend()
    with atomic_write(path) as aside:
        figure.savefig(aside, format="png", dpi=100)


def best_so_far(trials: Path) -> tuple[list[int], list[float]]:
    """Return the environment steps spent after each trial, failed ones included, and the best fitness by then."""
    with open(trials, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    steps = accumulate(int(row["env_steps"]) for row in rows)
    return list(steps), list(accumulate((float(row["value"] or "-inf") for row in rows), max))


def table(entries: list[dict[str, Any]]) -> str:
    """Return a row for each sampler and one for the paper's values."""
    rows = []
    for name in [*SEARCHES, PAPER]:
        own = [entry for entry in entries if entry["name"] == name]
        returns = [mean(entry["test_returns"]) for entry in own]
        every = [value for entry in own for value in entry["test_returns"]]
        success = mean(value for entry in own for value in entry["test_success"])
        spent = {entry["env_steps"] for entry in own if "env_steps" in entry}
        rows.append(
            [
                name,
                f"{max(spent):,}" if spent else "fewer than 100 iterations",
                f"{mean(every):.2f} ({stdev(every):.2f})",
                ", ".join(f"{value:.2f}" for value in returns),
                f"{success:.1%}",
            ]
        )
    header = ["settings of", "env steps of a search", "return, mean (deviation of runs)", "of each search", "success"]
    return markdown_table(header, rows)


if __name__ == "__main__":
    main()
