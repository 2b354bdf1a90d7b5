"""Scenes: Meta-World's tasks with seeds that work and first observations that are true."""

from typing import Any

import numpy as np
import pytest
from metaworld.env_dict import ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE

from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.errors import UserError
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.make import make_scene

LEAKY = (  # whose own resets let something of the episode before through
    *("box-close-v3", "dial-turn-v3", "disassemble-v3", "door-lock-v3", "door-unlock-v3", "handle-press-side-v3"),
    *("handle-press-v3", "handle-pull-side-v3", "handle-pull-v3", "peg-unplug-side-v3", "window-close-v3"),
    "window-open-v3",
)
TASKS = ("drawer-open-v3", "door-open-v3", "button-press-topdown-v3", "pick-place-v3", "peg-insert-side-v3")


def episode(scene: Scene, seed: int, steps: int = 20) -> list[np.ndarray]:
    """Return all that an episode of fixed actions shows: observations, rewards, positions and where bodies are."""
    rng = np.random.default_rng(0)
    observation, _ = scene.env.reset(seed=seed)
    shown = [observation, scene.model.body_pos.copy(), scene.model.body_quat.copy(), scene.model.site_pos.copy()]
    for _ in range(steps):
        observation, reward, *_ = scene.env.step(rng.uniform(-1, 1, 4).astype(np.float32))
        shown += [observation, np.array(reward), scene.data.qpos.copy(), scene.data.qvel.copy()]
    return shown


def handle(scene: Scene) -> np.ndarray:
    """Return the middle of the drawer's handle as MuJoCo has it."""
    return scene.data.body("drawer_link").xpos + np.array([0.0, -0.16, 0.0])


