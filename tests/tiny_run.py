"""Training runs on the tiny environment."""

from pathlib import Path

from nerf_rl.progress import Progress
from nerf_rl.rl.config import LearnerConfig, NetworkConfig, NoiseConfig, ReplayConfig, TrainRLConfig
from nerf_rl.rl.training.loop import Trainer


def config(run: Path, **keys: object) -> TrainRLConfig:
    return TrainRLConfig(
        str(run),
        env_steps=4000,
        warmup_steps=100,
        network=NetworkConfig(hidden=[32, 32]),
        learner=LearnerConfig(batch_size=32, actor_rate=1e-3, reward_scale=1.0, actor_every=1, policy_average=20),
        noise=NoiseConfig(decay_steps=1500, end=0.05),
        replay=ReplayConfig(capacity=4000),
        **keys,
    )


def train(trainer: Trainer, until: int) -> None:
    with Progress(until, "env steps", done=trainer.env_steps) as progress:
        trainer.train(progress, until)
