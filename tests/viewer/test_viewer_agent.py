"""An agent as the viewer shows it."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.config import LearnerConfig
from nerf_rl.rl.training.checkpoint import last_checkpoint, load_checkpoint
from nerf_rl.viewer.pages.agent import Agent
from nerf_rl.viewer.pages.agent_pictures import episode_slide, learning_charts


@pytest.fixture(scope="module")
def agent(tiny_agent: Path) -> Agent:
    return Agent(tiny_agent, "", seed=1, episodes=2)


def test_action_values_are_those_of_the_trained_critic(agent: Agent, tiny_agent: Path) -> None:
    episode = agent.act(0)
    policy = agent.policy
    ddpg = DDPG(policy.observation_size, policy.action_size, policy.network, LearnerConfig())
    folder = last_checkpoint(tiny_agent)
    assert folder is not None
    tensors, _ = load_checkpoint(folder)
    ddpg.load_state_dict({name.removeprefix("agent."): t for name, t in tensors.items() if "agent." in name})
    with torch.no_grad():
        observed = ddpg.norm(torch.from_numpy(episode.rollout.observations))
        expected = ddpg.critic(observed, torch.from_numpy(episode.rollout.actions))
    assert episode.values is not None and np.allclose(episode.values, expected, atol=1e-5)
    assert np.allclose(episode.rollout.actions, policy.act(episode.rollout.observations), atol=1e-5)


def test_without_a_checkpoint_there_are_no_values(tiny_agent: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny_agent, tmp_path / "agent", ignore=shutil.ignore_patterns("checkpoints"))
    episode = Agent(tmp_path / "agent", "", seed=1, episodes=1).act(0)
    assert episode.values is None and "Q" not in episode.lines()


def test_an_episode_is_acted_once(agent: Agent) -> None:
    assert agent.act(1) is agent.act(1)
    assert agent.act(0).seed != agent.act(1).seed
    lines = agent.act(0).lines()
    assert {"reward", "Q", "action 0"} <= set(lines)
    assert all(len(values) == len(agent.act(0)) - 1 for values in lines.values())


def test_learning_curves_and_slides_are_not_blank(agent: Agent) -> None:
    charts = learning_charts(agent.evaluations(), agent.metrics())
    assert len(charts) == 3 and all(chart.std() > 10 for chart in charts)
    slide = episode_slide(agent, agent.act(0), 1)
    assert slide.picture.std() > 10 and "seed" in slide.caption
    assert learning_charts([], {}) == []


def test_the_slides_of_a_control_say_what_it_is(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    seeing = episode_slide(agent, agent.act(0), 1)
    monkeypatch.setattr(agent.policy, "spec", dataclasses.replace(agent.policy.spec, control="blind"))
    slide = episode_slide(agent, agent.act(0), 1)
    assert slide.caption == f"{seeing.caption}, control: the same agent, trained with latents of zero"
    assert slide.picture.shape[0] > seeing.picture.shape[0] and slide.picture[-12:].std() > 10  # a line more


@pytest.mark.parametrize("kind, drawn", [("none", True), ("blind", True), ("random", False)])
def test_a_field_is_drawn_of_latents_of_its_own_encoder_alone(
    kind: str, drawn: bool, tiny_agent: Path, tmp_path: Path
) -> None:
    run = tmp_path / "agent"
    shutil.copytree(tiny_agent, run, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    policy = json.loads((run / "policy.json").read_text())
    policy["env"]["control"] = kind
    (run / "policy.json").write_text(json.dumps(policy))
    agent = Agent(run, "", seed=1, episodes=1)
    assert (agent.folded(agent.act(0), 0) is not None) == drawn


def test_a_baselines_metrics_have_no_signs_of_deadlock_to_draw() -> None:
    steps = np.arange(5.0)
    metrics = {"env_steps": steps, "episode_return": steps, "stuck_for": np.full(5, np.nan)}
    assert len(learning_charts([], metrics)) == 1
