"""Measure the Whale Optimisation Algorithm on F1 to F10, as published and with the minimum moved.

Run from a checkout's root; it writes rl/results/whale_functions.json and the table in docs/results/paper.md in minutes:

    .venv/bin/python -m tools.bench.whale
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

from nerf_rl.files.json_files import write_json
from nerf_rl.files.versions import git_revision, package_versions
from nerf_rl.tuning.whale import MODES, minimise
from tools.bench.classical_functions import CLASSICAL, Classical
from tools.page_tables import PAPER_PAGE, markdown_table, write_tables

DIMENSIONS, POPULATION, ITERATIONS = 30, 30, 500
SHIFT = 0.4
UNBOUNDED = ("F8",)  # it has lower minima beyond its box, and moving it would bring them in


def main() -> None:
    """Run all functions, places and modes over the same seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="runs of each")
    seeds = range(parser.parse_args().seeds)
    start = time.monotonic()
    functions = {}
    for name, function in CLASSICAL.items():
        places = {"published": function}
        if name not in UNBOUNDED:
            places["moved"] = function.shifted(SHIFT)
        functions[name] = {
            place: {mode: measure(placed, mode, seeds) for mode in MODES} for place, placed in places.items()
        }
        print(
            name,
            {place: {m: f"{r['median']:.2g}" for m, r in modes.items()} for place, modes in functions[name].items()},
        )
    result = {
        "command": " ".join(["python -m tools.bench.whale", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "numpy": package_versions()["numpy"],
        "dimensions": DIMENSIONS,
        "population": POPULATION,
        "iterations": ITERATIONS,
        "shift": SHIFT,
        "seeds": list(seeds),
        "seconds": round(time.monotonic() - start, 1),
        "functions": functions,
    }
    write_json(Path("rl/results/whale_functions.json"), result)
    write_tables(PAPER_PAGE, {"whale-functions": table(functions)})


def measure(function: Classical, mode: str, seeds: range) -> dict:
    """Return the least values found with each seed, and their median."""
    corner = np.full(DIMENSIONS, function.half_width)
    values = [
        minimise(function.values, -corner, corner, POPULATION, ITERATIONS, np.random.default_rng(seed), mode).value
        for seed in seeds
    ]
    return {"median": float(np.median(values)), "values": values}


def table(functions: dict) -> str:
    """Return a row for each function: medians over the seeds."""
    columns = [(place, mode) for place in ("published", "moved") for mode in MODES]
    rows = [
        [
            CLASSICAL[name].name,
            *(f"{places[place][mode]['median']:.2g}" if place in places else "" for place, mode in columns),
        ]
        for name, places in functions.items()
    ]
    return markdown_table(["function", *(f"{place}, {mode}" for place, mode in columns)], rows)


if __name__ == "__main__":
    main()
