"""Agents in Gymnasium environments: from the true state, from a latent, with goals, and in a scene of one's own."""

import json
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from own_environments import (
    BLOCK,
    BREAKING_SLIDER,
    DM_CONTROL,
    LATE_SLIDER,
    NAMED_GOAL_SLIDER,
    ROOT,
    SLIDER,
    Slider,
    make_encoder,
    train,
    with_dm_control,
)

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.rl.environments.goals import GoalTask
from nerf_rl.rl.environments.make import EnvSpec, check_scene, make_env, make_goal_task
from nerf_rl.rl.environments.observed_columns import ObservedColumns
from nerf_rl.rl.environments.wrappers import with_flat_observation, with_unit_actions
from nerf_rl.rl.experience.hindsight import Hindsight
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.rollout import rollout
from nerf_rl.scenes.base import success_in
from nerf_rl.scenes.make import make_scene

pytestmark = pytest.mark.usefixtures("findable")

REACHER = "gym/Reacher-v5"
CHEETAH = "gym/HalfCheetah-v5"  # it travels, and its encoder's cameras with it


@pytest.fixture(scope="module", params=[REACHER, BLOCK, CHEETAH, pytest.param(DM_CONTROL, marks=with_dm_control)])
def encoder_of(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A scene's name and a tiny encoder of it."""
    return request.param, make_encoder(request.param, tmp_path_factory.mktemp("gym"))


@pytest.fixture(scope="module")
def slider_encoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny encoder of a scene whose goal no camera shows."""
    return make_encoder(SLIDER, tmp_path_factory.mktemp("slider"))


@pytest.fixture(scope="module")
def agent_of(encoder_of: tuple[str, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A scene's name and a tiny agent that sees it through a tiny encoder; tests leave it as it is."""
    scene, encoder = encoder_of
    run = tmp_path_factory.mktemp("gym") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "examples"))
        assert train(run, "--scene", scene, "--encoder", str(encoder), "--episode_steps", "10") == 0
    return scene, run


def test_a_latent_agent_trains_evaluates_and_is_shown(agent_of: tuple[str, Path], tmp_path: Path):
    scene, run = agent_of
    test = tmp_path / "test"
    words = ["--run", str(run), "--out", str(test), "--episodes", "2", "--video", "true", "--video_episodes", "1"]
    assert cli.main(["evaluate", *words, "--video_size", "64"]) == 0
    assert (test / "episodes.mp4").stat().st_size > 1000
    page = tmp_path / "page.html"
    assert cli.main(["report", "--agent", str(run), "--out", str(page), "--episodes", "1"]) == 0
    assert cli.main(["view", str(run), "--save", str(tmp_path / "view.html"), "--episodes", "1"]) == 0
    tells = scene == BLOCK
    for folder in (run, test):
        summary = json.loads((folder / "summary.json").read_text())
        assert ("success_rate" in summary.get("evaluations", [summary])[-1]) == tells
    assert ("95 % interval" in page.read_text()) == tells  # in words, table and caption


