"""Take environments of Gymnasium from simulator to policy: a result file and a page's table.

Run from a checkout's root; what is finished is not done again:

    .venv/bin/python -m tools.compare.scenes gym/Reacher-v5 gym/Pusher-v5
    .venv/bin/python -m tools.compare.scenes gym/gymnasium_robotics:FetchReach-v4 --recipe rl/gym-goal.yaml \
        --observe desired_goal --seeds 0..4
    .venv/bin/python -m tools.compare.scenes gym/HalfCheetah-v5 --agents --robot_links together --encoder_seed 1

Each scene gets a dataset and an encoder by the shipped recipes, the encoder as many steps as that of the demo. Agents
learn from its latents, from the true state and blind, with the same recipe and seeds; a policy that acts at random
tells what a return is worth. Without agents (an empty --agents), the encoder is all that is made and probed, beside
those of other labels and seeds.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions, processor
from nerf_rl.rendering.semantics import semantic_classes
from nerf_rl.rl.environments.make import EnvSpec, make_vector_env
from nerf_rl.rl.environments.vector import close_all
from nerf_rl.rl.training.episodes import evaluation_seeds, run_episodes
from nerf_rl.rl.training.evaluation_results import SUCCESS
from nerf_rl.scenes.make import make_scene
from tools.page_tables import AGENTS_PAGE, markdown_table, write_tables

RESULT = Path("rl/results/scenes.json")
DATASET_RECIPE, ENCODER_RECIPE, AGENT_RECIPE = "datasets/gym.yaml", "pretrain/demo.yaml", "rl/gym.yaml"
ENCODER_STEPS = "2000"
STATE, LATENTS, BLIND = "state", "latents", "blind"
EYES = {STATE: [], LATENTS: ["--encoder"], BLIND: ["--control", "blind", "--encoder"]}
"""what an agent sees by, and the keys for it; an encoder follows the last one"""
PROBES = ("probe", "probe_random_encoder", "joint_probe", "joint_probe_random_encoder")
RANDOM_EPISODES = 50


def main() -> None:
    """Run the scenes one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", help="such as gym/Reacher-v5")
    parser.add_argument("--recipe", default=AGENT_RECIPE, help="of the agents")
    parser.add_argument("--agents", nargs="*", choices=EYES, default=list(EYES))
    parser.add_argument("--seeds", default="0..2", help="as train-rl takes them")
    parser.add_argument("--observe", nargs="*", default=[], help="columns of the true state beside a latent")
    parser.add_argument("--robot_links", help="of the dataset, if it is not the recipe's")
    parser.add_argument("--encoder_seed", type=int, default=0, help="of the dataset and the encoder")
    parser.add_argument("--work", type=Path, default=Path("data/scenes"), help="folder of datasets and runs")
    arguments = parser.parse_args()
    for scene in arguments.scenes:
        row = {"scene": scene, "recipe": arguments.recipe, "seed": arguments.encoder_seed}
        row |= {"observe": arguments.observe} if arguments.observe else {}
        row |= run(scene, arguments)
        row |= {"git_revision": git_revision(), "packages": package_versions(), "processor": processor()}
        known = read_json(RESULT)["scenes"] if RESULT.exists() else []
        rows = sorted([*(other for other in known if which(other) != which(row)), row], key=which)
        command = "python -m tools.compare.scenes SCENES --recipe RECIPE --agents AGENTS --seeds SEEDS"
        command += " --observe COLUMNS --robot_links LINKS --encoder_seed SEED"
        write_json(RESULT, {"command": command, "recipes": [DATASET_RECIPE, ENCODER_RECIPE], "scenes": rows})
        tables = {"scenes": agents_table(rows), "scene-probes": probes_table(rows)}
        write_tables(AGENTS_PAGE, tables)


def which(row: dict[str, Any]) -> tuple[str, str, int]:
    """Return what a row is of; another one of the same takes its place."""
    return row["scene"], row.get("robot_links", ""), row["seed"]


