"""Record runs of the full-size recipe: a result file and a page's table.

Run from a checkout's root, with finished runs on one dataset, the longest last:

    .venv/bin/python -m tools.record.full_size runs/full-10-minutes runs/full
"""

import argparse
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import write_json
from nerf_rl.files.versions import processor
from nerf_rl.pretrain.model.encoder_file import read_description
from tools.page_tables import ENCODERS_PAGE, markdown_table, probe_errors, write_tables
from tools.record.demo import read_result

RESULT = Path("pretrain/results/full_size.json")
ROLES = {"test": "a camera that the run never saw", "supervision": "random poses"}


def main() -> None:
    """Copy summaries with their provenance; write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, help="finished runs of pretrain")
    runs = [
        {**read_result(run), "quality": read_description(run)[1]["scene"]["quality"]}
        for run in parser.parse_args().runs
    ]
    write_json(RESULT, {"processor": processor(), "runs": runs})
    write_tables(ENCODERS_PAGE, {"full-size": table(runs)})


def table(runs: list[dict[str, Any]]) -> str:
    """Return a row for each run and each role of cameras; probes stand beside the encoder's own cameras."""
    header = [
        "pictures",
        "steps",
        "training [min]",
        "seen from",
        "PSNR [dB]",
        "SSIM",
        "mIoU",
        "depth error [cm]",
        "probe [mm]",
    ]
    rows = []
    for run in runs:
        probe = probe_errors(run["probe"])
        others = run["validation_other_cameras"]
        drawn = run.get("quality", "fast")  # runs of before there were others do not tell
        rows.append([drawn, f"{run['steps']:,}", f"{run['training_seconds'] / 60:.0f}", "the encoder's cameras"])
        rows[-1] += [*pictures(run["validation"]), probe]
        rows += [["", "", "", told, *pictures(others[role]), ""] for role, told in ROLES.items() if role in others]
    return markdown_table(header, rows)


def pictures(figures: dict[str, float]) -> list[str]:
    """Return what pictures of held-out frames are like."""
    depth = f"{100 * figures['depth_mae_m']:.1f}"
    return [f"{figures['psnr_db']:.1f}", f"{figures['ssim']:.2f}", f"{figures['miou']:.2f}", depth]


if __name__ == "__main__":
    main()
