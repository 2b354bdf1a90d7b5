"""Compare what encoders learn from fast and from smooth pictures of the same episodes: a result file and a table.

Run from a checkout's root, with nothing else running:

    .venv/bin/python -m tools.compare.quality SCENE [SCENE ...] [--recipe datasets/demo.yaml] [--minutes 8] [--seed 0]

The datasets differ in nothing but how they are drawn. The two trainings go side by side with a thread each, by the
demo's recipe, for as many steps as the minutes allow; each is validated on pictures of its own kind.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions, processor
from tools.compare.pairs import RECIPE, train_pair
from tools.compare.tasks import things
from tools.page_tables import ENCODERS_PAGE, markdown_table, probe_errors, task_name, write_tables

RESULT = Path("pretrain/results/quality.json")
ARMS = ("fast", "smooth")
COMMAND = "python -m tools.compare.quality SCENES --recipe RECIPE --minutes MINUTES --seed SEED"


def main() -> None:
    """Run the pairs one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="such as metaworld/soccer-v3")
    parser.add_argument("--recipe", default="datasets/demo.yaml", help="of the datasets")
    parser.add_argument("--minutes", type=float, default=8.0)
    parser.add_argument("--seed", type=int, default=0, help="of frames and trainings")
    parser.add_argument("--work", type=Path, default=Path("runs/quality"), help="folder of datasets and runs")
    arguments = parser.parse_args()
    made_by = {"git_revision": git_revision(), "packages": package_versions(), "processor": processor()}
    for scene in arguments.scenes:
        folder = arguments.work / f"{scene.replace('/', '-').replace(':', '-')}-{arguments.seed}"
        data = {arm: folder / f"data-{arm}" for arm in ARMS}
        seconds = {arm: rendered(scene, arguments.recipe, arguments.seed, arm, data[arm]) for arm in ARMS}
        keys = {arm: ["--data", str(data[arm])] for arm in ARMS}
        pair = train_pair(data[ARMS[0]], arguments.seed, arguments.minutes, keys, folder)
        about = {"recipe": arguments.recipe, **made_by, "minutes": arguments.minutes}
        own = [{"arm": arm, "rendering_seconds": seconds[arm], **pair[arm], **about} for arm in ARMS]
        known = read_json(RESULT)["runs"] if RESULT.exists() else []
        others = [row for row in known if (row["scene"], row["seed"]) != (scene, arguments.seed)]
        rows = sorted([*others, *own], key=lambda row: (row["scene"], row["seed"], ARMS.index(row["arm"])))
        write_json(RESULT, {"command": COMMAND, "recipe": RECIPE, "runs": rows})
        write_tables(ENCODERS_PAGE, {"quality": table(rows)})


def rendered(scene: str, recipe: str, seed: int, quality: str, out: Path) -> float:
    """Render a dataset unless it is there; return how long that took [s]."""
    if not (out / SUMMARY).is_file():
        keys = ["--config", recipe, "--scene", scene, "--seed", str(seed), "--quality", quality]
        command = [sys.executable, "-m", "nerf_rl.cli", "gen-dataset", *keys, "--out", str(out), "--resume", "true"]
        subprocess.run(command, check=True)
    return read_json(out / SUMMARY)["seconds"]


def table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each run."""
    header = ["scene", "seed", "pictures", "rendering [s]", "minutes", "steps", "PSNR [dB]", "SSIM", "depth error [cm]"]
    lines = []
    for row in rows:
        figures = row["validation"]
        columns = probe_errors(row["probe"])
        about = [task_name(row["scene"]), row["seed"], row["arm"], f"{row['rendering_seconds']:.0f}"]
        about += [f"{row['minutes']:g}", f"{row['steps']:,}", f"{figures['psnr_db']:.1f}", f"{figures['ssim']:.2f}"]
        lines.append([*about, f"{100 * figures['depth_mae_m']:.1f}", things(row), columns])
    return markdown_table([*header, "IoU of the classes", "probe [mm]"], lines)


if __name__ == "__main__":
    main()
