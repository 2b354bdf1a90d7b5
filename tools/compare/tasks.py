"""Pretrain with the demo's recipes on several Meta-World tasks: a result file of each task and a page's table.

Run from a checkout's root; what is finished is not done again:

    .venv/bin/python -m tools.compare.tasks drawer-open faucet-open hammer [--seeds 0 1 2] [--minutes 8]

Each task has a dataset of its own for each seed. Beside every encoder stand an untrained one and a supervised one of
the same size, which learns the true state from the same frames. Nothing but the scene and the seed differs.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions, processor
from nerf_rl.pretrain.model.encoder_file import read_description
from nerf_rl.pretrain.model.field_description import DESCRIPTION
from tools.compare.pairs import ENDLESS
from tools.page_tables import ENCODERS_PAGE, markdown_table, write_tables
from tools.result_files import write_runs

RESULTS = Path("pretrain/results/tasks")
"""a file for each task"""
DATASET_RECIPE, RECIPE = "datasets/demo.yaml", "pretrain/demo.yaml"
CEILING_STEPS = "1000"
HAND, ELSE = 6.0, 5.0
"""how far off [mm] a probe may read the hand, and all else"""
OF_SUPERVISED = 1.25
"""how many times as far off as a supervised encoder's it may read what is no part of the hand"""
SMALL = 0.01
"""share of the pixels below which a class is a small one"""
IOU, SMALL_IOU = 0.6, 0.4
"""what classes should be found with, and small ones"""


def main() -> None:
    """Run the tasks one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="+", help="such as drawer-open")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--threads", type=int, help="of a run; PyTorch's own choice if it is left out")
    parser.add_argument("--work", type=Path, default=Path("data/tasks"), help="folder of datasets and runs")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of result files, whose other rows stay")
    arguments = parser.parse_args()
    for task in arguments.tasks:
        for seed in arguments.seeds:
            record({**run(task, seed, arguments), **made_by(arguments)}, arguments.results)


def record(row: dict[str, Any], results: Path) -> None:
    """Put a row in place of that of the same task and seed, and write its task's file and the table of all."""
    others = [other for other in read_rows(results) if (other["task"], other["seed"]) != (row["task"], row["seed"])]
    rows = sorted([*others, row], key=lambda row: (row["task"], row["seed"]))
    command = "python -m tools.compare.tasks TASKS --seeds SEEDS --minutes MINUTES --threads THREADS"
    head = {"command": command, "recipes": [DATASET_RECIPE, RECIPE]}
    results.mkdir(parents=True, exist_ok=True)
    write_runs(results / f"{row['task']}.json", head, [each for each in rows if each["task"] == row["task"]])
    if results == RESULTS:
        write_tables(ENCODERS_PAGE, {"tasks": table(rows)})


def read_rows(results: Path) -> list[dict[str, Any]]:
    """Return the rows of all tasks' files in a folder."""
    return [row for file in sorted(results.glob("*.json")) for row in read_json(file)["runs"]]


def run(task: str, seed: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Render, train and probe; return the figures."""
    data, encoder, probe = (arguments.work / f"{task}-{seed}" / name for name in ("data", "encoder", "probe"))
    scene = ["--scene", f"metaworld/{task}-v3", "--seed", str(seed)]
    command(data, "gen-dataset", "--config", DATASET_RECIPE, *scene, "--out", str(data), "--resume", "true")
    keys = ["--steps", ENDLESS, "--max_minutes", str(arguments.minutes), "--seed", str(seed), "--resume", "true"]
    keys += ["--threads", str(arguments.threads)] if arguments.threads else []
    command(encoder, "pretrain", "--config", RECIPE, "--data", str(data), "--out", str(encoder), *keys)
    keys = ["--ceiling_steps", CEILING_STEPS, "--seed", str(seed), "--overwrite", "true"]
    command(probe, "probe", "--encoder", str(encoder), "--data", str(data), "--out", str(probe), *keys)
    planes = read_json(encoder / DESCRIPTION)["config"]["object_plane_size"]
    quality = read_description(encoder)[1]["scene"]["quality"]
    figures = {**read_json(encoder / SUMMARY), **read_json(probe / SUMMARY)}
    return {"task": task, "seed": seed, "quality": quality, "object_plane_size": planes, **figures}


def made_by(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what a row of figures was made by."""
    versions = {"git_revision": git_revision(), "packages": package_versions(), "processor": processor()}
    return {**versions, "minutes": arguments.minutes, "threads": arguments.threads}


def command(out: Path, *words: str) -> None:
    """Run a command of nerf-rl unless its summary is there."""
    if not (out / SUMMARY).is_file():
        subprocess.run([sys.executable, "-m", "nerf_rl.cli", *words], check=True)


def table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each task and seed; of every state column the encoder's, untrained and supervised RMSE."""
    header = ["task", "seed", "steps", "PSNR [dB]", "depth error [cm]", "IoU of the classes"]
    header += ["probe (untrained, supervised) [mm]", "misses"]
    lines = []
    for row in rows:
        figures = row["validation"]
        columns = ", ".join(
            f"{name} {figure['rmse_mm']:.1f} ({row['probe_random_encoder'][name]['rmse_mm']:.0f}, "
            f"{row['probe_supervised_encoder'][name]['rmse_mm']:.1f})"
            for name, figure in row["probe"].items()
        )
        pictures = [f"{figures['psnr_db']:.1f}", f"{100 * figures['depth_mae_m']:.1f}", things(row)]
        lines.append([row["task"], row["seed"], f"{row['steps']:,}", *pictures, columns, ", ".join(misses(row))])
    return markdown_table(header, lines)


def misses(row: dict[str, Any]) -> list[str]:
    """Return the state columns that a run's probe reads farther off, and the classes that it finds less, than asked."""
    found = []
    for name, figure in row["probe"].items():
        supervised = row["probe_supervised_encoder"][name]["rmse_mm"]
        limit = HAND if name.startswith("hand_") else max(ELSE, OF_SUPERVISED * supervised)
        found += [name] if figure["rmse_mm"] > limit else []
    for name, iou in row["class_iou"].items():
        least = SMALL_IOU if row["class_share"][name] < SMALL else IOU
        found += [name] if iou is not None and iou < least else []
    return found


def things(row: dict[str, Any]) -> str:
    """Return the IoU of a run's classes but the background."""
    classes = row["class_iou"].items()
    return ", ".join(f"{name} {iou:.2f}" for name, iou in classes if iou is not None and name != "background")


if __name__ == "__main__":
    main()
