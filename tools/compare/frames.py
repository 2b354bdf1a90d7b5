"""Train encoders on other frames of the same tasks, for the same time: a result file and a page's table.

Run from a checkout's root; what is finished is not done again:

    .venv/bin/python -m tools.compare.frames hammer drawer-open [--about ways] [--seeds 0] [--minutes 2]

Each arm renders the demo's recipe with some keys changed and learns by `--objective anchors`, which shows soonest what
frames teach. All are measured on held-out frames of two kinds, of the demo's recipe and of another arm: episodes that
no arm trained on, since a seed holds out the same ones whatever the other keys are.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.pretrain.measures.linear_probe import encode_frames, linear_probe
from nerf_rl.pretrain.measures.probe_targets import LEAST_DEVIATION, column_targets
from nerf_rl.pretrain.model.encoder import Encoder
from tools.compare.pairs import ENDLESS
from tools.compare.tasks import DATASET_RECIPE, RECIPE, command, made_by
from tools.page_tables import markdown_table, write_tables

PAGE = Path("docs/choosing.md")
OBJECTIVE = "pretrain/objectives/anchors.yaml"
PROBED = 4000  # training frames that a probe is fitted on, as in the demo
DEMO = "demo"


class Comparison(NamedTuple):
    """Arms of which all are measured on held-out frames of the demo's recipe and of one other."""

    arms: Mapping[str, Mapping[str, str]]
    """what differs from the demo's recipe, by the arm's name; the first is the demo's"""
    other: str
    """the second arm that frames are held out of"""
    result: Path
    """its file"""
    table: str
    """its name in the page"""


COMPARISONS = {
    "ways": Comparison(
        {
            DEMO: {},
            "short ways": {
                "behaviour.random": "0.35",
                "behaviour.longest_hold": "40",
                "behaviour.scripted": "0.15",
                "behaviour.noisy": "0.5",
            },
            "10 frames an episode": {"frames_per_episode": "10"},
        },
        "short ways",
        Path("datasets/results/frames.json"),
        "choosing-arms",
    ),
    "places": Comparison(
        {DEMO: {}, "scattered": {"behaviour.scattered": "0.5"}},
        "scattered",
        Path("datasets/results/scattered.json"),
        "choosing-scattered",
    ),
}


def main() -> None:
    """Render and train the arms one after another, then measure all; write what is known after each task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+", help="such as drawer-open")
    parser.add_argument("--about", default="ways", choices=list(COMPARISONS), help="what is compared")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--minutes", type=float, default=2.0)
    parser.add_argument("--threads", type=int, help="of a run; PyTorch's own choice if it is left out")
    parser.add_argument("--work", type=Path, default=Path("data/frames"), help="folder of datasets and runs")
    parser.add_argument("--table", type=Path, help="result file, whose other rows stay; the page's, if it is left out")
    arguments = parser.parse_args()
    comparison = COMPARISONS[arguments.about]
    for task in arguments.tasks:
        for seed in arguments.seeds:
            folder = arguments.work / f"{task}-{seed}"
            for arm, changed in comparison.arms.items():
                make(folder_of(folder, arm), changed, task, seed, arguments)
            for arm in comparison.arms:
                row = {"task": task, "seed": seed, **measure(folder, arm, comparison), **made_by(arguments)}
                add(row, arguments.about, arguments.table or comparison.result)


def folder_of(folder: Path, arm: str) -> Path:
    """Return the folder of an arm's dataset and encoder in that of a task and seed."""
    return folder / arm.replace(" ", "-")


def make(folder: Path, changed: Mapping[str, str], task: str, seed: int, arguments: argparse.Namespace) -> None:
    """Render an arm's frames, by the demo's recipe with some keys changed, and train on them."""
    data, encoder = folder / "data", folder / "encoder"
    keys = [word for key, value in changed.items() for word in (f"--{key}", value)]
    scene = ["--scene", f"metaworld/{task}-v3", "--seed", str(seed)]
    command(data, "gen-dataset", "--config", DATASET_RECIPE, *scene, *keys, "--out", str(data), "--resume", "true")
    keys = ["--steps", ENDLESS, "--max_minutes", str(arguments.minutes), "--seed", str(seed), "--resume", "true"]
    keys += ["--threads", str(arguments.threads)] if arguments.threads else []
    recipes = ["--config", RECIPE, "--config", OBJECTIVE]
    command(encoder, "pretrain", *recipes, "--data", str(data), "--out", str(encoder), *keys)


