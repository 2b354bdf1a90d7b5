"""Stable-Baselines3's agents behind train-rl: the same run folder, and the exported policy acts as the model did."""

import csv
import json
import shutil
from pathlib import Path

import gymnasium
import numpy as np
import own_environments
import pytest
import torch
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.config import BASELINES, OFF_POLICY_BASELINES, LearnerConfig, NoiseConfig, TrainRLConfig
from nerf_rl.rl.environments.make import EnvSpec

pytest.importorskip("stable_baselines3", reason="extra sb3")

TINY = ["--env_steps", "240", "--warmup_steps", "40", "--episode_steps", "20", "--envs", "1", "--log_every", "80"]
TINY += [
    "--learner.batch_size",
    "8",
    "--network.hidden",
    "[16, 16]",
    "--replay.capacity",
    "500",
    "--noise.kind",
    "gaussian",
]
TINY += ["--evaluation_every", "120", "--evaluation_episodes", "2", "--final_evaluation_episodes", "2"]
TINY += ["--ppo.n_steps", "32", "--ppo.batch_size", "16", "--ppo.n_epochs", "2", "--ppo.hidden", "[16, 16]"]


@pytest.mark.parametrize("algo", BASELINES)
def test_a_baseline_leaves_what_our_own_agent_leaves(algo: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert cli.main(["train-rl", "--algo", algo, "--out", str(out), *TINY]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["env_steps"] == 240
    assert [e["env_steps"] for e in summary["evaluations"]] == [120, 240]
    assert summary["episodes"] == 12 and summary["updates"] > 0
    with open(out / "metrics.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["env_steps"] for row in rows] == ["80", "120", "200", "240"]  # and where it is evaluated
    assert float(rows[-1]["episode_length"]) == 20 and float(rows[-1]["critic_loss"]) > 0
    assert not [path for path in out.rglob("*") if path.suffix in (".zip", ".pkl", ".pt", ".pth")]
    assert cli.main(["evaluate", "--run", str(out), "--out", str(tmp_path / "evaluation"), "--episodes", "2"]) == 0


def test_another_agents_interrupted_run_is_not_begun_anew(
    tiny_agent: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(shutil.copytree(tiny_agent, tmp_path / "run"))
    (run / "summary.json").unlink()
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    words = ["--encoder", str(tiny_encoder), "--algo", "ppo", "--out", str(run), "--resume", "true", *TINY_TRAINING]
    assert cli.main(["train-rl", *words]) == 2
    assert "was begun with another --algo" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before


@pytest.mark.parametrize(
    ("envs", "updates", "frequency", "steps"),
    [(1, 1.0, 1, 1), (2, 1.5, 1, 3), (1, 1.5, 2, 3), (1, 0.1, 10, 1), (2, 0.1, 5, 1)],
)
def test_off_policy_baselines_update_as_often_as_they_are_told(
    envs: int, updates: float, frequency: int, steps: int, tmp_path: Path
) -> None:
    from stable_baselines3 import SAC
    from stable_baselines3.common.vec_env import DummyVecEnv

    from nerf_rl.rl.baselines.models import make_model

    learner = LearnerConfig(updates_per_step=updates)
    config = TrainRLConfig(str(tmp_path), algo="sb3-sac", envs=envs, learner=learner)
    model = make_model(config, DummyVecEnv([lambda: gymnasium.make("InvertedPendulum-v5")] * envs))
    assert isinstance(model, SAC)
    assert (model.train_freq.frequency, model.gradient_steps) == (frequency, steps)


EXPORTS = [("ppo", True), ("ppo", False), *((algo, False) for algo in OFF_POLICY_BASELINES)]


@pytest.mark.parametrize(("algo", "normalise"), EXPORTS)
def test_the_exported_policy_acts_as_the_model_does(algo: str, normalise: bool, tmp_path: Path) -> None:
    from nerf_rl.rl.baselines.models import layered_config
    from nerf_rl.rl.baselines.train import BaselineTrainer
    from nerf_rl.rl.config import NoiseConfig
    from nerf_rl.rl.environments.make import EnvSpec, make_vector_env

    config = TrainRLConfig(
        str(tmp_path), algo=algo, env_steps=300, warmup_steps=50, envs=1, noise=NoiseConfig(kind="gaussian"),
        evaluation_every=300, final_evaluation_episodes=1,
    )  # fmt: skip
    config.ppo.n_steps, config.ppo.batch_size, config.ppo.normalise = 64, 32, normalise
    spec = EnvSpec(config.scene, None, 2, 20)
    envs = make_vector_env(spec, 1)
    trainer = BaselineTrainer(config, spec, envs, tmp_path)
    trainer.train(lambda result, progress: None)
    Policy(trainer.actor(), spec, layered_config(config), 39, 4, [], None, 300).save(tmp_path)
    observations = np.random.default_rng(0).normal(scale=0.3, size=(50, 39)).astype(np.float32)
    normaliser = trainer._sb3.get_vec_normalize_env()
    seen = observations if normaliser is None else normaliser.normalize_obs(observations)
    wanted, _ = trainer._sb3.predict(seen, deterministic=True)
    found = Policy.load(tmp_path).act(observations)
    assert found == pytest.approx(wanted, abs=2e-5)
    assert np.abs(wanted).max() > 1e-3
    trainer.close()
    envs.close(terminate=True)


def test_training_runs_through_all_of_its_environments(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert cli.main(["train-rl", "--algo", "ppo", "--out", str(out), *TINY, "--envs", "2"]) == 0
    assert json.loads((out / "summary.json").read_text())["episodes"] == 12
    assert torch.isfinite(torch.tensor(Policy.load(out).act(np.zeros((1, 39), np.float32)))).all()


def test_success_that_one_environment_tells_at_its_episodes_end_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(own_environments.__file__).parent))
    keys = ["--algo", "ppo", "--scene", own_environments.LATE_SLIDER, *TINY, "--envs", "2", "--action_repeat", "1"]
    assert cli.main(["train-rl", "--out", str(tmp_path / "run"), *keys]) == 0
    with open(tmp_path / "run" / "monitor.csv", newline="") as file:
        file.readline()
        told = [row["is_success"] for row in csv.DictReader(file)]
    assert len(told) > 10 and set(told) == {"1"}


def test_a_missing_extra_is_told_in_a_sentence(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert cli.main(["train-rl", "--algo", "ppo", "--out", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert "--algo ppo needs the extra 'sb3'; in a checkout of nerf-rl: pip install '.[sb3]'" in error
    assert not (tmp_path / "run").exists()


def test_the_noise_of_ornstein_and_uhlenbeck_has_the_size_and_memory_that_are_asked_for() -> None:
    from nerf_rl.rl.baselines.models import _noise

    noise = _noise(NoiseConfig(kind="ou", start=0.5, theta=0.2), 2000)
    drawn = np.stack([noise() for _ in range(60)])[30:]
    assert drawn.std() == pytest.approx(0.5, rel=0.05)
    later, earlier = drawn[1:].ravel(), drawn[:-1].ravel()
    assert np.corrcoef(later, earlier)[0, 1] == pytest.approx(0.8, abs=0.02)
    gaussian = _noise(NoiseConfig(kind="gaussian", start=0.5), 2000)
    assert gaussian().std() == pytest.approx(0.5, rel=0.1)


def test_seeds_of_a_sweep_share_no_environment(tmp_path: Path) -> None:
    from nerf_rl.rl.baselines import train as baselines_train

    spec, seeds = EnvSpec("gym/InvertedPendulum-v5", None, 1, 20), set()
    for seed in range(3):
        config = TrainRLConfig(scene=spec.scene, algo="ppo", out=str(tmp_path), seed=seed, envs=1)
        envs = baselines_train._make_envs(config, spec)
        seeds |= {envs.unwrapped._seeds[0] + step for step in range(8)}  # those of more environments follow it
        envs.close()
    assert len(seeds) == 24
