"""PandaReach against panda-gym itself, and train-rl on it."""

import json
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.config import PandaReachConfig
from nerf_rl.rl.environments.make import EnvSpec, make_env, make_goal_task
from nerf_rl.rl.environments.panda_reach import PANDA_REACH, PandaReach
from nerf_rl.rl.rollout import film, rollout

panda_gym = pytest.importorskip("panda_gym", reason="extra panda")

TINY = ["--scene", PANDA_REACH, "--env_steps", "150", "--warmup_steps", "60", "--episode_steps", "20", "--envs", "1"]
TINY += [
    "--action_repeat",
    "1",
    "--learner.batch_size",
    "8",
    "--network.hidden",
    "[16, 16]",
    "--replay.capacity",
    "2000",
]
TINY += [
    "--evaluation_every",
    "100",
    "--evaluation_episodes",
    "2",
    "--final_evaluation_episodes",
    "2",
    "--log_every",
    "50",
]


@pytest.mark.parametrize("control", ["joints", "ee"])
def test_it_is_panda_gyms_simulation_with_another_observation(control: str) -> None:
    ids = {"joints": "PandaReachJointsDense-v3", "ee": "PandaReachDense-v3"}
    theirs = gymnasium.make(ids[control])
    config = PandaReachConfig(control=control, observation="panda-gym")
    ours, _ = make_env(EnvSpec(PANDA_REACH, None, 1, 50, config))
    assert ours.action_space.shape == theirs.action_space.shape == ((7,) if control == "joints" else (3,))
    raw, _ = theirs.reset(seed=11)
    observation, _ = ours.reset(seed=11)
    rng = np.random.default_rng(0)
    for _ in range(10):
        assert observation == pytest.approx(
            np.concatenate([raw["observation"][3:], raw["achieved_goal"], raw["desired_goal"]])
        )
        action = rng.uniform(-1, 1, ours.action_space.shape).astype(np.float32)
        raw, their_reward, their_end, _, _ = theirs.step(action)
        observation, reward, end, _, info = ours.step(action)
        assert (reward, end) == (pytest.approx(float(their_reward)), their_end)
        assert info == {"env_steps": 1, "success": end}
    theirs.close()
    ours.close()


@pytest.mark.parametrize("observation", ["full", "paper", "panda-gym"])
def test_the_task_finds_position_and_goal_in_each_kind_of_observation(observation: str) -> None:
    spec = EnvSpec(PANDA_REACH, None, 1, 50, PandaReachConfig(observation=observation, reward="bonus"))
    (env, _), task = make_env(spec), make_goal_task(spec)
    assert task is not None
    first, _ = env.reset(seed=3)
    second, reward, _, _, _ = env.step(np.ones(7, np.float32))
    simulation = env.unwrapped._simulation  # type: ignore[attr-defined]
    position, goal = (np.array(place) for place in (simulation.robot.get_ee_position(), simulation.task.goal))
    angles = [simulation.robot.get_joint_angle(joint=joint) for joint in range(7)]
    velocity = simulation.robot.get_ee_velocity()
    parts = {
        "full": [*angles, *velocity, *position, *goal, *(goal - position)],
        "paper": [*angles, *position, *goal],
        "panda-gym": [*velocity, *position, *goal],
    }
    assert first.dtype == np.float32 and first.shape == env.observation_space.shape
    assert second == pytest.approx(np.array(parts[observation]), abs=1e-6)
    assert task.achieved(second) == pytest.approx(position, abs=1e-6)
    assert task.with_goal(second, goal.astype(np.float32)) == pytest.approx(second, abs=1e-6)
    assert reward == pytest.approx(float(task.outcome(task.achieved(second), goal)[0]), abs=1e-6)
    env.close()


def test_an_episode_with_the_same_seed_is_the_same() -> None:
    def episode() -> np.ndarray:
        env, _ = make_env(EnvSpec(PANDA_REACH, None, 1, 6))
        observations = [env.reset(seed=5)[0]]
        ended = False
        while not ended:
            observation, _, terminated, truncated, _ = env.step(np.full(7, 0.3, np.float32))
            observations.append(observation)
            ended = terminated or truncated
        env.close()
        return np.stack(observations)

    first = episode()
    assert len(first) > 2
    np.testing.assert_array_equal(first, episode())


def test_a_seed_decides_the_episodes_after_it_too() -> None:
    """Where nobody gives another: Stable-Baselines3 seeds the first reset alone."""

    def goals() -> np.ndarray:
        env, _ = make_env(EnvSpec(PANDA_REACH, None, 1, 6))
        found = [env.reset(seed=5)[0], env.reset()[0], env.reset()[0]]
        env.close()
        return np.stack(found)

    first = goals()
    assert len(np.unique(first, axis=0)) == 3
    np.testing.assert_array_equal(first, goals())


def test_nothing_is_printed_by_the_simulator(capfd: pytest.CaptureFixture[str]) -> None:
    PandaReach(PandaReachConfig()).close()
    assert capfd.readouterr() == ("", "")


def test_training_with_hindsight_evaluating_and_filming_work_by_command(tmp_path: Path) -> None:
    out = tmp_path / "run"
    task = ["--replay.hindsight", "2", "--panda.reward", "sparse", "--episode_steps", "10"]  # its pictures take long
    assert cli.main(["train-rl", "--out", str(out), *TINY, *task]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["episodes"] >= 15  # 150 steps in episodes of at most 10
    assert summary["evaluations"][-1]["training_episodes"] == summary["episodes"]
    assert Policy.load(out).spec.panda.reward == "sparse"
    keys = ["--episodes", "2", "--video", "true", "--video_episodes", "1", "--video_size", "64"]
    assert cli.main(["evaluate", "--run", str(out), "--out", str(tmp_path / "evaluation"), *keys]) == 0
    episode = rollout(out, seed=0, view_size=64)
    frames = film(episode)
    assert frames.shape[1:] == (64, 64, 3) and len(frames) == len(episode.actions) + 1
    assert frames.std() > 10  # a robot on a table, not one colour


def test_a_run_ends_after_its_episodes(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert cli.main(["train-rl", "--out", str(out), *TINY, "--episodes", "4"]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert summary["episodes"] == 4
    assert summary["env_steps"] <= 4 * 20
