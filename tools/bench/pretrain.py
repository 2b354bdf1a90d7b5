"""Pretrain by several recipes for the same time: rays, memory, pictures and probes; a result file and a page's table.

Run from a checkout's root, on a dataset of 64 x 64 pixels:

    .venv/bin/python -m tools.bench.pretrain data/demo [--recipes pretrain/demo.yaml pretrain/snerl-original.yaml]

The last recipe is what the others are compared with. Nothing else may run beside it, unless one core is left to it and
what runs on the other one is the same all the time (``--threads 1``).
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from nerf_rl.arguments.parsing import parse_config
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions, processor
from nerf_rl.pretrain.config import PretrainConfig
from tools.compare.pairs import ENDLESS
from tools.compare.tasks import command
from tools.page_tables import markdown_table, probe_errors, write_tables

RESULT, README = Path("pretrain/results/speed.json"), Path("pretrain/README.md")


def main() -> None:
    """Run the recipes one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--recipes", nargs="+", default=["pretrain/demo.yaml", "pretrain/snerl-original.yaml"])
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, help="of a run; PyTorch's own choice if it is left out")
    arguments = parser.parse_args()
    head = {
        "command": " ".join(["python -m tools.bench.pretrain", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": package_versions(),
        "processor": processor(),
        "scene": MultiViewDataset(arguments.data).manifest["scene"]["name"],
        "minutes": arguments.minutes,
        "threads": arguments.threads,
    }
    runs: list[dict[str, Any]] = []
    for recipe in arguments.recipes:
        runs.append(run(recipe, arguments))
        write_json(RESULT, {**head, "runs": runs})
    write_tables(README, {"speed": table(runs)})


def run(recipe: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Train and probe; return the figures."""
    words = ["--config", recipe, "--data", str(arguments.data)]
    config = parse_config(PretrainConfig, "pretrain", "", [*words, "--out", "out"])
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        keys = ["--steps", ENDLESS, "--max_minutes", str(arguments.minutes), "--seed", str(arguments.seed)]
        keys += ["--threads", str(arguments.threads)] if arguments.threads else []
        command(out, "pretrain", *words, "--out", str(out), *keys)
        summary = read_json(out / SUMMARY)
    rays = summary["steps"] * config.scenes_per_step * config.rays_per_scene
    return {"recipe": recipe, "rays_per_second": round(rays / summary["training_seconds"], 1), **summary}


def table(runs: list[dict[str, Any]]) -> str:
    """Return a row for each recipe."""
    header = ["recipe", "rays/s", "peak memory [MB]", "PSNR [dB]", "mIoU", "depth error [cm]", "probe [mm]"]
    rows = []
    for row in runs:
        figures, least = row["validation"], runs[-1]["rays_per_second"]
        probe = probe_errors(row["probe"])
        speed = f"{row['rays_per_second']:,.0f} ({row['rays_per_second'] / least:.0f} x)"
        quality = f"{figures['psnr_db']:.1f}", f"{figures['miou']:.2f}", f"{100 * figures['depth_mae_m']:.1f}"
        rows.append([Path(row["recipe"]).stem, speed, f"{row['peak_rss_mb']:.0f}", *quality, probe])
    return markdown_table(header, rows)


if __name__ == "__main__":
    main()
