"""Compare an agent's recipe with itself, some of its keys otherwise, over the same seeds: result files and a table.

Blind agents stand beside those that see by an encoder: what they reach needs no eyes.

Run from a checkout's root; seeds that are finished are not trained again:

    .venv/bin/python -m tools.compare.agents --seeds 20..29
    .venv/bin/python -m tools.compare.agents --seeds 0..4 --encoder runs/demo/encoder --arms "the recipe" blind
    .venv/bin/python -m tools.compare.agents --seeds 0..4 --env_steps 50000 --arms "curriculum and bonus"

An arm is named by what it does otherwise, joined by commas or "and"; INGREDIENTS holds what there is.
"""

import argparse
import re
from pathlib import Path
from typing import Any

from nerf_rl.rl.sweeps.runs import GOOD
from nerf_rl.rl.training.evaluation_results import SUCCESS
from tools.compare.agent_runs import EPISODES, KEYS, ON_THE_WAY, RECIPE, put_runs, read_entries, row, trained
from tools.page_tables import AGENTS_PAGE, markdown_table, task_name, write_tables

RESULTS = Path("rl/results/agents")
"""a file for each task and what agents see by, latents or state"""
LATENTS, STATE = "latents and motion", "state with changes"
"""what agents see by, unless it is called otherwise"""
INGREDIENTS = {
    "the recipe": [],
    "targets without bounds": ["--learner.bound_by_returns", "false"],
    "exploration that does not wait": ["--noise.wait_for_successes", "0"],
    "self-imitation": ["--learner.imitation_weight", "0.1"],
    "strong self-imitation": ["--learner.imitation_weight", "0.5"],
    "curriculum": ["--retry_share", "0.5", "--steps_after_success", "20"],
    "overtime": ["--success_overtime", "100"],
    "bonus": ["--success_bonus", "20"],
    "triple bonus": ["--success_bonus", "60"],
    "early echoes": ["--echo_share", "0.8"],
    "1.5 updates a step": ["--learner.updates_per_step", "1.5"],
    "two updates a step": ["--learner.updates_per_step", "2"],
    "two updates of half a batch": ["--learner.updates_per_step", "2", "--learner.batch_size", "64"],
    "faster actor": ["--learner.actor_rate", "6e-4", "--learner.tau", "0.02"],
    "half the noise": ["--noise.decay_steps", "10000"],
    "little noise": ["--noise.decay_steps", "5000", "--noise.retries", "drawn"],
    "held retries": ["--noise.epsilon_z_retries", "0.1"],
    "steady ends": ["--learner.steady_ends", "true"],
    "smaller networks": ["--network.hidden", "[128,256]"],
    "renewed exploration": ["--noise.renew_after", "20"],
    "early renewal": ["--noise.renew_after", "15"],
    "from one success": ["--noise.wait_for_successes", "1"],
    "last weights": ["--learner.policy_average", "0"],
    "3 demonstrations": ["--config", "rl/demonstrations.yaml"],
    "blind": ["--control", "blind"],
}
"""what an arm's name is joined from, and the keys for it; a recipe takes the place of RECIPE"""


def main() -> None:
    """Train what is missing, then write what is known of all that was ever compared."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", default="metaworld/drawer-open-v3")
    parser.add_argument("--encoder", default="", help="what the agents see by; none for the true state")
    parser.add_argument("--eyes", help="what to call what they see by, where encoders differ by more than their seed")
    parser.add_argument("--seeds", default="0..9", help="as train-rl takes them")
    parser.add_argument(
        "--arms",
        nargs="+",
        default=["the recipe"],
        help=f"what agents do otherwise than {RECIPE}, which is 'the recipe'",
    )
    parser.add_argument("--env_steps", type=int, default=30_000, help="of each run")
    parser.add_argument("--work", type=Path, default=Path("runs/agents"), help="folder of the runs")
    arguments = parser.parse_args()
    sees = ["--encoder", arguments.encoder] if arguments.encoder else []
    eyes = arguments.eyes or (LATENTS if arguments.encoder else STATE)
    for arm in arguments.arms:
        if unknown := [part for part in ingredients(arm) if part not in INGREDIENTS]:
            parser.error(f"unknown {', '.join(unknown)}; there are {', '.join(INGREDIENTS)}")
        if not arguments.encoder and "blind" in ingredients(arm):
            parser.error("a blind agent needs an --encoder whose latent it does not see")
    for arm in arguments.arms:
        keys = arm_keys(arm)
        compared = f"{Path(arguments.scene).name}-{eyes}-{arguments.env_steps}"
        folder = arguments.work / compared.replace(" ", "-") / arm.replace(" ", "-").replace(",", "")
        words = [*keys, "--scene", arguments.scene, *KEYS, "--env_steps", str(arguments.env_steps), *sees]
        runs = trained(folder, arguments.seeds, words)
        record(arguments.scene, eyes, arguments.env_steps, arm, keys, [row(run) for run in runs])


def ingredients(arm: str) -> list[str]:
    """Return what an arm's name is joined from."""
    return re.split(", | and ", arm)


