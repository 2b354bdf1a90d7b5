"""Pretrain by every objective, for the same time and on the same frames: a result file and a page's table.

Run from a checkout's root, on datasets of 64 x 64 pixels; what is finished is not done again:

    .venv/bin/python -m tools.compare.objectives data/demo [DATASET ...] [--seeds 0 1] [--minutes 8]

Objectives are the recipes in pretrain/objectives, each on top of the demo's, which is the last of them.
"""

import argparse
from pathlib import Path
from typing import Any

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from tools.compare.pairs import ENDLESS, RECIPE
from tools.compare.tasks import command, made_by
from tools.page_tables import ENCODERS_PAGE, markdown_table, probe_errors, task_name, write_tables
from tools.record import choices

RESULT = Path("pretrain/results/objectives.json")
FOLDER, WHOLE = Path("pretrain/objectives"), "field"
TOLD_BY_RANDOM = "joint_probe_random_encoder"
"""of a summary, what the row of the untrained encoder tells once"""
ORDER = ["random", "contrastive", "masked", "autoencoder", "depth", "anchors"]
ORDER += ["field-rgb", "field-semantic", "field-depth", "field-features", WHOLE, "supervised"]


def main() -> None:
    """Run the objectives one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="+", type=Path)
    parser.add_argument("--objectives", nargs="+", default=ORDER, choices=ORDER)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--threads", type=int, help="of a run; PyTorch's own choice if it is left out")
    parser.add_argument("--work", type=Path, default=Path("data/objectives"), help="folder of the runs")
    parser.add_argument("--table", type=Path, default=RESULT, help="result file, whose other rows stay")
    arguments = parser.parse_args()
    for data in arguments.data:
        for seed in arguments.seeds:
            for objective in arguments.objectives:
                row = {**run(data, objective, seed, arguments), **made_by(arguments)}
                add(row, arguments.table)


def run(data: Path, objective: str, seed: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Train and probe; return the figures."""
    scene = MultiViewDataset(data).manifest["scene"]["name"]
    out = arguments.work / f"{scene.replace('/', '-')}-{seed}-{arguments.minutes:g}-minutes" / objective
    recipes = ["--config", RECIPE]
    recipes += ["--config", str(FOLDER / f"{objective}.yaml")] if objective != WHOLE else []
    keys = ["--steps", ENDLESS, "--max_minutes", str(arguments.minutes), "--seed", str(seed), "--resume", "true"]
    keys += ["--threads", str(arguments.threads)] if arguments.threads else []
    command(out, "pretrain", *recipes, "--data", str(data), "--out", str(out), *keys)
    told = {name: value for name, value in read_json(out / SUMMARY).items() if name != TOLD_BY_RANDOM}
    return {"scene": scene, "objective": objective, "seed": seed, **told}


def add(row: dict[str, Any], file: Path) -> None:
    """Write a row into the result file, in place of one of the same run, and the page's table."""
    what = ("scene", "seed", "minutes", "objective")
    known = read_json(file)["runs"] if file.exists() else []
    rows = [*(other for other in known if [other[key] for key in what] != [row[key] for key in what]), row]
    rows.sort(key=lambda one: (one["scene"], one["seed"], one["minutes"], ORDER.index(one["objective"])))
    words = "python -m tools.compare.objectives DATASETS --seeds SEEDS --minutes MINUTES --threads THREADS"
    write_json(file, {"command": words, "recipes": [RECIPE, str(FOLDER)], "runs": rows})
    if file == RESULT:
        write_tables(ENCODERS_PAGE, {"objectives": table(rows)})
        choices.main()


def table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each run with the probe's RMSE of every state column that varies, goals apart."""
    header = ["task", "seed", "minutes", "objective", "steps", "PSNR [dB]", "mIoU", "probe [mm]"]
    lines = []
    for row in rows:
        figures = row["validation"]
        probe = probe_errors(row["probe"])
        shown = (f"{figures['psnr_db']:.1f}", f"{figures['miou']:.2f}") if figures else ("", "")
        budget = f"{row['minutes']:g}"
        lines.append(
            [task_name(row["scene"]), row["seed"], budget, row["objective"], f"{row['steps']:,}", *shown, probe]
        )
    return markdown_table(header, lines)


if __name__ == "__main__":
    main()
