"""Recipes of a tiny dataset and a tiny encoder, and keys of a tiny agent, which several test files share."""

from pathlib import Path

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset

TINY_DATASET = """
scene: metaworld/drawer-open-v3
episodes: 4
frames_per_episode: 3
episode_steps: 12
size: 24
quality: smooth
rig:
  cameras:
    - {name: top, azimuth: 90, elevation: -70}
    - {name: left, azimuth: 20, elevation: -30}
    - {name: right, azimuth: 160, elevation: -30}
  encoder: [left, right]
  test: [top]
  random: {count: 1}
validation_fraction: 0.25
episodes_per_shard: 2
workers: 1
seed: 3
"""

TINY_PRETRAINING = """
encoder: {latent: 8, patch: 4, channels: [8, 16], hidden: 16}
radiance_field: {width: 16, layers: 2, frequencies: 4, plane_size: 8, plane_features: 2}
sampling: {rendering_stratified: 6, rendering_importance: 4}
scenes_per_step: 2
rays_per_scene: 8
steps: 6
steps_per_epoch: 2
epochs_per_validation: 2
validation_frames: 2
probe_frames: 9
precision: "32"
threads: 1
seed: 5
"""

TINY_TRAINING = ["--env_steps", "80", "--warmup_steps", "40", "--episode_steps", "20", "--learner.batch_size", "8"]
TINY_TRAINING += ["--evaluation_every", "40", "--evaluation_episodes", "2", "--final_evaluation_episodes", "2"]
TINY_TRAINING += ["--replay.capacity", "200", "--network.hidden", "[16, 16]"]

_DRAWER = ["--env_steps", "320", "--warmup_steps", "300"]  # a transition is two steps, a batch 128 of them
_PPO = ["--env_steps", "100", "--warmup_steps", "50", "--ppo.batch_size", "20", "--ppo.n_steps"]
_HINDSIGHT = ["--env_steps", "60", "--warmup_steps", "55"]  # one episode, remembered with many goals, is a batch
STEPS_OF_RECIPE = {
    "demo": _DRAWER,
    "demonstrations": [
        "--env_steps",
        "1000",
        "--warmup_steps",
        "300",
        "--learner.clone_steps",
        "10",
        "--episode_steps",  # in which the script succeeds
        "200",
    ],
    "drawer-open": _DRAWER,
    "drawer-open-ppo": [*_PPO, "20"],
    "drawer-open-sb3": ["--env_steps", "620", "--warmup_steps", "500"],
    "gym": ["--env_steps", "160", "--warmup_steps", "145"],
    "gym-goal": ["--env_steps", "120", "--warmup_steps", "110"],
    "panda-reach-ppo": [*_PPO, "40"],
    "panda-reach-sb3-ddpg": ["--env_steps", "130"],
    "panda-reach": _HINDSIGHT,
    "panda-reach-ee": [*_HINDSIGHT, "--learning_starts", "52"],
    "panda-reach-sparse": _HINDSIGHT,
}
"""Of the shipped recipes of agents: enough for an update with the batch of each."""


def travelling_recipe(episodes: int = 4) -> str:
    """Return the recipe of a tiny dataset of a robot that travels; its encoder sees two of three cameras."""
    before, _, after = TINY_DATASET.partition("rig:")
    rest = after[after.index("validation_fraction") :]
    recipe = before.replace("metaworld/drawer-open-v3", "gym/HalfCheetah-v5").replace("steps: 12", "steps: 30")
    rig = "rig: {encoder: [view_0, view_1], test: [view_2], random: {count: 1}}\n"
    return recipe.replace("episodes: 4", f"episodes: {episodes}") + rig + rest


def generate_whole_episodes(recipe: Path, folder: Path, episodes: int, steps: int) -> MultiViewDataset:
    """Return a dataset of a recipe that keeps every step of its episodes."""
    sizes = {"episodes": episodes, "episode_steps": steps, "frames_per_episode": steps + 1}
    keys = [word for key, value in sizes.items() for word in (f"--{key}", str(value))]
    assert cli.main(["gen-dataset", "--config", str(recipe), "--out", str(folder), *keys]) == 0
    return MultiViewDataset(folder)
