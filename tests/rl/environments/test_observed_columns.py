"""What a latent agent is let see of the true state, because its user asks for it by name."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from own_environments import BLOCK, SLIDER, make_encoder, train

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.environments.make import EnvSpec, make_env, spec_from_json
from nerf_rl.rl.environments.observed_columns import ObservedColumns
from nerf_rl.rl.rollout import rollout
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene

pytestmark = pytest.mark.usefixtures("findable")


@pytest.fixture(scope="module")
def slider_encoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a goal environment whose goal is not drawn."""
    return make_encoder(SLIDER, tmp_path_factory.mktemp("slider"))


def test_columns_are_had_one_by_one_or_as_a_group_and_once(drawer_open: Scene):
    observation, _ = drawer_open.env.reset(seed=4)
    truth = dict(zip(drawer_open.privileged_names, drawer_open.privileged(observation), strict=True))
    observed = ObservedColumns(drawer_open, ["goal", "handle_y", "goal"])
    assert observed.names == ("goal_x", "goal_y", "goal_z", "handle_y")
    np.testing.assert_array_equal(observed(observation), [truth[name] for name in observed.names])
    assert ObservedColumns(drawer_open, [])(observation).shape == (0,)


def test_columns_of_a_scene_of_ones_own_are_those_of_now():
    scene = make_scene(BLOCK)
    observed = ObservedColumns(scene, ["red_block"])
    for seed in (1, 2):
        observation, _ = scene.env.reset(seed=seed)
        np.testing.assert_allclose(observed(observation), scene.data.body("red_block").xpos, atol=1e-12)


def test_names_that_there_are_not_are_answered_with_those_that_there_are(drawer_open: Scene):
    words = "unknown column of the true state to observe 'gaol'.*did you mean goal.*available: goal, goal_x, .*hand_z"
    with pytest.raises(UserError, match=words):
        ObservedColumns(drawer_open, ["gaol"])
    with pytest.raises(UserError, match="'desired_goal'"):
        ObservedColumns(drawer_open, ["desired_goal"])  # it is no goal environment
    with pytest.raises(UserError, match="without --encoder the whole true state is observed"):
        TrainRLConfig("out", observe=["goal"])


def test_the_goal_of_a_goal_environment_stands_behind_latent_and_proprioception(slider_encoder: Path):
    env, scene = make_env(EnvSpec(SLIDER, str(slider_encoder), 1, 20, observe=("desired_goal", "achieved_goal")))
    blind, _ = make_env(EnvSpec(SLIDER, str(slider_encoder), 1, 20))
    assert scene is not None
    for seed in (1, 2):
        observation, _ = env.reset(seed=seed)
        goal = scene.env.unwrapped.goal  # type: ignore[attr-defined]
        np.testing.assert_allclose(observation[-2:], [goal[0], scene.data.qpos[0]], rtol=1e-6)
        np.testing.assert_array_equal(observation[:-2], blind.reset(seed=seed)[0])
    assert env.observation_space.shape == (8 + 2 + 2,)  # latent, the rail's position and velocity, goals
    env.close()
    blind.close()


def test_an_agent_keeps_what_it_observes_through_evaluation_video_and_report(
    slider_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    run, words = tmp_path / "run", ["--scene", SLIDER, "--encoder", str(slider_encoder)]
    assert train(run, *words, "--observe", "[gaol]") == 2
    assert "unknown column of the true state to observe 'gaol'" in capsys.readouterr().err and not run.exists()
    assert train(run, *words, "--observe", "[desired_goal]") == 0
    policy = Policy.load(run)
    assert policy.spec.observe == ("desired_goal",)
    assert policy.proprio_names == ["rail", "rail_velocity", "desired_goal_0"] and policy.observation_size == 11
    test = ["--run", str(run), "--out", str(tmp_path / "test"), "--episodes", "2", "--video", "true"]
    assert cli.main(["evaluate", *test, "--video_episodes", "1", "--video_size", "64"]) == 0
    page = ["--agent", str(run), "--out", str(tmp_path / "page.html"), "--episodes", "1"]
    assert cli.main(["report", *page]) == 0
    goals = {float(observation[-1]) for observation in rollout(run, seed=3, view_size=32).observations}
    assert len(goals) == 1 and goals != {float(observation[-1]) for observation in rollout(run, seed=4).observations}


def test_policies_that_say_nothing_of_it_observe_nothing_of_it():
    """Those of earlier versions."""
    spec = EnvSpec("gym/Reacher-v5", None, 1, 20)
    stored = json.loads(json.dumps(dataclasses.asdict(spec)))
    assert spec_from_json(stored) == spec
    assert stored.pop("observe") == []
    assert spec_from_json(stored) == spec
