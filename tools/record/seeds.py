"""Record one recipe's runs over several seeds: a result file and a page's table.

Run from a checkout's root, with encoders or with agents; a sweep of train-rl stands for all its runs:

    .venv/bin/python -m tools.record.seeds runs/demo/encoder runs/seeds/encoder*
    .venv/bin/python -m tools.record.seeds runs/sweep
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import PROVENANCE
from nerf_rl.rl.sweeps.runs import read_run
from nerf_rl.rl.sweeps.summary import summarise
from nerf_rl.rl.sweeps.table import describe_summary, seeds_table
from tools.page_tables import AGENTS_PAGE, ENCODERS_PAGE, markdown_table, write_tables
from tools.record.demo import read_result


def main() -> None:
    """Copy summaries with their provenance, ordered by seed; nothing is left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, help="finished runs of pretrain, or of train-rl, or sweeps")
    folders = [run for given in parser.parse_args().runs for run in runs_of(given)]
    commands = {read_json(folder / PROVENANCE)["command"] for folder in folders}
    if commands not in ({"train-rl"}, {"pretrain"}):
        sys.exit(f"give runs of train-rl or runs of pretrain, not of {' and '.join(sorted(commands))}")
    folder, record = ("rl", record_agents) if commands == {"train-rl"} else ("pretrain", record_encoders)
    results, table = record(folders)
    write_json(Path(folder) / "results" / "demo_seeds.json", results)
    write_tables({"rl": AGENTS_PAGE, "pretrain": ENCODERS_PAGE}[folder], {f"{folder}-seeds": table})


def runs_of(folder: Path) -> Iterator[Path]:
    """Yield the run folders of a sweep, or the run folder that this is."""
    seeds = sorted(folder.glob("seed-*/"))
    yield from seeds or [folder]


def record_agents(folders: list[Path]) -> tuple[dict[str, Any], str]:
    """Return a sweep's summary, with each run's provenance, and its table."""
    summary = summarise([{**read_run(folder), "provenance": read_json(folder / PROVENANCE)} for folder in folders])
    return summary, f"{markdown_table(*seeds_table(summary))}\n\n{describe_summary(summary)}"


def record_encoders(folders: list[Path]) -> tuple[dict[str, Any], str]:
    """Return the runs, and a row for each seed: images of held-out frames, and the probe."""
    runs = sorted(map(read_result, folders), key=lambda run: run["provenance"]["seed"])
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
    table = markdown_table(["seed", "PSNR [dB]", "mIoU", *(f"{name} [mm]" for name in columns)], rows)
    return {"runs": runs}, table


if __name__ == "__main__":
    main()
