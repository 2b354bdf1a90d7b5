"""Time until a policy succeeds: our DDPG beside Stable-Baselines3's agents on the same latents, over the same seeds.

Run from a checkout's root (extra sb3); seeds that are finished are not trained again:

    .venv/bin/python -m tools.compare.baselines --encoder runs/demo/encoder --seeds 0..4

Each seed runs in a process of its own with one thread, and every agent is evaluated in the same episodes. Recipes of
Stable-Baselines3's agents have its own defaults but for what belongs to the task.
"""

import argparse
import importlib.metadata
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from nerf_rl.rl.sweeps.runs import GOOD, run_folder
from nerf_rl.rl.sweeps.seed_list import parse_seeds
from nerf_rl.rl.training.evaluation_results import SUCCESS
from tools.compare.agent_runs import put_runs, row, train
from tools.page_tables import AGENTS_PAGE, markdown_table, write_tables

RESULT = Path("rl/results/baselines.json")
SB3 = ["--config", "rl/drawer-open-sb3.yaml"]
SB3_RATE = ["--learner.critic_rate", "1e-3"]  # its default for DDPG and TD3
AGENTS = {
    "DDPG, ours": ["--config", "rl/drawer-open.yaml"],
    "SAC of Stable-Baselines3": SB3,
    "TD3 of Stable-Baselines3": [*SB3, "--algo", "sb3-td3", *SB3_RATE],
    "DDPG of Stable-Baselines3": [*SB3, "--algo", "sb3-ddpg", *SB3_RATE],
}
"""what is compared, and its keys, of which the first name a recipe"""
KEYS = ["--evaluation_every", "5000", "--evaluation_episodes", "20", "--final_evaluation_episodes", "50"]


def main() -> None:
    """Train what is missing, then write what is known of all that was ever compared."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--encoder", required=True, help="what all of them see by")
    parser.add_argument("--seeds", default="0..4", help="as train-rl takes them")
    parser.add_argument("--agents", nargs="+", choices=AGENTS, default=list(AGENTS))
    parser.add_argument("--env_steps", type=int, default=50_000, help="of each run")
    parser.add_argument("--work", type=Path, default=Path("runs/baselines"), help="folder of the runs")
    arguments = parser.parse_args()
    for agent in arguments.agents:
        folder = arguments.work / agent.replace(" ", "-").replace(",", "")
        words = [*KEYS, "--env_steps", str(arguments.env_steps), "--encoder", arguments.encoder]
        train([*AGENTS[agent], *words, "--seeds", arguments.seeds, "--workers", "1", "--out", str(folder)])
        runs = [row(run_folder(folder, seed)) for seed in parse_seeds(arguments.seeds)]
        command = f"python -m tools.compare.baselines; {' '.join(KEYS)}"
        what = {"agent": agent, "env_steps": arguments.env_steps}
        facts = {"keys": AGENTS[agent], "stable-baselines3": importlib.metadata.version("stable-baselines3")}
        agents = put_runs(RESULT, "agents", {"command": command}, what, facts, runs, order)
        write_tables(AGENTS_PAGE, {"baselines": table(agents)})


def order(entry: dict[str, Any]) -> tuple[int, int]:
    """Return what entries are sorted by."""
    return entry["env_steps"], list(AGENTS).index(entry["agent"])


def table(agents: list[dict[str, Any]]) -> str:
    """Return a row for each agent: when each of its seeds first succeeded in 95 % of an evaluation, and at the end."""
    rows = []
    for agent in agents:
        runs = agent["runs"]
        good = [run["good"] or {} for run in runs]
        steps = (f"{first['env_steps']:,}" if first else "-" for first in good)
        seconds = (f"{first['seconds']:.0f}" if first else "-" for first in good)
        each = [(run["seed"] for run in runs), steps, seconds, (f"{run['seconds']:.0f}" for run in runs)]
        each.append(f"{100 * run['evaluations'][-1][SUCCESS]:.0f}" for run in runs)
        rows.append([agent["agent"], f"{agent['env_steps']:,}", *map(listed, each)])
    first = [f"env steps at {GOOD:.0%}", f"seconds to {GOOD:.0%}"]
    return markdown_table(["agent", "env steps", "seeds", *first, "seconds in all", "success at the end [%]"], rows)


def listed(values: Iterable[Any]) -> str:
    """Return what stands in a cell for one value of each seed."""
    return "; ".join(map(str, values))


if __name__ == "__main__":
    main()
