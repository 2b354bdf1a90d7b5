"""From actions in [-1, 1] to what an environment takes."""

import numpy as np
import pytest
from gymnasium.spaces import Box

from nerf_rl.scenes.unit_actions import in_range


@pytest.mark.parametrize(
    "low, high, ends",
    [
        (-1.0, 1.0, (-1.0, 1.0)),
        (-100.0, 50.0, (-100.0, 50.0)),
        (2.0, 5.0, (2.0, 5.0)),
        (-np.inf, np.inf, (-1.0, 1.0)),
        (-0.4, np.inf, (-0.4, 1.6)),
        (3.0, np.inf, (3.0, 5.0)),
        (-np.inf, 0.5, (-1.5, 0.5)),
        (-np.inf, -4.0, (-6.0, -4.0)),
    ],
)
def test_minus_one_and_one_are_the_limits_and_what_stands_for_them(low: float, high: float, ends: tuple[float, float]):
    space = Box(low, high, (2,))
    taken = [in_range(np.full(2, end, np.float32), space) for end in (-1.0, 1.0)]
    np.testing.assert_allclose(taken, np.transpose([ends, ends]), rtol=1e-6)
    assert all(action.dtype == np.float32 for action in taken)


def test_each_component_has_its_own_limits_and_zero_is_in_their_middle():
    space = Box(np.array([-2.0, 0.0], np.float32), np.array([2.0, 10.0], np.float32))
    np.testing.assert_allclose(in_range(np.zeros(2, np.float32), space), [0.0, 5.0])


def test_between_minus_one_and_one_nothing_is_rounded():
    action = np.random.default_rng(0).uniform(-1.0, 1.0, 1000).astype(np.float32)
    assert in_range(action, Box(-1.0, 1.0, (1000,))) is action


def test_there_may_be_no_actuator():
    assert in_range(np.zeros(0, np.float32), Box(-1.0, 1.0, (0,))).shape == (0,)