def test_a_seed_gives_the_same_episode_whatever_came_before(drawer_open: Scene):
    episode(drawer_open, 1, steps=35)
    np.random.seed(123)
    after_another = episode(drawer_open, 7)
    fresh = episode(make_scene("metaworld/drawer-open-v3"), 7)
    for mine, theirs in zip(after_another, fresh, strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("task", LEAKY)
def test_a_task_that_reads_positions_before_they_are_its_own_starts_as_if_it_were_the_first(task: str):
    fresh, used = make_scene(f"metaworld/{task}"), make_scene(f"metaworld/{task}")
    for seed, steps in ((1, 40), (2, 0), (3, 7)):  # the last one is broken off
        episode(used, seed, steps)
    used.model.body_pos[-1] += 0.1  # as states that are replayed do
    used.model.body_quat[-1] = (0.0, 1.0, 0.0, 0.0)
    for mine, theirs in zip(episode(used, 7), episode(fresh, 7), strict=True):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("task", ["handle-press-v3", "disassemble-v3"])
def test_frames_of_an_episode_are_the_same_whatever_came_before(task: str):
    fresh, used = make_scene(f"metaworld/{task}"), make_scene(f"metaworld/{task}")
    episode(used, 1, steps=15)
    seen = []
    for scene in (fresh, used):
        rig = make_rig(RigConfig(), 48, scene)
        renderer = MultiViewRenderer(scene.model, 48, 48, len(rig.names))
        views = []
        for steps in (0, 5):
            episode(scene, 7, steps)
            poses = rig.poses(scene.render_data(), np.random.default_rng(0))
            views.append(renderer.render(scene.render_data(), rig.intrinsics, poses))
        renderer.close()
        seen.append(views)
    for mine, theirs in zip(*seen, strict=True):
        for one, other in zip(mine, theirs, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("task", ["dial-turn-v3", "disassemble-v3", "drawer-open-v3", "handle-press-v3"])
def test_an_episode_starts_as_meta_world_starts_it_when_it_resets_twice_to_the_same_places(task: str):
    ours = make_scene(f"metaworld/{task}")
    ours.env.reset(seed=3)
    ours.env.reset(seed=11)
    mine: Any = ours.env.unwrapped
    theirs: Any = ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE[f"{task}-goal-observable"](seed=0)
    theirs._last_rand_vec, theirs._freeze_rand_vec = mine._last_rand_vec, True
    theirs.reset()
    np.testing.assert_array_equal(mine.model.body_pos, theirs.model.body_pos)
    for name in ("qpos", "qvel", "mocap_pos"):
        np.testing.assert_array_equal(getattr(mine.data, name), getattr(theirs.data, name))
    for step in range(5):
        action = np.full(4, 0.3 * (-1) ** step, np.float32)
        observation, reward, *_ = mine.step(action)
        expected, expected_reward, *_ = theirs.step(action)
        np.testing.assert_allclose(observation[:18], expected[:18], atol=1e-12)
        assert reward == pytest.approx(expected_reward, abs=1e-12)


def test_seeds_put_the_drawer_at_different_places_within_its_range(drawer_open: Scene):
    places = []
    for seed in range(20):
        drawer_open.env.reset(seed=seed)
        places.append(drawer_open.data.body("drawer").xpos[0])
    assert len(set(places)) == 20
    assert -0.1 <= min(places) < -0.05 and 0.05 < max(places) <= 0.1


def test_a_reset_without_a_seed_goes_on_to_another_episode(drawer_open: Scene):
    first, _ = drawer_open.env.reset(seed=4)
    second, _ = drawer_open.env.reset()
    assert not np.array_equal(first, second)
    drawer_open.env.reset(seed=4)
    np.testing.assert_array_equal(drawer_open.env.reset()[0], second)


def test_observations_hold_where_hand_and_handle_are_from_the_reset_on(drawer_open: Scene):
    names = drawer_open.privileged_names
    for seed in range(3):
        observation, _ = drawer_open.env.reset(seed=seed)
        for _ in range(2):  # right after the reset, and after a step
            values = dict(zip(names, drawer_open.privileged(observation), strict=True))
            found = [[values[f"{thing}_{axis}"] for axis in "xyz"] for thing in ("hand", "handle", "goal")]
            hand, seen_handle, goal = map(np.array, found)
            np.testing.assert_allclose(seen_handle, handle(drawer_open), atol=1e-9)
            np.testing.assert_allclose(hand, drawer_open.data.body("hand").xpos, atol=1e-9)
            np.testing.assert_allclose(goal[[0, 2]], handle(drawer_open)[[0, 2]], atol=0.02)
            observation = drawer_open.env.step(np.zeros(4, np.float32))[0]


def test_proprioception_is_the_hand_and_the_gripper(drawer_open: Scene):
    observation, _ = drawer_open.env.reset(seed=0)
    openings = []
    for action in (-1.0, 1.0):
        for _ in range(15):
            observation = drawer_open.env.step(np.array([0, 0, 0, action], np.float32))[0]
        proprio = dict(zip(drawer_open.proprio_names, drawer_open.proprio(observation), strict=True))
        np.testing.assert_allclose(
            [proprio[f"hand_{axis}"] for axis in "xyz"], drawer_open.data.body("hand").xpos, atol=1e-9
        )
        openings.append(proprio["gripper"])
    assert 0 <= openings[1] < openings[0] <= 1  # action 1 closes


def test_motion_is_what_proprioception_changed_by_in_the_last_step(drawer_open: Scene):
    before = drawer_open.proprio(drawer_open.env.reset(seed=0)[0])
    for action in ([1, 0, 0, 1], [0, -1, 0, -1], [0, 0, 0, 0]):
        observation = drawer_open.env.step(np.array(action, np.float32))[0]
        now = drawer_open.proprio(observation)
        assert len(drawer_open.motion(observation)) == len(drawer_open.motion_names)
        np.testing.assert_allclose(drawer_open.motion(observation), now - before, atol=1e-12)
        assert np.abs(now - before).max() > 1e-3
        before = now


def test_the_true_state_tells_how_all_has_moved_in_place_of_where_it_was(drawer_open: Scene):
    before, _ = drawer_open.env.reset(seed=0)
    for action in ([0, 1, -1, 1], [0, -1, 0, -1]):
        for _ in range(10):
            observation = drawer_open.env.step(np.array(action, np.float32))[0]
            state = drawer_open.state(observation)
            np.testing.assert_array_equal(state[:18], observation[:18])
            np.testing.assert_allclose(state[18:36], observation[:18] - before[:18], atol=1e-12)
            np.testing.assert_array_equal(state[36:], observation[36:])
            before = observation


def test_the_scripted_policy_opens_the_drawer(drawer_open: Scene):
    observation, _ = drawer_open.env.reset(seed=2)
    policy = drawer_open.scripted_policy()
    assert policy is not None
    closed, succeeded = handle(drawer_open)[1], False
    for _ in range(150):
        observation, _, _, _, info = drawer_open.env.step(policy(observation).astype(np.float32))
        succeeded |= bool(info["success"])
    assert succeeded
    assert handle(drawer_open)[1] < closed - 0.1


@pytest.mark.parametrize("task", TASKS)
def test_every_task_has_named_columns_and_a_scripted_policy(task: str):
    scene = make_scene(f"metaworld/{task}")
    observation, _ = scene.env.reset(seed=0)
    assert scene.proprio(observation).shape == (len(scene.proprio_names),)
    assert scene.privileged(observation).shape == (len(scene.privileged_names),)
    assert np.isfinite(scene.privileged(observation)).all()
    assert [scene.model.body(body).name for body in (*scene.parts.robot, *scene.parts.gripper)] == [
        "base",
        "right_hand",
    ]
    policy = scene.scripted_policy()
    assert policy is not None
    action = policy(observation)
    assert action.shape == (4,) and np.abs(action).max() <= 1
    assert scene.provenance()["name"] == f"metaworld/{task}"
    scene.env.close()


@pytest.mark.parametrize("task", ["door-open-v3", "door-close-v3", "bin-picking-v3", "button-press-v3", "soccer-v3"])
def test_a_scripted_policy_leaves_what_it_reads_as_it_is(task: str):
    scene = make_scene(f"metaworld/{task}")
    observation, _ = scene.env.reset(seed=0)
    policy = scene.scripted_policy()
    assert policy is not None
    for _ in range(40):
        before = observation.copy()
        action = policy(observation)
        np.testing.assert_array_equal(observation, before)
        observation, *_ = scene.env.step(action.astype(np.float32))


def test_an_unknown_task_is_answered_with_close_ones():
    with pytest.raises(UserError, match=r"unknown Meta-World task 'drawer-opne-v3' \(did you mean drawer-open-v3"):
        make_scene("metaworld/drawer-opne-v3")


def test_an_unknown_kind_of_scene_is_answered_with_what_there_is():
    with pytest.raises(UserError, match="unknown scene 'atari/Pong'; available: metaworld/TASK"):
        make_scene("atari/Pong")
