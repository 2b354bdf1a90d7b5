"""Environments: action repeat, time limits, resets, evaluation."""

import multiprocessing
import os
import signal
import threading
from pathlib import Path

import numpy as np
import pytest
from tiny_environment import Point, point_env, point_envs

from nerf_rl.errors import FailureError, UserError
from nerf_rl.machine.processes import start_method
from nerf_rl.rl.environments.make import EnvSpec, make_env, make_vector_env
from nerf_rl.rl.environments.vector import OVERTIME, reset_some
from nerf_rl.rl.environments.wrappers import TimeLimit
from nerf_rl.rl.training.episodes import evaluation_seeds, run_episodes, training_seed


def to_zero(observation: np.ndarray) -> np.ndarray:
    return np.clip(-2.0 * observation[:, :1], -1.0, 1.0).astype(np.float32)


@pytest.mark.parametrize("methods", [["fork", "spawn", "forkserver"], ["spawn"]])  # of Linux, and of Windows
def test_worker_processes_see_what_this_one_sees_however_they_are_started(
    methods: list[str], tiny_encoder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(multiprocessing, "get_all_start_methods", lambda: methods)
    assert start_method([]) == methods[-1]
    spec = EnvSpec("metaworld/drawer-open-v3", str(tiny_encoder), 2, 20)
    envs, (env, _) = make_vector_env(spec, 2), make_env(spec)
    try:
        action = np.full(envs.single_action_space.shape or (), 0.5, np.float32)
        seen = [reset_some(envs, np.array([True, True]), [3, 3]), envs.step(np.stack([action, action]))[0]]
        for workers, own in zip(seen, (env.reset(seed=3)[0], env.step(action)[0]), strict=True):
            np.testing.assert_allclose(workers, np.stack([own, own]), rtol=1e-4, atol=1e-5)
    finally:
        envs.close(terminate=True)
        env.close()


def test_action_repeat_sums_rewards_and_counts_steps() -> None:
    env, single = point_env(repeat=3), Point()
    env.reset(seed=1)
    single.reset(seed=1)
    action = np.array([0.3], np.float32)
    rewards = [single.step(action)[1] for _ in range(3)]
    observation, reward, _, _, info = env.step(action)
    assert reward == pytest.approx(sum(rewards))
    assert observation[0] == pytest.approx(single.position)
    assert info == {"success": info["success"], "env_steps": 3}


def test_action_repeat_stops_at_the_time_limit_which_counts_environment_steps() -> None:
    env = point_env(steps=5, repeat=3)
    env.reset(seed=1)
    assert env.step(np.zeros(1))[2:4] == (False, False)
    _, _, terminated, truncated, info = env.step(np.zeros(1))
    assert (terminated, truncated, info["env_steps"]) == (False, True, 2)


@pytest.mark.parametrize(("overtime", "last"), [(0, 5), (1, 5), (3, 7)])
def test_an_episode_that_succeeds_late_goes_on_as_long_as_its_reset_asks_for(overtime: int, last: int) -> None:
    env = TimeLimit(Point(), 5)
    env.reset(seed=1, options={OVERTIME: overtime})
    moves = [0.0, 0.0, 0.0, -0.5, *[1.0] * 10]  # away again at once: what counts is the first success
    env.unwrapped.position = 0.1
    ends = [env.step(np.array([move]))[3] for move in moves]
    assert ends.index(True) + 1 == last
    env.reset(seed=1)
    env.unwrapped.position = 0.1
    assert [env.step(np.array([move]))[3] for move in moves].index(True) + 1 == 5, "nothing was asked for"


def test_action_repeat_remembers_a_success_in_between() -> None:
    env = point_env(repeat=4)
    env.reset(seed=1)
    env.unwrapped.position = -0.4
    _, _, _, _, info = env.step(np.ones(1))
    assert env.unwrapped.position == pytest.approx(0.4)
    assert info["success"] is True


def test_a_vector_step_returns_the_true_last_observation_and_resets_only_who_is_done() -> None:
    envs = point_envs(2, steps=4)
    try:
        seeds = [11, 12]
        start = reset_some(envs, np.array([True, True]), seeds)
        alone = [point_env(steps=4) for _ in seeds]
        assert np.array_equal(start, [env.reset(seed=seed)[0] for env, seed in zip(alone, seeds, strict=True)])
        for _ in range(2):
            envs.step(np.full((2, 1), 0.5, np.float32))
        restarted = reset_some(envs, np.array([False, True]), [0, 13])
        assert restarted[0, 1] == 2
        assert np.array_equal(restarted[1], alone[1].reset(seed=13)[0])
        for _ in range(2):
            observation, _, terminated, truncated, _ = envs.step(np.full((2, 1), 0.5, np.float32))
        assert truncated.tolist() == [True, False] and not terminated.any()
        assert observation[0, 1] == 4, "the last observation of the episode, not the first of the next"
        assert observation[0, 0] == pytest.approx(start[0, 0] + 4 * 0.1, abs=1e-6)
    finally:
        envs.close(terminate=True)


@pytest.mark.parametrize("where", ["reset", "step"])
def test_a_worker_that_hangs_is_noticed(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    envs = point_envs(2, steps=4)
    pid = envs.processes[1].pid
    release = threading.Timer(20.0, os.kill, (pid, signal.SIGCONT))  # else nothing but the timeout under test ends this
    release.start()

    def hang(observation: np.ndarray) -> np.ndarray:
        os.kill(pid, signal.SIGSTOP)
        return to_zero(observation)

    try:
        reset_some(envs, np.ones(2, np.bool_), [0, 1])
        monkeypatch.setattr("nerf_rl.rl.environments.vector.TIMEOUT", 1.0)
        if where == "reset":
            os.kill(pid, signal.SIGSTOP)
        with pytest.raises(
            FailureError, match="the process of an environment has not answered for 1 s: it hangs"
        ) as told:
            run_episodes(envs, hang, [0, 1])
        assert f"`{where}_wait` has timed out after 1.0" in str(told.value.__cause__)
    finally:
        release.cancel()
        os.kill(pid, signal.SIGCONT)
        envs.close(terminate=True)


@pytest.mark.parametrize(("count", "to_end"), [(1, False), (3, False), (2, True)])
def test_evaluation_runs_each_seed_once_whatever_the_number_of_environments(count: int, to_end: bool) -> None:
    seeds = evaluation_seeds(0, 7)
    envs = point_envs(count, steps=4)
    try:
        result = run_episodes(envs, to_zero, seeds, to_end)
    finally:
        envs.close(terminate=True)
    for index, seed in enumerate(seeds):
        env = point_env(steps=4)
        observation, _ = env.reset(seed=seed)
        total, length, success, over = 0.0, 0, False, False
        while not over and (to_end or not success):
            observation, reward, terminated, truncated, info = env.step(to_zero(observation[None])[0])
            total, length, over = total + reward, length + 1, terminated or truncated
            success = success or info["success"]
        assert (result.success[index], result.length[index]) == (success, length)
        assert result.returns[index] == pytest.approx(total)
    assert 0 < result.success.sum() < 7, "the test should see both outcomes"
    summary = result.summary()
    assert summary["episodes"] == 7
    assert summary["ci_low"] < summary["success_rate"] < summary["ci_high"]


def test_seeds_of_training_and_evaluation_do_not_meet() -> None:
    training = {training_seed(0, env, episode) for env in range(4) for episode in range(200)}
    evaluation = evaluation_seeds(0, 200)
    assert len(training) == 800
    assert evaluation[:20] == evaluation_seeds(0, 20)
    assert not training & set(evaluation)


def test_an_episode_longer_than_the_scene_allows_is_refused() -> None:
    with pytest.raises(UserError, match="--episode_steps 501 is more than the 500 steps"):
        make_env(EnvSpec("metaworld/drawer-open-v3", None, 2, 501))


def test_the_state_environment_is_float32_repeatable_and_of_fixed_length() -> None:
    env, scene = make_env(EnvSpec("metaworld/drawer-open-v3", None, 2, 20))
    first, _ = env.reset(seed=5)
    assert first.dtype == np.float32 and env.observation_space.contains(first)
    total = 0
    for step in range(10):
        observation, _, terminated, truncated, info = env.step(np.full(4, 0.1))
        total += info["env_steps"]
        assert observation.dtype == np.float32 and truncated == (step == 9) and not terminated
    assert total == 20
    assert np.array_equal(env.reset(seed=5)[0], first)
    assert not np.array_equal(env.reset(seed=6)[0], first)
    scene.env.close()
