"""Leave out each ingredient of an agent's recipe in turn, over the same seeds: a result file and a table.

Run from a checkout's root; seeds that are finished are not trained again:

    .venv/bin/python -m tools.compare.ablation --seeds 0..9
    .venv/bin/python -m tools.compare.ablation --scene metaworld/door-open-v3 --without nothing "echoes of successes"

Agents see the true state unless there is an encoder: what is compared is how they learn.
"""

import argparse
import statistics
from pathlib import Path
from typing import Any

from nerf_rl.rl.sweeps.runs import GOOD
from tools.compare.agent_runs import KEYS, ON_THE_WAY, put_runs, row, trained
from tools.compare.agents import LATENTS, STATE
from tools.page_tables import AGENTS_PAGE, markdown_table, task_name, write_tables
from tools.record.recipe_agents import EYES, WHOLE, after, rates

RECIPE, RESULT = Path("rl/drawer-open.yaml"), Path("rl/results/ablation.json")
WITHOUT = {
    "nothing": [],
    "self-imitation": ["--learner.imitation_weight", "0"],
    "returns as least targets": ["--learner.bound_by_returns", "false"],
    "steady ends": ["--learner.steady_ends", "false"],
    "retries": [
        "--retry_share",
        "0",
        "--echo_share",
        "0",
        "--noise.retries",
        "first",
        "--noise.epsilon_z_retries",
        "0",
    ],
    "echoes of successes": ["--echo_share", "0"],
    "held actions in retries": ["--noise.epsilon_z_retries", "0"],
    "held actions": ["--noise.epsilon_z", "0", "--noise.epsilon_z_start", "0"],
    "less noise, drawn in retries": ["--noise.decay_steps", "10000", "--noise.retries", "first"],
    "noise that waits for successes": ["--noise.wait_for_successes", "0"],
    "early renewal": ["--noise.renew_after", "0"],
    "pink noise": ["--noise.kind", "gaussian"],
    "early ends after success": ["--steps_after_success", "null"],
    "overtime after success": ["--success_overtime", "0"],
    "success bonus": ["--success_bonus", "0"],
    "half an update more a step": ["--learner.updates_per_step", "1"],
    "averaged policy": ["--learner.policy_average", "0"],
    "priorities": ["--replay.prioritised", "false"],
    "returns of three steps": ["--learner.n_step", "1"],
    "layer normalisation": ["--network.normalisation", "none"],
}
"""what is left out, and the keys that do it: what they were before it came, or what switches it off"""


def main() -> None:
    """Train what is missing, then write what is known of all ingredients that were ever left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="metaworld/drawer-open-v3")
    parser.add_argument("--encoder", default="", help="what the agents see by; none for the true state")
    parser.add_argument("--seeds", default="0..9", help="as train-rl takes them")
    parser.add_argument("--without", nargs="+", default=list(WITHOUT), choices=WITHOUT, help="what is left out")
    parser.add_argument("--work", type=Path, default=Path("runs/ablation"), help="folder of the runs")
    arguments = parser.parse_args()
    sees = ["--encoder", arguments.encoder] if arguments.encoder else []
    eyes = LATENTS if arguments.encoder else STATE
    for ingredient in arguments.without:
        compared = f"{Path(arguments.scene).name}-{EYES[eyes]}".replace(" ", "-")
        folder = arguments.work / compared / ingredient.replace(" ", "-").replace(",", "")
        words = ["--config", str(RECIPE), "--scene", arguments.scene, *sees, *KEYS, *WITHOUT[ingredient]]
        runs = trained(folder, arguments.seeds, words)
        record(arguments.scene, eyes, ingredient, [row(run) for run in runs])


def record(scene: str, eyes: str, ingredient: str, runs: list[dict[str, Any]]) -> None:
    """Put runs in place of those of the same seeds, and write file and table."""
    command = f"python -m tools.compare.ablation; {RECIPE} with {' '.join(KEYS)}"
    what, keys = {"scene": scene, "eyes": eyes, "without": ingredient}, {"keys": WITHOUT[ingredient]}
    entries = put_runs(RESULT, "ablation", {"command": command}, what, keys, runs, order)
    write_tables(AGENTS_PAGE, {"ablation": table(entries)})


def order(entry: dict[str, Any]) -> tuple[str, str, int]:
    """Return what entries are sorted by."""
    return entry["scene"], entry["eyes"], list(WITHOUT).index(entry["without"])


def table(entries: list[dict[str, Any]]) -> str:
    """Return a row for each task, eyes and ingredient, the one that is missed most first."""
    rows = []
    for entry in entries:
        successes = [after(entry["runs"], steps) for steps in (ON_THE_WAY, WHOLE)]
        means = [statistics.mean(each) for each in successes]
        cells = [task_name(entry["scene"]), EYES[entry["eyes"]], entry["without"]]
        for mean, each in zip(means, successes, strict=True):
            good = f"{sum(rate >= GOOD for rate in each)} of {len(each)}"
            cells += [f"{100 * mean:.0f}", good, rates(each)]
        rows.append((entry["scene"], entry["eyes"], sum(means), cells))
    columns = [
        f"{what} after {steps:,}" for steps in (ON_THE_WAY, WHOLE) for what in ("mean", f"at {GOOD:.0%}", "each")
    ]
    return markdown_table(["task", "from", "without", *columns], [cells for *_, cells in sorted(rows)])


if __name__ == "__main__":
    main()
