"""Record one recipe's agents over several seeds: a result file and the table in rl/README.md.

Run from a checkout's root: .venv/bin/python tools/record_seeds.py runs/demo/agent runs/seeds/agent*
"""

import argparse
from pathlib import Path

from record_demo import replace_tables

from nerf_rl.runs import read_json, write_json, write_text


def main() -> None:
    """Copy evaluations with their provenance, in the order given; nothing is left out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="finished run folders of train-rl")
    seeds = [
        {**read_json(run / "summary.json"), "provenance": read_json(run / "provenance.json")}
        for run in parser.parse_args().runs
    ]
    seeds.sort(key=lambda run: run["provenance"]["seed"])
    write_json(Path("rl/results/demo_seeds.json"), {"runs": seeds})
    readme = Path("rl/README.md")
    write_text(readme, replace_tables(readme.read_text(), {"rl-seeds": seeds_table(seeds)}))


def seeds_table(seeds: list[dict]) -> str:
    """Return a row for each seed: success at each evaluation."""
    steps = [evaluation["env_steps"] for evaluation in seeds[0]["evaluations"]]
    header = ["seed", *(f"{step:,}" for step in steps), "seconds"]
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    for run in seeds:
        rates = [f"{evaluation['success_rate']:.0%}" for evaluation in run["evaluations"]]
        lines.append(f"| {' | '.join([str(run['provenance']['seed']), *rates, format(run['seconds'], '.0f')])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
