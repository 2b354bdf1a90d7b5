"""Record one recipe's runs over several seeds: a result file and a README's table.

Run from a checkout's root, with encoders or with agents:

    .venv/bin/python tools/record_seeds.py runs/demo/encoder runs/seeds/encoder*
    .venv/bin/python tools/record_seeds.py runs/demo/agent runs/seeds/agent*
"""

import argparse
import sys
from pathlib import Path

from record_demo import markdown_table, read_result, replace_tables

from nerf_rl.files.atomic import write_text
from nerf_rl.files.json_files import write_json


def main() -> None:
    """Copy summaries with their provenance, ordered by seed; nothing is left out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="finished run folders of train-rl, or of pretrain")
    runs = sorted(map(read_result, parser.parse_args().runs), key=lambda run: run["provenance"]["seed"])
    commands = {run["provenance"]["command"] for run in runs}
    if commands not in ({"train-rl"}, {"pretrain"}):
        sys.exit(f"give runs of train-rl or runs of pretrain, not of {' and '.join(sorted(commands))}")
    folder, table = ("rl", agents_table) if commands == {"train-rl"} else ("pretrain", encoders_table)
    write_json(Path(folder) / "results" / "demo_seeds.json", {"runs": runs})
    readme = Path(folder) / "README.md"
    write_text(readme, replace_tables(readme.read_text(), {f"{folder}-seeds": table(runs)}))


def agents_table(runs: list[dict]) -> str:
    """Return a row for each seed: success at each evaluation."""
    steps = [evaluation["env_steps"] for evaluation in runs[0]["evaluations"]]
    rows = [
        [
            run["provenance"]["seed"],
            *(f"{evaluation['success_rate']:.0%}" for evaluation in run["evaluations"]),
            f"{run['seconds']:.0f}",
        ]
        for run in runs
    ]
    return markdown_table(["seed", *(f"{step:,}" for step in steps), "seconds"], rows)


def encoders_table(runs: list[dict]) -> str:
    """Return a row for each seed: images of held-out frames, and the probe."""
    columns = [name for name in runs[0]["probe"] if not name.startswith("goal")]
    rows = [
        [
            run["provenance"]["seed"],
            f"{run['validation']['psnr_db']:.1f}",
            f"{run['validation']['miou']:.2f}",
            *(f"{run['probe'][name]['rmse_mm']:.1f}" for name in columns),
        ]
        for run in runs
    ]
    return markdown_table(["seed", "PSNR [dB]", "mIoU", *(f"{name} [mm]" for name in columns)], rows)


if __name__ == "__main__":
    main()