def measure(folder: Path, arm: str, comparison: Comparison) -> dict[str, Any]:
    """Return an arm's errors on held-out frames, by the arm that those are of and by column of the true state."""
    own = folder_of(folder, arm)
    encoder, dataset = Encoder.load(own / "encoder"), MultiViewDataset(own / "data")
    train = dataset.split("train")
    fitted = train[np.linspace(0, len(train) - 1, min(PROBED, len(train))).astype(int)]
    latents, known = encode_frames(encoder, dataset, fitted), positions(dataset, fitted)
    errors = {}
    for other in (DEMO, comparison.other):
        seen = MultiViewDataset(folder_of(folder, other) / "data")
        queries = encode_frames(encoder, seen, seen.split("validation"))
        truth = positions(seen, seen.split("validation"))
        read = linear_probe(latents, np.stack(list(known.values()), axis=1), queries)
        errors[other] = {
            name: describe(read[:, i] - truth[name])
            for i, name in enumerate(known)
            if min(known[name].std(), truth[name].std()) > LEAST_DEVIATION
        }
    steps = read_json(own / "encoder" / SUMMARY)["steps"]
    return {"arm": arm, "changed": comparison.arms[arm], "frames": len(dataset), "steps": steps, "errors": errors}


def positions(dataset: MultiViewDataset, frames: ndarray) -> dict[str, ndarray]:
    """Return the columns of the true state in some frames [m], without goals, of which some are not drawn."""
    targets = column_targets(dataset, frames)
    return {target.name: target.values[:, 0] for target in targets if not target.name.startswith("goal_")}


def describe(errors: ndarray) -> dict[str, float]:
    """Return the root of the mean square and the median of errors in metres [mm]."""
    millimetres = 1000.0 * np.abs(errors)
    return {"rmse_mm": float(np.sqrt((millimetres**2).mean())), "median_mm": float(np.median(millimetres))}


def add(row: dict[str, Any], about: str, file: Path) -> None:
    """Write a row into a result file, in place of one of the same run, and the page's table if the file is its own."""
    comparison, what = COMPARISONS[about], ("task", "seed", "minutes", "arm")
    known = read_json(file)["runs"] if file.exists() else []
    rows = [*(other for other in known if [other[key] for key in what] != [row[key] for key in what]), row]
    rows.sort(key=lambda one: (one["task"], one["seed"], one["minutes"], list(comparison.arms).index(one["arm"])))
    words = f"python -m tools.compare.frames TASKS --about {about} --seeds SEEDS --minutes MINUTES --threads THREADS"
    write_json(file, {"command": words, "recipes": [DATASET_RECIPE, RECIPE, OBJECTIVE], "runs": rows})
    if file == comparison.result:
        write_tables(PAGE, {comparison.table: table(rows, comparison)})


def table(rows: list[dict[str, Any]], comparison: Comparison) -> str:
    """Return a row for each arm: errors of the hand and of the rest, on held-out frames of both kinds."""
    header, measured_on = ["task", "seed", "frames of", "frames"], (DEMO, comparison.other)
    header += [f"{what}, {where} [mm]" for where in measured_on for what in ("hand", "objects")]
    lines = []
    for row in rows:
        cells = [part for where in measured_on for part in both(row["errors"][where])]
        lines.append([row["task"], row["seed"], row["arm"], f"{row['frames']:,}", *cells])
    return markdown_table(header, lines)


def both(errors: Mapping[str, Mapping[str, float]]) -> tuple[str, str]:
    """Return the errors of the hand's columns and those of the others."""
    hand = [f"{figure['rmse_mm']:.1f}" for name, figure in errors.items() if name.startswith("hand_")]
    others = [f"{figure['rmse_mm']:.1f}" for name, figure in errors.items() if not name.startswith("hand_")]
    return " ".join(hand), " ".join(others)


if __name__ == "__main__":
    main()
