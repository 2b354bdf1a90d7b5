"""What episodes brought, as the least that their steps are worth: computed, remembered, used by the critic."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.errors import MissingFileError
from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.config import LearnerConfig, NetworkConfig, ReplayConfig
from nerf_rl.rl.experience import replay as replay_module
from nerf_rl.rl.experience.n_step import NStep, Transition
from nerf_rl.rl.experience.replay import Replay
from nerf_rl.rl.experience.returns_to_go import returns_to_go, steady_value

GAMMA, LENGTH, LAST = 0.9, 7, 5.0


def transitions(n: int, terminated: bool, offset: float = 0.0) -> list[Transition]:
    """Return those of an episode with rewards 1, 2, ..., which ends by itself or is cut."""
    steps, found = NStep(n, GAMMA), []
    for t in range(LENGTH):
        here, there = (np.full(2, offset + time, np.float32) for time in (t, t + 1))
        ended = terminated and t == LENGTH - 1
        found += steps.push(here, np.zeros(1, np.float32), float(t + 1), there, ended, False)
    return found + steps.cut()


def expected(terminated: bool) -> np.ndarray:
    """Return the same sums by their definition."""
    rest = 0.0 if terminated else LAST
    return np.array(
        [
            sum(GAMMA ** (k - t) * (k + 1) for k in range(t, LENGTH)) + GAMMA ** (LENGTH - t) * rest
            for t in range(LENGTH)
        ]
    )


def memory(folder: Path, steps: int, capacity: int = 100) -> Replay:
    return Replay(ReplayConfig(capacity=capacity), 2, 1, 64, folder, envs=2, bounded_steps=steps)


def bounds(replay: Replay) -> dict[float, float]:
    """Return the bound of each observation that is drawn, by its first number."""
    batches = [replay.sample(0.5) for _ in range(20)]
    return {float(o): float(b) for batch in batches for o, b in zip(batch.observation[:, 0], batch.bound, strict=True)}


@pytest.mark.parametrize("terminated", [True, False])
@pytest.mark.parametrize("n", [1, 3, LENGTH, LENGTH + 2])
def test_they_are_the_discounted_rewards_to_the_end_whatever_transitions_span(n: int, terminated: bool) -> None:
    rows = transitions(n, terminated)
    reward, discount = (np.array([getattr(row, name) for row in rows]) for name in ("reward", "discount"))
    np.testing.assert_allclose(returns_to_go(reward, discount, n, LAST), expected(terminated))


def test_memory_tells_them_once_the_episode_is_over_and_of_no_other(tmp_path: Path) -> None:
    replay = memory(tmp_path / "replay", 3)
    for pair in zip(transitions(3, False), transitions(3, False, offset=100.0), strict=True):
        for env, row in enumerate(pair):
            replay.add([row], env)
    replay.add(transitions(3, False, offset=200.0))  # of no episode as it happened
    assert max(bounds(replay).values()) < -1e30
    asked: list[np.ndarray] = []
    replay.end_episode(0, lambda observation: asked.append(observation) or LAST)
    replay.end_episode(1, None)  # nobody knew what comes after it
    told = bounds(replay)
    assert asked[0].tolist() == [LENGTH, LENGTH]
    np.testing.assert_allclose([told[float(t)] for t in range(LENGTH)], expected(False), rtol=1e-6)
    assert max(told[offset + t] for offset in (100.0, 200.0) for t in range(LENGTH)) < -1e30
    replay.close()


@pytest.mark.parametrize("n", [1, 3, LENGTH + 2])
@pytest.mark.parametrize("hope", [1000.0, 1.0])
def test_the_end_is_worth_no_more_than_to_go_on_as_in_the_last_steps(n: int, hope: float, tmp_path: Path) -> None:
    spans = min(n, LENGTH)  # of an episode that is shorter, as many steps as there are
    rewards = np.arange(LENGTH - spans, LENGTH) + 1.0
    forever = (GAMMA ** np.arange(spans) @ rewards) / (1.0 - GAMMA**spans)
    replay = Replay(ReplayConfig(capacity=100), 2, 1, 64, tmp_path / "replay", bounded_steps=n, steady_ends=True)
    replay.add(transitions(n, False), 0)
    replay.end_episode(0, lambda _: hope)
    last = LENGTH + GAMMA * min(hope, forever)
    assert bounds(replay)[LENGTH - 1.0] == pytest.approx(last, rel=1e-5)
    replay.close()


def test_what_never_ends_and_is_not_discounted_has_no_such_limit() -> None:
    assert steady_value(np.ones(4), np.ones(4), 2) == np.inf
    assert steady_value(np.ones(4), np.zeros(4), 2) == 1.0  # it ended by itself


def test_a_row_that_is_written_anew_has_none(tmp_path: Path) -> None:
    replay = memory(tmp_path / "replay", 3, capacity=LENGTH)
    replay.add(transitions(3, False), 0)
    replay.end_episode(0, lambda _: LAST)
    replay.add(transitions(3, False, offset=100.0)[:2], 0)
    told = bounds(replay)
    assert max(told[100.0], told[101.0]) < -1e30
    np.testing.assert_allclose([told[float(t)] for t in range(2, LENGTH)], expected(False)[2:], rtol=1e-6)
    replay.add(transitions(3, False, offset=100.0)[2:], 0)
    replay.add(transitions(3, False, offset=200.0)[:2], 0)  # the beginning of an episode that is longer than memory
    replay.end_episode(0, lambda _: LAST)
    assert len(bounds(replay)) == LENGTH and min(bounds(replay).values()) > 0
    replay.close()


def test_they_come_back_with_a_checkpoint(tmp_path: Path) -> None:
    replay, again = memory(tmp_path / "replay", 3), memory(tmp_path / "again", 3)
    replay.add(transitions(3, False), 0)
    replay.end_episode(0, lambda _: LAST)
    state = {name: tensor.clone() for name, tensor in replay.state().items()}
    again.load_state(state)
    assert bounds(again) == bounds(replay)
    with pytest.raises(MissingFileError, match="bound"):
        memory(tmp_path / "third", 3).load_state(state | {"bound": state["bound"][:-1]})
    replay.close()
    again.close()


def test_a_critic_learns_the_way_that_its_own_policy_does_not_go(tmp_path: Path) -> None:
    """A corridor: its end pays, and the policy rests at the entrance. One walk through it shows what it is worth."""
    length, worth = 10, 10.0

    def value_at_the_entrance(bounded: bool) -> float:
        torch.manual_seed(0)
        learner = LearnerConfig(
            gamma=GAMMA, n_step=1, batch_size=64, reward_scale=1.0, bound_by_returns=bounded, pre_tanh_penalty=100.0
        )  # the penalty holds the policy where it is: at rest
        agent = DDPG(1, 1, NetworkConfig(hidden=[32, 32], standardise=False), learner)
        config = ReplayConfig(capacity=1000, prioritised=False)
        steps = learner.n_step if bounded else 0
        replay = Replay(config, 1, 1, 64, tmp_path / str(bounded), bounded_steps=steps)
        walk = [(place, 1.0, worth * (place == length - 1), place + 1) for place in range(length)]
        rest = [(place, 0.0, 0.0, place) for place in range(length) for _ in range(5)]
        for episode in (walk, rest):
            for place, action, reward, then in episode:
                discount = 0.0 if then == length else GAMMA
                here, there = (np.array([p / length], np.float32) for p in (place, then))
                replay.add([Transition(here, np.array([action], np.float32), reward, discount, there)], 0)
            replay.end_episode(0, (lambda _: 0.0) if episode is walk else None)
        for _ in range(600):
            agent.update(replay, 1.0)
        replay.close()
        return agent.critic(torch.zeros(1, 1), torch.ones(1, 1)).item()

    there = worth * GAMMA ** (length - 1)
    assert value_at_the_entrance(bounded=True) > 0.7 * there
    assert value_at_the_entrance(bounded=False) < 0.3 * there


def test_a_run_that_is_bounded_resumes_bit_for_bit(tmp_path: Path) -> None:
    tiny = [
        "train-rl",
        *TINY_TRAINING,
        "--replay.prioritised",
        "false",
        "--checkpoint_every",
        "40",
    ]  # no beta to stretch
    keys = [*tiny, "--learner.bound_by_returns", "true"]
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert cli.main([*keys, "--env_steps", "120", "--out", str(whole)]) == 0
    assert cli.main([*keys, "--env_steps", "80", "--out", str(parts)]) == 0
    assert cli.main([*keys, "--env_steps", "120", "--out", str(parts), "--resume", "true"]) == 0
    policies = [(run / "policy.safetensors").read_bytes() for run in (whole, parts)]
    assert policies[0] == policies[1]
    other = tmp_path / "other"
    assert cli.main([*tiny, "--env_steps", "120", "--out", str(other)]) == 0
    assert (other / "policy.safetensors").read_bytes() != policies[0]


@pytest.mark.parametrize("steady", ["true", "false"])
def test_a_run_keeps_to_the_end_that_was_asked_for(
    steady: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[np.ndarray, np.ndarray, int]] = []

    def counted(*happened: Any) -> float:
        asked.append(happened)
        return steady_value(*happened)

    monkeypatch.setattr(replay_module, "steady_value", counted)
    keys = ["--learner.bound_by_returns", "true", "--learner.steady_ends", steady, "--out", str(tmp_path / "run")]
    assert cli.main(["train-rl", *TINY_TRAINING, *keys]) == 0
    assert bool(asked) == (steady == "true")


def test_an_algorithm_of_ones_own_has_to_know_values(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(
        "from nerf_rl.rl.agents.ddpg import DDPG\n\n\nclass Mine(DDPG):\n    value = None\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    keys = ["--algo", "mine:Mine", "--learner.bound_by_returns", "true", "--out", str(tmp_path / "run")]
    assert cli.main(["train-rl", *keys]) == 2
    assert "'mine:Mine' is no algorithm: it lacks value" in capsys.readouterr().err