def test_a_latent_agent_knows_its_joints_and_nothing_else(encoder_of: tuple[str, Path]):
    """Where the target or the block is has to come through the cameras."""
    scene, encoder = encoder_of
    env, made = make_env(EnvSpec(scene, str(encoder), 1, 20))
    assert made is not None
    forbidden = ("target", "block", "goal")
    assert made.proprio_names and not [n for n in made.proprio_names if any(word in n for word in forbidden)]
    observation, _ = env.reset(seed=0)
    joints = made.data.qpos[: (len(made.proprio_names)) // 2]
    np.testing.assert_allclose(observation[8 : 8 + len(joints)], joints, rtol=1e-5)
    env.close()


def test_a_video_is_of_the_scene_and_not_of_a_table_elsewhere(agent_of: tuple[str, Path]):
    scene, run = agent_of
    episode = rollout(run, view_size=64)
    assert (episode.success is None) == (scene != BLOCK)
    made = make_scene(scene)
    made.env.reset(seed=0)
    middle = episode.view[0][16:48, 16:48].reshape(-1, 3)
    assert middle.std(0).max() > 10  # the arm, not an empty floor
    assert (episode.view[0] != episode.view[-1]).any()


def test_the_examples_block_begins_anywhere_before_the_arm_and_on_no_other():
    """A hand that is held still, as a blind agent's, is above the block in few episodes."""
    env = gymnasium.make("reach_block:ReachBlock-v0")
    data: Any = env.unwrapped.data
    places = []
    for seed in [*range(100), 0]:
        env.reset(seed=seed)
        red, *others = (data.body(f"{colour}_block").xpos.copy() for colour in ("red", "green", "blue"))
        assert min(np.linalg.norm(red[:2] - other[:2]) for other in others) >= 0.08
        places.append(red)
    np.testing.assert_array_equal(places[-1], places[0])
    ways = np.array(places)[:, None, :2] - np.array(places)[None, :, :2]
    assert (np.linalg.norm(ways, axis=-1) < 0.05).mean(0).max() < 0.2
    env.close()


def test_the_examples_episodes_are_broken_off_when_a_block_leaves_the_table():
    env, scene = make_env(EnvSpec(BLOCK, None, 1, 60))
    assert scene is not None
    env.reset(seed=0)
    rest = np.zeros(env.action_space.shape or (), np.float32)
    assert env.step(rest)[2:4] == (False, False)
    scene.data.joint(scene.model.body("green_block").jntadr[0]).qpos[:3] = [1.0, 1.0, -0.2]
    assert env.step(rest)[2:4] == (False, True)  # truncated: nothing was decided
    env.close()


def test_actions_are_scaled_to_the_environments_own():
    env, scene = make_env(EnvSpec("gym/Pusher-v5", None, 1, 20))
    assert scene is not None and scene.env.action_space.high.max() == 2.0
    assert env.action_space.low.min() == -1.0 and env.action_space.high.max() == 1.0
    env.reset(seed=0)
    env.step(np.full(7, 0.5, np.float32))
    np.testing.assert_allclose(scene.data.ctrl, 1.0)
    env.close()


def test_what_cannot_be_acted_in_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    assert train(tmp_path / "run", "--scene", "datasets/scenes/blocks.xml") == 2
    assert "an MJCF file has no reward" in capsys.readouterr().err
    assert train(tmp_path / "run", "--scene", "gym/Reacher-v9") == 2
    assert train(tmp_path / "run", "--scene", REACHER, "--replay.hindsight", "4") == 2
    assert "--replay.hindsight needs a scene with a goal" in capsys.readouterr().err
    assert "_workspace" not in vars(make_scene(REACHER))  # nothing is acted before cameras ask for it
    assert not (tmp_path / "run").exists()
    env = gymnasium.Env()
    env.action_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,))
    with pytest.raises(UserError, match="actions of Env have no limits"):
        with_unit_actions(env)
    for space in (gymnasium.spaces.Box(-2, 2, (1,), np.int32), gymnasium.spaces.Box(0, np.eye(2, dtype=np.float32)[0])):
        env.action_space = space
        with pytest.raises(UserError, match="actions of Env must be floating-point numbers, each with a low below its"):
            with_unit_actions(env)
    env.action_space = gymnasium.spaces.Discrete(3)
    with pytest.raises(UserError, match="actions of Env are no vectors of numbers"):
        with_unit_actions(env)
    env.observation_space = gymnasium.spaces.Graph(gymnasium.spaces.Discrete(3), None)
    with pytest.raises(UserError, match="observations of Env are no vectors of numbers"):
        with_flat_observation(env)


