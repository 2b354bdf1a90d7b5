"""Compare whole pretraining runs in float32 and bfloat16 at equal wall time: a result file and a page's table.

Run from a checkout's root, with nothing else running:

    .venv/bin/python -m tools.compare.precision data/demo [DATASET ...] [--minutes 8.5] [--seeds 0 1]

The two runs of a pair go side by side with a thread each, so that whatever slows one of them slows the other; they have
the demo's recipe and as many steps as the minutes allow. By this table `auto` chooses.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.versions import git_revision, package_versions, processor
from tools.compare.pairs import RECIPE, train_pair
from tools.page_tables import markdown_table, probe_errors, write_tables

RESULT, README = Path("pretrain/results/precision.json"), Path("pretrain/README.md")
PRECISIONS = ("32", "bf16")
COMMAND = "python -m tools.compare.precision DATASETS --minutes MINUTES --seeds SEEDS"


def main() -> None:
    """Run the pairs one after another; write what is known after each, in place of this processor's runs before."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="+", type=Path, help="datasets of 64 x 64 pixels, such as data/demo")
    parser.add_argument("--minutes", type=float, default=8.5)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    arguments = parser.parse_args()
    own = {
        "processor": processor(),
        "git_revision": git_revision(),
        "packages": package_versions(),
        "minutes": arguments.minutes,
    }
    known = read_json(RESULT)["machines"] if RESULT.exists() else []
    others = [machine for machine in known if machine["processor"] != own["processor"]]
    runs: list[dict[str, Any]] = []
    for data in arguments.data:
        for seed in arguments.seeds:
            runs += pair(data, seed, arguments.minutes)
            machines = [*others, {**own, "runs": runs}]
            write_json(RESULT, {"command": COMMAND, "recipe": RECIPE, "machines": machines})
            write_tables(README, {"precision": table(machines)})


def pair(data: Path, seed: int, minutes: float) -> list[dict[str, Any]]:
    """Train in both precisions side by side; return both summaries."""
    with tempfile.TemporaryDirectory() as folder:
        keys = {name: ["--precision", name] for name in PRECISIONS}
        return list(train_pair(data, seed, minutes, keys, Path(folder)).values())


def table(machines: list[dict[str, Any]]) -> str:
    """Return a row for each run on each processor."""
    header = ["processor", "scene", "seed", "precision", "steps/s", "PSNR [dB]", "mIoU", "depth error [cm]"]
    rows = []
    for run in ({**run, "processor": machine["processor"]} for machine in machines for run in machine["runs"]):
        figures = run["validation"]
        probe = probe_errors(run["probe"])
        quality = f"{figures['psnr_db']:.1f}", f"{figures['miou']:.2f}", f"{100 * figures['depth_mae_m']:.1f}"
        what = run["processor"], run["scene"].removeprefix("metaworld/"), run["seed"], run["precision"]
        rows.append([*what, f"{run['steps'] / run['training_seconds']:.1f}", *quality, probe])
    return markdown_table([*header, "probe [mm]"], rows)


if __name__ == "__main__":
    main()
