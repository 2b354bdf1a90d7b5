"""Compare encoders that look for landmarks with ones that do not, at equal wall time: a result file and a table.

Run from a checkout's root, with nothing else running:

    .venv/bin/python -m tools.compare.landmarks DATASET [DATASET ...] [--minutes 8] [--seeds 0]

The two runs of a pair go side by side with a thread each; they have the demo's recipe and as many steps as the minutes
allow.
"""

import argparse
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.versions import git_revision, package_versions, processor
from tools.compare.pairs import RECIPE, train_pair
from tools.compare.tasks import things
from tools.page_tables import ENCODERS_PAGE, markdown_table, probe_errors, write_tables

RESULT = Path("pretrain/results/landmarks.json")
ARMS = {"without": ["--encoder.landmarks", "false"], "with": ["--encoder.landmarks", "true"]}
COMMAND = "python -m tools.compare.landmarks DATASETS --minutes MINUTES --seeds SEEDS"


def main() -> None:
    """Run the pairs one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="+", type=Path, help="datasets of the demo's recipe")
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--work", type=Path, default=Path("runs/landmarks"), help="folder of the runs")
    arguments = parser.parse_args()
    made_by = {"git_revision": git_revision(), "packages": package_versions(), "processor": processor()}
    for data in arguments.data:
        for seed in arguments.seeds:
            folder = arguments.work / f"{data.resolve().parent.name}-{seed}"
            pair = train_pair(data, seed, arguments.minutes, ARMS, folder)
            own = [{"arm": arm, **summary, **made_by, "minutes": arguments.minutes} for arm, summary in pair.items()]
            known = read_json(RESULT)["runs"] if RESULT.exists() else []
            others = [row for row in known if (row["scene"], row["seed"]) != (own[0]["scene"], seed)]
            rows = sorted([*others, *own], key=lambda row: (row["scene"], row["seed"], list(ARMS).index(row["arm"])))
            write_json(RESULT, {"command": COMMAND, "recipe": RECIPE, "runs": rows})
            write_tables(ENCODERS_PAGE, {"landmarks": table(rows)})


def table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each run."""
    header = ["task", "seed", "landmarks", "steps", "PSNR [dB]", "depth error [cm]", "IoU of the classes", "probe [mm]"]
    lines = []
    for row in rows:
        figures = row["validation"]
        columns = probe_errors(row["probe"])
        task = row["scene"].removeprefix("metaworld/").removesuffix("-v3")
        quality = f"{figures['psnr_db']:.1f}", f"{100 * figures['depth_mae_m']:.1f}"
        lines.append([task, row["seed"], row["arm"], f"{row['steps']:,}", *quality, things(row), columns])
    return markdown_table(header, lines)


if __name__ == "__main__":
    main()
