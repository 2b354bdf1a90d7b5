"""What a learner is told of a step's reward."""

import numpy as np

from nerf_rl.rl.training.learnt_reward import learnt_reward


def test_a_step_with_a_success_is_worth_more() -> None:
    reward = np.array([1.0, 2.0])
    found = learnt_reward(reward, {"success": np.array([False, True])}, 20.0)
    assert found.tolist() == [1.0, 22.0] and reward.tolist() == [1.0, 2.0]


def test_where_the_scene_does_not_tell_rewards_stay_as_they_are() -> None:
    assert learnt_reward(np.array([1.0, 2.0]), {}, 20.0).tolist() == [1.0, 2.0]
