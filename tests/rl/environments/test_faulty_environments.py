"""Environments that do what no environment should: each is told in a sentence, and costs nothing that was learnt."""

import json
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from faulty_environments import COLUMN_GOAL, FALLING, INFORMED, FaultySlider, faulty
from own_environments import SLIDER, train

from nerf_rl import cli
from nerf_rl.errors import FailureError, UserError
from nerf_rl.rl.environments.goals import GoalTask, goal_layout
from nerf_rl.rl.environments.make import EnvSpec, make_env, make_goal_task
from nerf_rl.rl.environments.wrappers import TracedErrors, with_flat_observation, with_unit_actions
from nerf_rl.rl.experience.hindsight import Hindsight

pytestmark = pytest.mark.usefixtures("findable")

TOLD = {
    "observation nan": r"number 1 of the 2 that are observed of \S+ is not finite in 32 bits: nan",
    "observation huge": r"number 0 of the 2 that are observed of \S+ is not finite in 32 bits: 1e\+300",
    "observation short": r"\S+ is observed in \(1,\) numbers, where its observation_space has \(2,\)",
    "reward nan": r"\S+ gives a reward that is not one finite number: nan",
    "reward inf": r"\S+ gives a reward that is not one finite number: inf",
    "reward two": r"\S+ gives a reward that is not one finite number: array\(\[0., 0.\]\)",
    "success nan": "a step's information has the success nan, which is neither true nor false",
    "success text": "a step's information has the success 'no', which is neither true nor false",
    "success two": r"a step's information has the success \[True, False\], which is neither true nor false",
    "percent": r"\S+ cannot step: RuntimeError in \S*faulty_environments.py, line \d+: boom at 100 % of 5",
}


@pytest.mark.parametrize("fault", TOLD)
def test_what_is_no_observation_reward_or_success_is_told(fault: str) -> None:
    env, _ = make_env(EnvSpec(faulty(fault), None, 1, 20))
    observation, _ = env.reset(seed=0)
    action = np.zeros(1, np.float32)
    for _ in range(4):
        observation, *_ = env.step(action)
    assert observation.shape == (2,)
    with pytest.raises(FailureError) as told:
        env.step(action)
    assert re.fullmatch(TOLD[fault], str(told.value))
    env.close()