def arm_keys(arm: str) -> list[str]:
    """Return the keys of an arm."""
    return [key for part in ingredients(arm) for key in INGREDIENTS[part]]


def record(scene: str, eyes: str, env_steps: int, arm: str, keys: list[str], runs: list[dict[str, Any]]) -> None:
    """Put runs in place of those of the same seeds, and write file and table."""
    command = f"python -m tools.compare.agents; {RECIPE}, unless keys name another, {' '.join(KEYS)}"
    what = {"scene": scene, "eyes": eyes, "env_steps": env_steps, "arm": arm}
    put_runs(result_file(scene, eyes), "arms", {"command": command}, what, {"keys": keys}, runs, order)
    arms = [arm for file in RESULTS.glob("*.json") for arm in read_entries(file, "arms")]
    write_tables(AGENTS_PAGE, {"agents": table(sorted(arms, key=order))})


def result_file(scene: str, eyes: str) -> Path:
    """Return the file of a task's agents; all that see by latents, whatever stands beside these, share one."""
    return RESULTS / f"{task_name(scene).replace('/', '-')}-{eyes.split()[0]}.json"


def order(entry: dict[str, Any]) -> tuple[Any, ...]:
    """Return what entries are sorted by."""
    return (*(entry[name] for name in ("scene", "eyes", "env_steps")), place(entry["arm"]), entry["arm"])


def place(arm: str) -> list[int]:
    """Return where an arm stands among those of its task; those that had keys which are gone come last."""
    order, parts = list(INGREDIENTS), ingredients(arm)
    return [order.index(part) for part in parts] if set(parts) <= set(order) else [len(order)]


def table(arms: list[dict[str, Any]]) -> str:
    """Return a row for each arm: how often each seed succeeds at the end, and at 30,000 on the way; the worst first."""
    rows = []
    for arm in arms:
        scores = sorted(run["evaluations"][-1][SUCCESS] for run in arm["runs"])
        halfway = sorted(found for run in arm["runs"] if (found := on_the_way(run)) is not None)
        seeds = sorted(run["seed"] for run in arm["runs"])
        told = [f"{sum(scores) / len(scores):.0%}", f"{sum(rate >= GOOD for rate in scores)} of {len(scores)}"]
        rates, earlier = (", ".join(f"{100 * rate:.0f}" for rate in each) for each in (scores, halfway))
        encoders = {run["encoder"] for run in arm["runs"] if run.get("encoder")}
        eyes = f"{arm['eyes']}, {len(encoders)} encoders" if len(encoders) > 1 else arm["eyes"]
        told += [rates, earlier]
        rows.append(
            [task_name(arm["scene"]), eyes, f"{arm['env_steps']:,}", arm["arm"], ", ".join(map(str, seeds)), *told]
        )
    last = ["success, mean", f"seeds at {GOOD:.0%}", "success of each, sorted [%]", f"at {ON_THE_WAY:,} [%]"]
    return markdown_table(["task", "from", "env steps", "agent", "seeds", *last], rows)


def on_the_way(run: dict[str, Any]) -> float | None:
    """Return a longer run's success at 30,000 environment steps; None if it was not evaluated there in all episodes.

    Environments step at once, and late successes make episodes a little longer, so it may have come a few steps later.
    """
    before_the_last = run["evaluations"][:-1]
    found = [
        each
        for each in before_the_last
        if each.get("due", each["env_steps"]) == ON_THE_WAY and each["episodes"] == EPISODES
    ]
    return found[0][SUCCESS] if found else None


if __name__ == "__main__":
    main()
