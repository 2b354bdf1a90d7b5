"""Write the tables of docs/choosing.md from the result files that they name.

.venv/bin/python -m tools.record.choices
"""

from pathlib import Path
from statistics import mean
from typing import Any

import yaml

from nerf_rl.files.atomic import write_text
from nerf_rl.files.json_files import read_json
from tools.readme_tables import markdown_table, replace_tables

PAGE = Path(__file__).parents[2] / "docs" / "choosing.md"
ROOT = PAGE.parents[1]
_BYTES_OF_A_PIXEL = 8  # colour, depth and label
_CAMERAS = {"validation": "the encoder's", "supervision": "random poses", "test": "test cameras"}


def main() -> None:
    """Rewrite the page's tables."""
    write_text(PAGE, replace_tables(PAGE.read_text(), tables()))


def tables() -> dict[str, str]:
    """Return the tables by name."""
    return {
        "choosing-objectives": objectives(read_json(ROOT / "pretrain/results/objectives.json")),
        "choosing-cameras": cameras(read_json(ROOT / "pretrain/results/both_probes.json")),
        "choosing-frames": frames(
            read_json(ROOT / "datasets/results/demo.json"), read_json(ROOT / "datasets/results/generation.json")
        ),
    }


def objectives(results: dict[str, Any]) -> str:
    """Return a row for each run: its errors as shares of an untrained encoder's, the best object first."""
    rows = []
    for run in results["runs"]:
        task = run["scene"].removeprefix("metaworld/").removesuffix("-v3")
        shares = [
            mean(run["probe"][name]["rmse_mm"] / run["probe_random_encoder"][name]["rmse_mm"] for name in columns)
            for group in ("hand", "object")
            if (columns := [name for name in run["probe"] if name.startswith(f"{group}_")])
        ]
        if len(shares) == 2:
            rows.append((shares[1], [task, run["seed"], f"`{run['objective']}`", run["steps"], *map(percent, shares)]))
    header = ["task", "seed", "objective", "steps", "error of the hand", "error of the object"]
    return markdown_table(header, [row for _, row in sorted(rows, key=lambda row: row[0])])


def cameras(results: dict[str, Any]) -> str:
    """Return a row for each set of cameras from which a field was measured."""
    rows = []
    for run in results["runs"]:
        measured = {"validation": run.get("validation"), **run.get("validation_other_cameras", {})}
        for name, figures in measured.items():
            if figures:
                depth = f"{100 * figures['depth_mae_m']:.1f}"
                picture = [f"{figures['psnr_db']:.1f}", f"{figures['ssim']:.2f}", f"{figures['miou']:.2f}", depth]
                rows.append([run["task"], _CAMERAS[name], *picture])
    return markdown_table(["task", "cameras", "PSNR [dB]", "SSIM", "mIoU", "depth error [cm]"], rows)


def frames(demo: dict[str, Any], generation: dict[str, Any]) -> str:
    """Return a row for each recorded generation: what it took, and what it takes on the disk."""
    recipe = yaml.safe_load((ROOT / "datasets/demo.yaml").read_text())
    runs = [
        ("`demo.yaml`", demo, demo["views"] // demo["frames"], recipe["size"]),
        ("drawer-open with its usual cameras", generation, generation["views_per_frame"], generation["keys"]["size"]),
    ]
    rows = []
    for name, run, views, size in runs:
        gigabytes = run["frames"] * views * size * size * _BYTES_OF_A_PIXEL / 1e9
        made = [f"{run['seconds']:.0f} s", f"{run['views_per_second']:.0f}", f"{gigabytes:.1f} GB"]
        rows.append([name, f"{run['frames']:,}", f"{views} of {size} x {size}", *made])
    return markdown_table(["dataset", "frames", "views", "time", "views/s", "on the disk"], rows)


def percent(share: float) -> str:
    """Return a share in per cent."""
    return f"{share:.0%}"


if __name__ == "__main__":
    main()
