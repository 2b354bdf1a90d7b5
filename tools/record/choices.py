"""Write the tables of docs/choosing.md from the result files that they name.

.venv/bin/python -m tools.record.choices
"""

from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
import yaml

from nerf_rl.files.json_files import read_json
from tools.page_tables import markdown_table, task_name, write_tables

PAGE = Path(__file__).parents[2] / "docs" / "choosing.md"
ROOT = PAGE.parents[1]
_BYTES_OF_A_PIXEL = 8  # colour, depth and label
_CAMERAS = {"validation": "the encoder's", "supervision": "random poses", "test": "test cameras"}


def main() -> None:
    """Rewrite the page's tables."""
    write_tables(PAGE, tables())


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
    """Return a row for each objective and time: its errors as shares of an untrained encoder's, the best object first.

    A cell has those of a task's hand and of all its objects, means over columns and seeds. Scenes that lack either are
    left out.
    """
    shares: dict[tuple[float, str], dict[str, list[tuple[float, float]]]] = {}
    for run in results["runs"]:
        if found := errors(run):
            shares.setdefault((run["minutes"], run["objective"]), {}).setdefault(run["scene"], []).append(found)
    tasks = sorted({task for cells in shares.values() for task in cells})
    rows = []
    for (minutes, objective), cells in shares.items():
        means = {task: np.mean(cells[task], axis=0) for task in cells}
        told = [", ".join(map(percent, means[task])) if task in means else "" for task in tasks]
        rows.append((mean(float(objects) for _, objects in means.values()), [f"`{objective}`", f"{minutes:g}", *told]))
    header = ["objective", "minutes", *map(task_name, tasks)]
    return markdown_table(header, [row for _, row in sorted(rows, key=lambda row: row[0])])


def errors(run: dict[str, Any]) -> tuple[float, float] | None:
    """Return a run's errors of hand and objects, as shares of an untrained encoder's; None if it lacks either."""
    shares = {
        name: figure["rmse_mm"] / run["probe_random_encoder"][name]["rmse_mm"] for name, figure in run["probe"].items()
    }
    hand = [share for name, share in shares.items() if name.startswith("hand_")]
    objects = [share for name, share in shares.items() if not name.startswith(("hand_", "goal_"))]
    return (mean(hand), mean(objects)) if hand and objects else None


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