@pytest.mark.parametrize("fault", ["observation nan", "percent", "exit"])
def test_a_run_ends_with_a_sentence_alone_and_keeps_its_last_checkpoint(
    fault: str, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    harmless = ("--episode_steps", "4", "--env_steps", "60", "--checkpoint_every", "20", "--evaluation_every", "20")
    assert train(run, "--scene", faulty(fault), *harmless) == 0
    before = sorted((run / "checkpoints").rglob("*"))
    policy = (run / "policy.safetensors").read_bytes()
    settings = run / "config.yaml"
    settings.write_text(settings.read_text().replace("episode_steps: 4", "episode_steps: 20"))
    capfd.readouterr()
    longer = (*harmless, "--episode_steps", "20", "--env_steps", "200", "--resume", "true")
    assert train(run, "--scene", faulty(fault), *longer) == 1
    told = capfd.readouterr().err
    ended = "the process of an environment has ended: something killed it, such as want of memory; training goes on"
    assert re.search(TOLD.get(fault, ended), told)
    assert "Traceback" not in told and "ERROR" not in told
    assert sorted((run / "checkpoints").rglob("*")) == before
    assert (run / "policy.safetensors").read_bytes() == policy


def test_a_baseline_points_to_the_error_that_ended_a_process(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    words = ("--algo", "ppo", "--envs", "2", "--episode_steps", "20", "--env_steps", "200", "--ppo.n_steps", "20")
    assert train(tmp_path / "run", "--scene", faulty("observation nan"), *words, "--ppo.batch_size", "10") == 1
    assert capfd.readouterr().err.splitlines()[-1] == (  # the process itself writes to where its server does
        "nerf-rl train-rl: the process of an environment has ended: by the error above, if there is one, or killed, "
        "such as for want of memory; --resume true begins anew"
    )


def test_an_error_that_nobody_foresaw_keeps_its_traceback() -> None:
    class Unforeseen(gymnasium.Env):
        def step(self, action: Any) -> Any:
            return {}["grip"]

        def reset(self, **keys: Any) -> Any:
            raise FailureError("told")

    with pytest.raises(RuntimeError, match=r"(?s)in the process of an environment:\nTraceback.*KeyError: 'grip'"):
        TracedErrors(Unforeseen()).step(None)
    with pytest.raises(FailureError, match=r"^told$"):
        TracedErrors(Unforeseen()).reset()


def test_limits_of_the_largest_numbers_are_none() -> None:
    env = gymnasium.Env()
    largest = float(np.finfo(np.float32).max)
    env.action_space = gymnasium.spaces.Box(-largest, largest, (2,))
    with pytest.raises(UserError, match="actions of Env have no limits"):
        with_unit_actions(env)


def test_observations_without_a_number_are_refused() -> None:
    env = gymnasium.Env()
    env.observation_space = gymnasium.spaces.Dict({})
    with pytest.raises(UserError, match="observations of Env have no numbers"):
        with_flat_observation(env)


def test_goals_of_two_shapes_cannot_be_exchanged() -> None:
    env = FaultySlider("")
    one, two = (gymnasium.spaces.Box(-1.0, 1.0, (size,)) for size in (1, 2))
    env.observation_space = gymnasium.spaces.Dict({"observation": two, "achieved_goal": two, "desired_goal": one})
    with pytest.raises(UserError, match=r"must have one shape, to be exchanged, and have \(2,\) and \(1,\)"):
        goal_layout(env)


def test_goals_keep_the_shape_that_the_environment_gives_them() -> None:
    task = make_goal_task(EnvSpec(COLUMN_GOAL, None, 1, 20))
    assert isinstance(task, GoalTask)
    rewards, _ = task.outcome(np.array([[0.0], [0.2]]), np.zeros((2, 1)))
    assert rewards.tolist() == [0.0, -1.0]


def test_a_reward_that_needs_a_steps_information_is_refused_in_hindsight() -> None:
    task = make_goal_task(EnvSpec(INFORMED, None, 1, 20))
    assert isinstance(task, GoalTask)
    with pytest.raises(
        FailureError, match=r"fails for a goal in hindsight, .*\(KeyError: 'grip'\); leave out --replay"
    ):
        task.outcome(np.zeros((1, 1)), np.zeros((1, 1)))


def test_an_episode_that_ends_by_a_fall_ends_there_whatever_its_goal() -> None:
    spec = EnvSpec(FALLING, None, 1, 20)
    task = make_goal_task(spec)
    assert isinstance(task, GoalTask)
    env, _ = make_env(spec)
    hindsight = Hindsight(task, 3, 2, 0.9, np.random.default_rng(0))
    observation, _ = env.reset(seed=0)
    transitions, steps, terminated = [], 0, False
    while not terminated:
        action = np.ones(1, np.float32)
        next_observation, _, terminated, truncated, _ = env.step(action)
        assert not truncated
        transitions += hindsight.push(observation, action, next_observation, terminated, truncated)
        observation, steps = next_observation, steps + 1
    env.close()
    assert steps > 4
    discounts = np.array([transition.discount for transition in transitions]).reshape(3, steps)
    assert (discounts[:, :-2] == pytest.approx(0.81)) and (discounts[:, -2:] == 0.0).all()


def test_a_policy_is_not_evaluated_in_an_environment_that_has_changed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    run = tmp_path / "run"
    assert train(run, "--scene", SLIDER) == 0
    description = json.loads((run / "policy.json").read_text())
    description["env"]["scene"] = faulty("percent")
    (run / "policy.json").write_text(json.dumps(description))
    for words in (["--out", str(tmp_path / "test")], ["--out", str(tmp_path / "film"), "--video", "true"]):
        assert cli.main(["evaluate", "--run", str(run), *words]) == 2
    told = capsys.readouterr().err
    assert told.count("has changed since the policy was trained in it: it has observations of (2,)") == 2


def test_an_evaluation_goes_on_after_success_where_the_trainings_did(tmp_path: Path) -> None:
    ends: dict[str, Any] = {}
    for to_end in ("true", "false"):
        run, test = tmp_path / to_end, tmp_path / f"{to_end}-test"
        words = ("--evaluation_to_end", to_end, "--final_evaluation_episodes", "6")
        assert train(run, "--scene", faulty("success true"), "--episode_steps", "9", *words) == 0
        assert cli.main(["evaluate", "--run", str(run), "--out", str(test), "--episodes", "6", "--seed", "0"]) == 0
        last = json.loads((run / "summary.json").read_text())["evaluations"][-1]
        evaluated = json.loads((test / "summary.json").read_text())
        assert {**last, **evaluated} == last
        ends[to_end] = last
    assert ends["true"]["to_end"] is True and "to_end" not in ends["false"]
    assert {key: ends[key]["mean_return"] for key in ends} == {"true": -9.0, "false": -5.0}
