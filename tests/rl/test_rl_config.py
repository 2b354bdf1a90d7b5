"""Mistakes in the keys of train-rl and evaluate, by the words of their answers; the shipped recipes."""

import dataclasses
from functools import reduce
from operator import getitem
from pathlib import Path

import pytest
import yaml

from nerf_rl import cli
from nerf_rl.errors import UserError
from tools.compare import ablation
from tools.compare.agent_runs import read_entries
from tools.compare.agents import LATENTS, result_file
from tools.record.recipe_agents import ARM

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--env_steps", "0"], "--env_steps must be at least 1, got 0"),
        (["--warmup_steps", "60000"], "--warmup_steps 60000 leaves nothing of --env_steps 50000 to learn in"),
        (["--learning_starts", "-1"], "--learning_starts must be at least 0, got -1"),
        (["--learning_starts", "50000"], "--learning_starts 50000 leaves nothing of --env_steps 50000 to learn in"),
        (
            ["--replay.capacity", "127"],
            "--replay.capacity 127 never holds a batch of --learner.batch_size 128, so nothing would be learnt; give",
        ),
        (
            ["--env_steps", "3000", "--action_repeat", "30"],
            "--env_steps 3000 with --action_repeat 30 bring 100 transitions, fewer than --learner.batch_size 128, so",
        ),
        (["--replay.alpha", "11"], "--replay.alpha must be in [0, 10], got 11"),
        (
            ["--replay.alpha", "9", "--replay.epsilon", "1e-5"],
            "--replay.epsilon 1e-05 to the power of --replay.alpha 9.0 is too small",
        ),
        (
            ["--algo", "sb3-sac", "--action_repeat", "1", "--replay.hindsight", "4"],
            "--replay.hindsight is for --algo ddpg; sb3-sac of Stable-Baselines3 has none",
        ),
        (["--algo", "sb3-ddpg", "--learning_starts", "9"], "leave out --learning_starts"),
        (["--episode_steps", "1"], "--episode_steps 1 is less than --action_repeat 2"),
        (["--steps_after_success", "0"], "--steps_after_success must be at least 1, got 0"),
        (
            ["--success_bonus", "20", "--replay.hindsight", "4"],
            "--success_bonus 20.0 is no part of the rewards that --replay.hindsight 4 computes; give one of them",
        ),
        (["--success_bonus", "-1"], "--success_bonus must be at least 0, got -1.0"),
        (["--echo_share", "0.5"], "--echo_share 0.5 is of retries; give --retry_share, too"),
        (["--noise.epsilon_z_retries", "0.1"], "--noise.epsilon_z_retries 0.1 is of retries; give --retry_share, too"),
        (["--noise.retries", "drawn"], "--noise.retries drawn is of retries; give --retry_share, too"),
        (["--learner.imitation_weight", "-1"], "--learner.imitation_weight must be in [0, 1000000], got -1.0"),
        (["--learner.gamma", "1.5"], "--learner.gamma must be in [0, 1], got 1.5"),
        (["--learner.tau", "0"], "--learner.tau must be in (0, 1], got 0.0"),
        (["--learner.critic_rate", "-1"], "--learner.critic_rate must be positive, got -1.0"),
        (["--learner.actor_batch", "big"], "unknown learner.actor_batch 'big'; available: prioritised, uniform"),
        (["--network.normalisation", "layr"], "unknown network.normalisation 'layr' (did you mean layer?)"),
        (["--network.hidden", "[256]"], "--network.hidden needs two widths, got [256]"),
        (["--noise.kind", "pnk"], "unknown noise.kind 'pnk' (did you mean pink?); available: gaussian, ou, pink"),
        (["--noise.epsilon_z", "1"], "--noise.epsilon_z must be in [0, 1), got 1.0"),
        (["--replay.beta", "2"], "--replay.beta must be in [0, 1], got 2.0"),
        (
            ["--replay.hindsight", "4"],
            "--replay.hindsight 4 computes the reward of a single step, and --action_repeat 2 sums those of so many",
        ),
        (
            ["--replay.hindsight", "4", "--action_repeat", "1"],
            "--replay.hindsight needs a scene with a goal in its observation; metaworld/drawer",
        ),
        (["--replay.hindsight_random", "2"], "--replay.hindsight_random must be in [0, 1], got 2.0"),
        (["--panda.control", "joint"], "unknown panda.control 'joint' (did you mean joints?); available: ee, joints"),
        (
            ["--algo", "sac"],
            "unknown algorithm 'sac' (did you mean sb3-sac?); available: ddpg, ppo, sb3-ddpg, sb3-sac, sb3-td3",
        ),
        (["--algo", "sb3-ddpg"], "--algo sb3-ddpg has no pink noise; use --noise.kind gaussian or ou"),
        (["--ppo.activation", "gelu"], "unknown ppo.activation 'gelu'"),
        (["--ppo.gamma", "2"], "--ppo.gamma must be in [0, 1], got 2.0"),
        (["--episodes", "-1"], "--episodes must be at least 0, got -1"),
        (
            ["--scene", "panda/push"],
            "unknown scene 'panda/push'; available: metaworld/TASK, for example metaworld/drawer-open",
        ),
        (["--sed", "3"], "unknown key 'sed' (did you mean seed"),
        (
            ["--scene", "metaworld/drawer-opn-v3"],
            "unknown Meta-World task 'drawer-opn-v3' (did you mean drawer-open-v3",
        ),
        (["--encoder", "nowhere"], "nowhere is not an encoder: it does not exist"),
        (
            ["--network.normalisation", "batch", "--learner.batch_size", "1"],
            "--network.normalisation batch has no deviation of --learner.batch_size 1; give a larger one",
        ),
        (
            ["--episode_steps", "600"],
            "--episode_steps 600 is more than the 500 steps that metaworld/drawer-open-v3 allows",
        ),
    ],
)
def test_a_mistake_in_training_keys_is_told_in_a_sentence_and_nothing_is_written(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert cli.main(["train-rl", "--out", str(out), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_keys_that_a_baseline_does_not_have_are_in_no_ones_way() -> None:
    ppo = cli.parse("train-rl", ["--out", "x", "--algo", "ppo", "--env_steps", "1500"])
    assert ppo.env_steps < ppo.warmup_steps
    keys = ["--algo", "sb3-sac", "--replay.capacity", "100"]  # it draws a transition more than once
    assert cli.parse("train-rl", ["--out", "x", *keys]).replay.capacity == 100


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--run", "nowhere"], "nowhere is not a train-rl run with a policy: it holds no policy.json"),
        (["--run", "x", "--episodes", "0"], "--episodes must be at least 1, got 0"),
        (["--run", "x", "--video_size", "100"], "--video_size must be a multiple of 16"),
    ],
)
def test_a_mistake_in_evaluation_keys_is_told_in_a_sentence_and_nothing_is_written(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "evaluation"
    assert cli.main(["evaluate", "--out", str(out), *arguments]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


TRAINING_RECIPES = sorted({*(ROOT / "rl").glob("*.yaml")} - {*(ROOT / "rl").glob("tune*.yaml")})


@pytest.mark.parametrize("recipe", TRAINING_RECIPES, ids=lambda path: path.stem)
def test_shipped_recipes_are_valid(recipe: Path) -> None:
    config = cli.parse("train-rl", ["--config", str(recipe), "--out", "x"])
    assert config.final_evaluation_episodes >= 20


def test_the_recipe_of_50_000_steps_learns_as_the_agents_that_its_figures_are_of() -> None:
    same = {"scene": "metaworld/drawer-open-v3", "eyes": LATENTS}
    arms = read_entries(ROOT / result_file(**same), "arms")
    (arm,) = (arm for arm in arms if arm.items() >= {**same, "env_steps": 50_000, "arm": ARM}.items())
    steps = ["--env_steps", str(arm["env_steps"])]
    measured = cli.parse("train-rl", ["--config", str(ROOT / "rl/demo.yaml"), *steps, *arm["keys"], "--out", "x"])
    shipped = cli.parse("train-rl", ["--config", str(ROOT / "rl/drawer-open.yaml"), "--out", "x"])
    intervals = {
        name: getattr(measured, name)
        for name in ("evaluation_every", "evaluation_episodes", "final_evaluation_episodes", "checkpoint_every")
    }
    assert dataclasses.replace(shipped, **intervals) == measured


@pytest.mark.parametrize("ingredient", ablation.WITHOUT)
def test_what_an_ablation_leaves_out_is_in_the_recipe_and_nothing_else_changes(ingredient: str) -> None:
    recipe, keys = ["--config", str(ROOT / ablation.RECIPE), "--out", "x"], ablation.WITHOUT[ingredient]
    whole, without = (cli.parse("train-rl", [*recipe, *more]).content() for more in ([], keys))
    names = [key.removeprefix("--").split(".") for key in keys[::2]]
    before, after = ([reduce(getitem, name, content) for name in names] for content in (whole, without))
    assert all(one != other for one, other in zip(before, after, strict=True))
    for *groups, name in names:
        reduce(getitem, groups, without)[name] = reduce(getitem, groups, whole)[name]
    assert without == whole


EXPERIMENTS = yaml.safe_load((ROOT / "rl" / "paper" / "experiments.yaml").read_text())["experiments"]


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_papers_experiments_are_valid(name: str) -> None:
    experiment = EXPERIMENTS[name]
    keys = [word for key, value in experiment.get("keys", {}).items() for word in (f"--{key}", str(value))]
    config = cli.parse("train-rl", ["--config", str(ROOT / experiment["recipe"]), *keys, "--out", "x"])
    assert config.final_evaluation_episodes >= 20
    assert len(set(experiment["seeds"])) == len(experiment["seeds"]) >= 3
    assert {"group", "title", "recipe", "seeds"} <= set(experiment)


def test_resuming_with_other_keys_is_refused(tmp_path: Path) -> None:
    from nerf_rl.files.outputs import write_provenance
    from nerf_rl.rl.train import _can_resume

    config = cli.parse("train-rl", ["--out", str(tmp_path)])
    assert not _can_resume(tmp_path, config)
    write_provenance(tmp_path, "train-rl", config)
    assert _can_resume(tmp_path, cli.parse("train-rl", ["--out", str(tmp_path), "--env_steps", "90000"]))
    other = cli.parse("train-rl", ["--out", str(tmp_path), "--seed", "3", "--learner.gamma", "0.5"])
    with pytest.raises(UserError, match="was begun with another --learner, --seed"):
        _can_resume(tmp_path, other)
