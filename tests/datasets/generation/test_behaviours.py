"""How episodes are acted, on a toy scene that remembers every action."""

import dataclasses

import gymnasium
import numpy as np
import pytest

from nerf_rl.cameras.rig_config import CameraConfig
from nerf_rl.datasets.config import BehaviourConfig
from nerf_rl.datasets.generation.behaviours import Behaviour, EpisodeStep
from nerf_rl.errors import UserError
from nerf_rl.scenes.base import Policy, Scene
from nerf_rl.scenes.workspace import Workspace

RANDOM, SCRIPTED, NOISY = (BehaviourConfig(*weights, noise=0.3) for weights in np.eye(3).tolist())


class ToyEnv(gymnasium.Env):
    """Observes [the seed, the step]; the reward is the step; step 5 alone is a success."""

    action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,))

    def __init__(self, ends_after: int | None = None):
        self.ends_after = ends_after
        self.actions: list[np.ndarray] = []

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        self.seed, self.steps, self.actions = float(seed or 0), 0, []
        return np.array([self.seed, 0.0]), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        self.steps += 1
        self.actions.append(action)
        observation = np.array([self.seed, self.steps], float)
        return observation, float(self.steps), self.steps == self.ends_after, False, {"success": self.steps == 5}


class ToyScene(Scene):
    """A toy whose scripted policy acts by the step."""

    name = "toy"
    proprio_names = privileged_names = ("step",)

    def __init__(self, ends_after: int | None = None):
        self.env = ToyEnv(ends_after)

    def proprio(self, observation: np.ndarray) -> np.ndarray:
        return observation[1:]

    privileged = proprio

    def workspace(self) -> Workspace:
        return Workspace(np.zeros(3), 1.0)

    def default_cameras(self) -> list[CameraConfig]:
        return [CameraConfig("a")]

    def observation(self) -> np.ndarray:
        return np.zeros(2)

    def scripted_policy(self) -> Policy:
        return lambda observation: np.array([0.9, -0.5, 0.01 * observation[1]])


class Unscripted(ToyScene):
    def scripted_policy(self) -> None:
        return None


def act(behaviour: BehaviourConfig, steps: int = 40, seed: int = 0) -> list[EpisodeStep]:
    return list(Behaviour(ToyScene(), behaviour, steps).act(0, np.random.default_rng(seed)))


@pytest.mark.parametrize("behaviour", [RANDOM, SCRIPTED, NOISY])
def test_an_episode_has_a_moment_for_the_reset_and_for_each_step(behaviour: BehaviourConfig):
    moments = act(behaviour)
    assert [moment.step for moment in moments] == list(range(41))
    assert [moment.observation[1] for moment in moments] == list(range(41))
    assert [moment.reward for moment in moments] == [0.0, *range(1, 41)]
    assert [moment.success for moment in moments] == [step >= 5 for step in range(41)]


@pytest.mark.parametrize("behaviour", [RANDOM, SCRIPTED, NOISY])
def test_the_action_of_a_moment_is_the_one_taken_next_and_lies_in_the_box(behaviour: BehaviourConfig):
    scene = ToyScene()
    moments = list(Behaviour(scene, behaviour, 40).act(0, np.random.default_rng(1)))
    assert isinstance(scene.env, ToyEnv)
    np.testing.assert_array_equal([moment.action for moment in moments[:-1]], scene.env.actions)
    assert all(scene.env.action_space.contains(moment.action) for moment in moments)


def test_the_scene_is_in_the_state_of_the_moment_that_is_held():
    scene = ToyScene()
    assert isinstance(scene.env, ToyEnv)
    for moment in Behaviour(scene, SCRIPTED, 6).act(0, np.random.default_rng(0)):
        assert scene.env.steps == moment.step


def test_scripted_episodes_follow_the_policy_exactly():
    policy = ToyScene().scripted_policy()
    for moment in act(SCRIPTED):
        np.testing.assert_allclose(moment.action, policy(moment.observation), rtol=1e-6)


@pytest.mark.parametrize("longest", [14, 40])
def test_random_actions_are_held_for_a_few_steps_and_differ_afterwards(longest: int):
    held = dataclasses.replace(RANDOM, longest_hold=longest)
    actions = np.stack([moment.action for moment in act(held, 3000)])
    changes = np.flatnonzero((actions[1:] != actions[:-1]).any(1)) + 1
    lengths = np.diff([0, *changes])
    assert 3 <= lengths.min() <= 4 and longest - 2 <= lengths.max() <= longest
    assert lengths.mean() == pytest.approx((3 + longest) / 2, rel=0.2)
    drawn = actions[changes]
    assert drawn.min() < -0.8 and drawn.max() > 0.8 and np.abs(drawn.mean(0)).max() < 0.3