@pytest.mark.parametrize("command", ["gen-dataset", "train-rl"])
def test_what_goes_wrong_in_an_environment_is_told_with_its_place(
    command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    words = ["--scene", BREAKING_SLIDER]
    if command == "train-rl":
        assert train(tmp_path / "run", *words) == 1
    else:
        words += ["--episodes", "9", "--episode_steps", "10", "--frames_per_episode", "2", "--workers", "1"]
        assert cli.main([command, "--out", str(tmp_path / "data"), "--size", "16", *words]) == 1
    _, _, told = capsys.readouterr().err.rpartition(f"nerf-rl {command}: ")
    place = r"ArithmeticError in \S*own_environments.py, line \d+: the physics is invalid"
    assert re.fullmatch(f"{BREAKING_SLIDER} cannot step: {place}", told.strip())


def test_dictionaries_without_goals_become_vectors():
    env = Slider()
    env.observation_space = gymnasium.spaces.Dict(
        {"a": gymnasium.spaces.Box(-1, 1, (2, 2)), "b": gymnasium.spaces.Box(-1, 1, (3,))}
    )
    assert with_flat_observation(env).observation_space.shape == (7,)


def test_goals_that_are_dictionaries_become_part_of_the_vector(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    env, scene = make_env(EnvSpec(NAMED_GOAL_SLIDER, None, 1, 20))
    assert scene is not None
    observation, _ = env.reset(seed=1)
    goal = scene.env.unwrapped.goal  # type: ignore[attr-defined]
    np.testing.assert_allclose(observation, [0.0, goal[0], 0.0, 0.0], atol=1e-6)  # achieved, desired, observation
    env.close()
    with pytest.raises(UserError, match="unknown column of the true state to observe 'desired_goal'"):
        ObservedColumns(scene, ["desired_goal"])
    assert train(tmp_path / "run", "--scene", NAMED_GOAL_SLIDER, "--replay.hindsight", "4") == 2
    assert "--replay.hindsight needs a scene with a goal" in capsys.readouterr().err
    assert train(tmp_path / "run", "--scene", NAMED_GOAL_SLIDER) == 0


def test_success_is_read_under_the_names_that_packages_give_it_and_absent_without():
    for name in ("is_success", "success", "succeed", "solved"):
        assert success_in({name: np.float32(1.0)}) is True
    assert success_in({"success": 0.0, "other": 1}) is False
    assert success_in({"reward_dist": 1.0}) is None


def test_success_may_be_told_at_the_end_of_an_episode_alone(tmp_path: Path):
    assert train(tmp_path / "run", "--scene", LATE_SLIDER) == 0
    words = ["--run", str(tmp_path / "run"), "--out", str(tmp_path / "test"), "--episodes", "5"]
    assert cli.main(["evaluate", *words]) == 0
    assert json.loads((tmp_path / "test" / "summary.json").read_text())["success_rate"] == 1.0
    episode = rollout(tmp_path / "run", view_size=64)
    assert episode.success is not None and episode.success.tolist() == [False] * (len(episode.actions) - 1) + [True]
    assert len(episode.actions) > 1 and episode.outcome() == f"success at step {len(episode.actions)}"


def test_goals_are_exchanged_as_the_environment_would():
    """The reward and the observation of another goal equal those of an environment whose goal that is."""
    task = make_goal_task(EnvSpec(SLIDER, None, 1, 20))
    assert isinstance(task, GoalTask)
    env, scene = make_env(EnvSpec(SLIDER, None, 1, 20))
    assert scene is not None
    observation, _ = env.reset(seed=1)
    np.testing.assert_allclose(task.achieved(observation), scene.data.qpos, atol=1e-6)
    other: Any = scene.env.unwrapped
    for goal in ([0.0], [0.2]):
        other.goal = np.array(goal)
        for _ in range(3):
            wanted, reward, terminated, _, _ = env.step(np.array([0.4], np.float32))
            relived = task.with_goal(observation, np.array(goal))
            assert relived[-1] == np.float32(goal[0]) and (relived[:-1] == observation[:-1]).all()
            rewards, ends = task.outcome(task.achieved(wanted)[None], np.array([goal]))
            assert (rewards[0], ends[0]) == (reward, terminated)
            observation = wanted
    env.close()


def test_goals_that_a_latent_agent_observes_by_name_are_exchanged_and_nothing_else(slider_encoder: Path):
    spec = EnvSpec(SLIDER, str(slider_encoder), 1, 20, observe=("cart_x", "desired_goal", "achieved_goal"))
    beside = check_scene(spec)
    task = make_goal_task(spec, beside)
    assert isinstance(task, GoalTask)
    env, scene = make_env(spec)
    assert scene is not None
    other: Any = scene.env.unwrapped
    observation, _ = env.reset(seed=1)
    place = len(observation) - len(beside) + beside.index("desired_goal_0")
    assert observation[place] == np.float32(other.goal[0])
    for goal in ([0.0], [0.2]):
        relived = task.with_goal(observation, np.array(goal))
        assert relived[place] == np.float32(goal[0]) and (relived != observation).sum() == 1
        other.goal = np.array(goal)
        observation, reward, terminated, _, info = env.step(np.array([0.4], np.float32))
        assert info["achieved_goal"].tolist() == scene.data.qpos.tolist()
        rewards, ends = task.outcome(info["achieved_goal"][None], np.array([goal]))
        assert (rewards[0], ends[0]) == (reward, terminated)
    env.close()


def test_hindsight_learns_from_latents_where_the_goal_is_observed_by_name(
    slider_encoder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    achieved, relived, push = [], [], Hindsight.push

    def watched(self: Hindsight, *step: Any) -> list[Transition]:
        achieved.append(step[-1].item())
        transitions = push(self, *step)
        relived.extend(float(transition.observation[-1]) for transition in transitions)
        return transitions

    monkeypatch.setattr(Hindsight, "push", watched)
    words = ["--scene", SLIDER, "--encoder", str(slider_encoder), "--replay.hindsight", "4"]
    assert train(tmp_path / "run", *words, "--observe", "[desired_goal]") == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["updates"] > 0 and "success_rate" in summary["evaluations"][-1]
    assert len(relived) >= 4 * 20 and set(relived) <= set(np.float32(achieved).tolist())


def test_hindsight_from_latents_that_cannot_be_is_refused(
    slider_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["--scene", SLIDER, "--encoder", str(slider_encoder), "--replay.hindsight", "4"]
    assert train(tmp_path / "run", *words) == 2
    assert 'an agent with an --encoder observes by --observe "[desired_goal]" alone' in capsys.readouterr().err
    words += ["--observe", "[desired_goal]", "--replay.hindsight_random", "0.5"]
    assert train(tmp_path / "run", *words) == 2
    assert "--replay.hindsight_random 0.5 draws goals from what was observed at any time" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_hindsight_learns_a_sparse_goal_environment(tmp_path: Path):
    assert train(tmp_path / "run", "--scene", SLIDER, "--replay.hindsight", "4") == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["updates"] > 0 and 0.0 <= summary["evaluations"][-1]["success_rate"] <= 1.0


def test_goal_environments_of_gymnasium_robotics_train_with_hindsight(tmp_path: Path):
    pytest.importorskip("gymnasium_robotics")
    scene = "gym/gymnasium_robotics:FetchReach-v4"
    assert train(tmp_path / "run", "--scene", scene, "--replay.hindsight", "4") == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["updates"] > 0 and "success_rate" in summary["evaluations"][-1]
