"""Train agents on the latents that different objectives taught, over the same seeds: a result file, table and figure.

Run from a checkout's root after tools.compare.objectives, on the folder of its runs of one dataset; agents that are
finished are not trained again:

    .venv/bin/python -m tools.compare.objective_agents data/objectives/metaworld-drawer-open-v3-0-8-minutes --seeds 0..9

Beside them stand agents that see nothing (z constant) and agents that are told the true state.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from nerf_rl.files.atomic import atomic_write
from nerf_rl.files.json_files import read_json
from nerf_rl.rl.sweeps.aggregates import stratified_interval
from nerf_rl.rl.sweeps.runs import GOOD
from nerf_rl.rl.training.evaluation_results import SUCCESS
from tools.compare.agent_runs import EPISODES, KEYS, RECIPE, put_runs, trained, training_episodes
from tools.compare.agent_runs import row as figures_of
from tools.compare.objectives import ORDER, WHOLE
from tools.page_tables import ENCODERS_PAGE, markdown_table, task_name, write_tables

RESULT, FIGURE = Path("pretrain/results/objective_agents.json"), Path("pretrain/results/objective_agents.png")
BLIND, STATE = "blind", "true state"
ARMS = [BLIND, *ORDER, STATE]
SPAN = 5_000
"""environment steps over which a curve counts training episodes"""


def main() -> None:
    """Train what is missing, then write what is known of all agents that were ever compared."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, help="folder of the encoders, by objective")
    parser.add_argument("--objectives", nargs="+", default=ARMS, choices=ARMS)
    parser.add_argument("--seeds", default="0..9", help="as train-rl takes them")
    parser.add_argument("--env_steps", type=int, default=30_000, help="of each agent")
    parser.add_argument("--work", type=Path, default=Path("runs/objective_agents"), help="folder of the agents")
    arguments = parser.parse_args()
    scene = read_json(arguments.runs / WHOLE / "encoder.json")["scene"]["name"]
    for objective in arguments.objectives:
        folder = arguments.work / arguments.runs.name / f"{objective.replace(' ', '-')}-{arguments.env_steps}"
        words = ["--scene", scene, *KEYS, "--env_steps", str(arguments.env_steps), *eyes(objective, arguments.runs)]
        runs = trained(folder, arguments.seeds, words)
        record(scene, arguments.env_steps, objective, [row(run, arguments.env_steps) for run in runs])


def eyes(objective: str, encoders: Path) -> list[str]:
    """Return the keys that say what an agent sees by."""
    if objective == STATE:
        return []
    blind = ["--control", "blind"] if objective == BLIND else []
    return ["--encoder", str(encoders / (WHOLE if objective == BLIND else objective)), *blind]


def row(run: Path, env_steps: int) -> dict[str, Any]:
    """Return what is told of a run, with the share of its training episodes that succeeded, of each span of steps."""
    ends, successes = training_episodes(run)
    spans = np.minimum((ends - 1) // SPAN, env_steps // SPAN - 1)
    found = [successes[spans == span] for span in range(env_steps // SPAN)]
    return {**figures_of(run), "training_success": [float(each.mean()) if len(each) else None for each in found]}


def record(scene: str, env_steps: int, objective: str, runs: list[dict[str, Any]]) -> None:
    """Put runs in place of those of the same seeds; write file, table and figure."""
    head = {
        "command": f"python -m tools.compare.objective_agents ENCODERS; {RECIPE} with {' '.join(KEYS)}",
        "span": SPAN,
    }
    what = {"scene": scene, "env_steps": env_steps, "objective": objective}
    agents = put_runs(RESULT, "agents", head, what, {}, runs, order)
    write_tables(ENCODERS_PAGE, {"objective-agents": table(agents)})
    draw(agents)


def order(entry: dict[str, Any]) -> tuple[Any, ...]:
    """Return what entries are sorted by."""
    return entry["scene"], entry["env_steps"], ARMS.index(entry["objective"])


def table(agents: list[dict[str, Any]]) -> str:
    """Return a row for each objective: how often its agents succeed at the end, the worst first."""
    rows = []
    for agent in agents:
        scores = sorted(run["evaluations"][-1][SUCCESS] for run in agent["runs"])
        interval = ""  # one run says nothing of other seeds
        if len(scores) > 1:
            low, high = stratified_interval(np.array(scores)[:, None], mean)
            interval = f" ({low:.0%} to {high:.0%})"
        told = [f"{np.mean(scores):.0%}{interval}", f"{sum(rate >= GOOD for rate in scores)}"]
        told += [f"{len(scores)}", ", ".join(f"{100 * rate:.0f}" for rate in scores)]
        rows.append([task_name(agent["scene"]), f"{agent['env_steps']:,}", agent["objective"], *told])
    last = ["success, mean (95 % interval)", f"at {GOOD:.0%}", "seeds", f"of each, {EPISODES} episodes [%]"]
    return markdown_table(["task", "env steps", "latents of", *last], rows)


def mean(scores: np.ndarray) -> np.ndarray:
    """Return the mean of all scores."""
    return scores.mean((-2, -1))


def draw(agents: list[dict[str, Any]]) -> None:
    """Draw training success over environment steps: each seed, and the mean with its interval, a panel an objective."""
    from matplotlib.figure import Figure  # takes half a second to import

    across = 5
    down = -(-len(agents) // across)
    figure = Figure(figsize=(2.2 * across, 1.9 * down), layout="constrained")
    panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).flatten()
    for panel in panels[len(agents) :]:
        panel.set_axis_off()
    for panel, agent in zip(panels, agents, strict=False):
        curves = np.array([run["training_success"] for run in agent["runs"]], np.float64)
        steps = SPAN // 1000 * np.arange(1, curves.shape[1] + 1)
        panel.plot(steps, curves.T, color="0.7", linewidth=0.7)
        panel.plot(steps, curves.mean(0), marker=".")
        if len(curves) > 1:
            lows, highs = zip(*(stratified_interval(column[:, None], mean) for column in curves.T), strict=True)
            panel.fill_between(steps, lows, highs, alpha=0.25)
        panel.set_title(f"{task_name(agent['scene'])}, {agent['objective']} ({len(curves)})", fontsize=7)
        panel.set(ylim=(-0.03, 1.03))
        panel.tick_params(labelsize=7, labelbottom=True)
    figure.supxlabel("thousand environment steps", fontsize=8)
    figure.supylabel("training episodes that succeed", fontsize=8)
    with atomic_write(FIGURE) as aside:
        figure.savefig(aside, format="png", dpi=120)


if __name__ == "__main__":
    main()
