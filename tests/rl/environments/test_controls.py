"""Agents that see nothing, and agents with an encoder that nobody trained."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.environments.make import EnvSpec, make_env
from nerf_rl.rl.environments.observation import LatentObservation


def acted(spec: EnvSpec, seed: int = 3) -> tuple[np.ndarray, LatentObservation]:
    env, _ = make_env(spec)
    assert isinstance(env, LatentObservation)
    observation, _ = env.reset(seed=seed)
    for action in np.random.default_rng(0).uniform(-1, 1, (3, 4)).astype(np.float32):
        observation = env.step(action)[0]
    env.close()
    return observation, env


@pytest.fixture
def spec(tiny_encoder: Path) -> EnvSpec:
    return EnvSpec("metaworld/drawer-open-v3", str(tiny_encoder), 2, 20)


def test_a_blind_agent_has_its_hand_and_nothing_else(spec: EnvSpec) -> None:
    seeing, env = acted(spec)
    blind, unseeing = acted(dataclasses.replace(spec, control="blind"))
    size = env.encoder.latent_size
    assert (blind[:size] == 0).all() and (seeing[:size] != 0).any()
    assert np.array_equal(blind[size:], seeing[size:])
    mean = env.encoder.latent_mean.numpy()  # what is drawn of its latent is what a scene looks like on the mean
    assert mean.any() and np.array_equal(unseeing.last_latent, mean)


def test_an_untrained_encoder_sees_something_else_at_the_same_scale_and_the_same_in_every_process(
    spec: EnvSpec,
) -> None:
    seeing, env = acted(spec)
    control = dataclasses.replace(spec, control="random")
    random, untrained = acted(control)
    again, _ = acted(control)
    size = env.encoder.latent_size
    assert np.array_equal(random, again)
    assert np.array_equal(random[size:], seeing[size:]), "what was looked at before changes the episode"
    assert not np.allclose(random[:size], seeing[:size])
    spread = np.stack([random[:size], *(acted(control, seed)[0][:size] for seed in range(2))])
    assert 0.02 < np.abs(spread).mean() < 10
    assert spread.std(0).max() > 0.01
    assert np.array_equal(untrained.encoder.rig.camera_from_world, env.encoder.rig.camera_from_world)


@pytest.mark.parametrize("control", ["blind", "random"])
def test_a_control_is_trained_and_evaluated_as_what_it_is(tiny_encoder: Path, tmp_path: Path, control: str) -> None:
    run = tmp_path / "run"
    command = ["train-rl", "--encoder", str(tiny_encoder), "--control", control, "--out", str(run)]
    assert cli.main([*command, *TINY_TRAINING]) == 0
    assert json.loads((run / "policy.json").read_text())["env"]["control"] == control
    assert cli.main(["evaluate", "--run", str(run), "--out", str(tmp_path / "eval"), "--episodes", "2"]) == 0


def test_a_control_needs_something_to_compare_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(UserError, match="--control blind is for agents with an encoder"):
        TrainRLConfig("out", control="blind")
    assert cli.main(["train-rl", "--out", str(tmp_path), "--encoder", "there", "--control", "deaf"]) == 2
    assert "unknown control 'deaf'; available: blind, none, random" in capsys.readouterr().err