def run(scene: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Render and pretrain, if an agent is to see, and train; return the figures."""
    seed = str(arguments.encoder_seed)
    links = ["--robot_links", arguments.robot_links] if arguments.robot_links else []
    work = arguments.work / "-".join([scene.replace("/", "-").replace(":", "-"), *links[1:], seed])
    data, encoder = work / "data", work / "encoder"
    found: dict[str, Any] = {"seconds": {}, "agents": {}, "random": random_policy(scene, arguments.recipe)}
    if not arguments.agents or any(EYES[sees] for sees in arguments.agents):
        keys = ["--config", DATASET_RECIPE, "--scene", scene, *links, "--seed", seed]
        command(data, "gen-dataset", *keys, "--out", str(data), "--resume", "true")
        keys = ["--config", ENCODER_RECIPE, "--data", str(data), "--steps", ENCODER_STEPS, "--seed", seed]
        command(encoder, "pretrain", *keys, "--out", str(encoder), "--resume", "true")
        found["robot_links"] = links_in(MultiViewDataset(data), scene)
        found["seconds"] = {stage.name: read_json(stage / SUMMARY)["seconds"] for stage in (data, encoder)}
        found |= {name: read_json(encoder / SUMMARY)[name] for name in PROBES}
    for sees in arguments.agents:
        out, eyes = work / sees, [*EYES[sees], str(encoder)] if EYES[sees] else []
        eyes += ["--observe", f"[{', '.join(arguments.observe)}]"] if eyes and arguments.observe else []
        keys = ["--scene", scene, *eyes, "--seeds", arguments.seeds, "--out", str(out), "--resume", "true"]
        command(out, "train-rl", "--config", arguments.recipe, *keys)
        found["agents"][sees] = read_json(out / SUMMARY)
    return found


def links_in(dataset: MultiViewDataset, scene: str) -> str:
    """Return whether a robot is one class in a dataset, or its links are, whatever was asked for."""
    simulated = make_scene(scene)
    names = semantic_classes(simulated.model, simulated.parts).names
    return "together" if dataset.class_names == names else "apart"


def random_policy(scene: str, recipe: str) -> dict[str, Any]:
    """Return what uniformly random actions get in whole episodes with the evaluations' seeds."""
    keys, rng = yaml.safe_load(Path(recipe).read_text()), np.random.default_rng(0)
    envs = make_vector_env(EnvSpec(scene, None, keys["action_repeat"], keys["episode_steps"]), keys["envs"])

    def act(_: ndarray) -> ndarray:
        return rng.uniform(-1.0, 1.0, envs.action_space.shape or ()).astype(np.float32)

    try:
        seeds = evaluation_seeds(0, RANDOM_EPISODES)
        return run_episodes(envs, act, seeds, keys.get("evaluation_to_end", False)).summary()
    finally:
        close_all(envs)


def command(out: Path, *words: str) -> None:
    """Run a command of nerf-rl unless its summary is there."""
    if not (out / SUMMARY).is_file():
        subprocess.run([sys.executable, "-m", "nerf_rl.cli", *words], check=True)


def agents_table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each scene: returns (and successes) at the end of each seed, and what each stage took."""
    ways = {sees: f"{sees}: of the way from random to state" for sees in (LATENTS, BLIND)}
    header = ["scene", "random policy", *EYES, *ways.values(), "minutes: data, encoder, agent"]
    lines = []
    for row in (row for row in rows if STATE in row["agents"]):
        ends = {sees: final(sweep) for sees, sweep in row["agents"].items()}
        low, top = mean_return([row["random"]]), mean_return(ends[STATE])
        reached = [f"{(mean_return(ends[sees]) - low) / (top - low):.0%}" if sees in ends else "" for sees in ways]
        seconds = [*row["seconds"].values(), slowest(row["agents"].get(LATENTS, row["agents"][STATE]))]
        minutes = " + ".join(f"{each / 60:.1f}" for each in seconds)
        returns = [describe(ends[sees]) if sees in ends else "" for sees in EYES]
        lines.append([f"`{row['scene']}`", describe([row["random"]]), *returns, *reached, minutes])
    return markdown_table(header, lines)


def probes_table(rows: list[dict[str, Any]]) -> str:
    """Return a row for each encoder: the joints' variance that is read from latents, and how far off positions are."""
    header = ["scene", "robot's links", "seed", "joints: R², linear", "small network", "least joint, linear"]
    header += ["untrained encoder, linear", "positions: RMSE, mean of columns [mm]", "median"]
    lines = []
    for row in (row for row in rows if PROBES[0] in row):
        trained, untrained = (list(row[name].values()) for name in PROBES[2:])
        linear = [each["r2"] for each in trained]
        means = [np.mean(linear), np.mean([each["network_r2"] for each in trained]), min(linear)]
        means += [np.mean([each["r2"] for each in untrained])]
        positions = row[PROBES[0]].values()
        off = [[each[name] for each in positions] for name in ("rmse_mm", "median_mm")]
        told = [*(f"{value:.2f}" for value in means), *(f"{np.mean(values):.1f}" if values else "" for values in off)]
        lines.append([f"`{row['scene']}`", row["robot_links"], row["seed"], *told])
    return markdown_table(header, lines)


def final(sweep: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the last evaluation of each seed."""
    return [run["evaluations"][-1] for run in sweep["runs"]]


def mean_return(evaluations: list[dict[str, Any]]) -> float:
    """Return the mean of their mean returns."""
    return float(np.mean([evaluation["mean_return"] for evaluation in evaluations]))


def describe(evaluations: list[dict[str, Any]]) -> str:
    """Return the return of each seed and, where the environment tells of it, its success."""
    rates = [f" ({each[SUCCESS]:.0%})" if SUCCESS in each else "" for each in evaluations]
    return ", ".join(f"{each['mean_return']:.1f}{rate}" for each, rate in zip(evaluations, rates, strict=True))


def slowest(sweep: dict[str, Any]) -> float:
    """Return what the longest run took [s]."""
    return max(run["seconds"] for run in sweep["runs"])


if __name__ == "__main__":
    main()