def test_noisy_episodes_follow_the_policy_with_noise_and_make_detours():
    policy = ToyScene().scripted_policy()
    moments = [moment for seed in range(20) for moment in act(NOISY, 100, seed)]
    actions = np.stack([moment.action for moment in moments])
    noise = actions[:, 1] + 0.5  # the second action is far from the limits
    held = np.concatenate([[False], (actions[1:] == actions[:-1]).all(1)])
    assert policy(moments[0].observation)[1] == -0.5
    assert 0.05 < held.mean() < 0.4
    free = ~held & ~np.roll(held, -1)
    assert noise[free].std() == pytest.approx(0.3, abs=0.05) and abs(noise[free].mean()) < 0.05


def test_detours_of_noisy_episodes_stay_short_however_long_random_actions_are_held():
    longer = dataclasses.replace(NOISY, longest_hold=90)
    for mine, theirs in zip(act(longer, 200, 7), act(NOISY, 200, 7), strict=True):
        np.testing.assert_array_equal(mine.action, theirs.action)


def test_each_episode_draws_one_behaviour_by_weight():
    mixture = BehaviourConfig(random=1.0, scripted=3.0, noisy=0.0)
    scripted = [act(mixture, 4, seed)[0].action[0] == np.float32(0.9) for seed in range(400)]
    assert np.mean(scripted) == pytest.approx(0.75, abs=0.07)


def test_an_episode_is_decided_by_its_random_stream():
    mixture = BehaviourConfig()
    for mine, theirs in zip(act(mixture, seed=3), act(mixture, seed=3), strict=True):
        np.testing.assert_array_equal(mine.action, theirs.action)
        np.testing.assert_array_equal(mine.observation, theirs.observation)
    assert act(mixture, seed=3)[0].observation[0] != act(mixture, seed=4)[0].observation[0]


@pytest.mark.parametrize("behaviour", [RANDOM, SCRIPTED, NOISY])
def test_an_episode_that_ends_early_shows_its_end_and_is_followed_by_another(behaviour: BehaviourConfig):
    scene = ToyScene(ends_after=5)
    moments = list(Behaviour(scene, behaviour, 10).act(0, np.random.default_rng(0)))
    assert [moment.step for moment in moments] == [*range(6), *range(5)]
    assert [moment.observation[1] for moment in moments] == [moment.step for moment in moments]
    assert [moment.reward for moment in moments] == [moment.step for moment in moments]
    assert [moment.success for moment in moments] == [moment.step == 5 for moment in moments]
    assert moments[5].observation[0] != moments[6].observation[0]  # with a seed of its own


@pytest.mark.parametrize("low, high", [(-1.0, 1.0), (-100.0, 50.0), (2.0, 5.0)])
def test_actions_are_stored_between_minus_one_and_one_and_cover_what_the_environment_takes(low: float, high: float):
    scene = ToyScene()
    scene.env.action_space = gymnasium.spaces.Box(low, high, (3,))
    assert isinstance(scene.env, ToyEnv)
    stored = np.stack([moment.action for moment in Behaviour(scene, RANDOM, 600).act(0, np.random.default_rng(0))])
    taken = np.stack(scene.env.actions)
    assert -1.0 <= stored.min() < -0.95 and 0.95 < stored.max() <= 1.0
    np.testing.assert_allclose(taken, low + (stored[:-1] + 1.0) / 2.0 * (high - low), rtol=1e-5, atol=1e-5)
    assert all(scene.env.action_space.contains(action) for action in taken)


def test_a_scripted_behaviour_needs_a_scripted_policy():
    with pytest.raises(
        UserError, match=r"toy has no scripted policy; leave out behaviour\.scripted and behaviour\.noisy"
    ):
        Behaviour(Unscripted(), SCRIPTED, 5)
    with pytest.raises(UserError, match=r"toy has no scripted policy; raise behaviour\.random above 0"):
        Behaviour(Unscripted(), BehaviourConfig(random=0.0), 5)


def test_without_a_scripted_policy_the_usual_mixture_is_random():
    scene = Unscripted()
    policy = ToyScene().scripted_policy()
    for seed in range(20):
        moments = list(Behaviour(scene, BehaviourConfig(), 4).act(0, np.random.default_rng(seed)))
        assert not np.allclose(moments[0].action, policy(moments[0].observation))


def test_discrete_actions_are_refused():
    scene = ToyScene()
    scene.env.action_space = gymnasium.spaces.Discrete(3)
    with pytest.raises(UserError, match="toy has no continuous actions"):
        Behaviour(scene, RANDOM, 5)


@pytest.mark.parametrize(
    "weights, words",
    [
        ((0.0, 0.0, 0.0), "behaviour weights must not all be zero"),
        ((1.0, -0.1, 0.0), "--behaviour.scripted must be in"),
    ],
)
def test_weights_that_are_no_mixture_are_refused(weights: tuple[float, float, float], words: str):
    with pytest.raises(UserError, match=words):
        BehaviourConfig(*weights)
