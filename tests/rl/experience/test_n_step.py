"""n-step transitions against sums written out by brute force."""

import numpy as np
import pytest

from nerf_rl.rl.experience.n_step import NStep

GAMMA = 0.9


def run(length: int, n: int, terminated: bool) -> list:
    """Push an episode whose observation, action and reward at step t are t, 10 t and t + 1."""
    n_step, transitions = NStep(n, GAMMA), []
    for t in range(length):
        last = t == length - 1
        step = (np.array([float(t)]), np.array([10.0 * t]), t + 1.0, np.array([t + 1.0]))
        transitions += n_step.push(*step, last and terminated, last and not terminated)
    return transitions


@pytest.mark.parametrize("n", [1, 3, 5, 20])
@pytest.mark.parametrize("terminated", [True, False])
def test_every_step_starts_one_transition_with_the_discounted_sum_of_what_follows(n: int, terminated: bool) -> None:
    length = 12
    transitions = run(length, n, terminated)
    assert len(transitions) == length
    for t, transition in enumerate(transitions):
        end = min(t + n, length)
        assert transition.observation == t
        assert transition.action == 10 * t
        assert transition.reward == pytest.approx(sum(GAMMA ** (k - t) * (k + 1) for k in range(t, end)))
        assert transition.next_observation == end
        assert transition.discount == pytest.approx(0.0 if terminated and end == length else GAMMA ** (end - t))


def test_truncation_bootstraps_where_termination_does_not() -> None:
    assert [t.discount for t in run(4, 3, terminated=True)] == pytest.approx([GAMMA**3, 0.0, 0.0, 0.0])
    assert [t.discount for t in run(4, 3, terminated=False)] == pytest.approx([GAMMA**3, GAMMA**3, GAMMA**2, GAMMA])


def test_values_of_a_constant_reward_agree_for_every_n() -> None:
    """With V = r / (1 - gamma) each transition's target r_sum + discount V is V itself, however long it is."""
    value = 1.0 / (1.0 - GAMMA)
    n_step = NStep(4, GAMMA)
    zero = np.zeros(1)
    pushed = [n_step.push(zero, zero, 1.0, zero, False, t == 9) for t in range(10)]
    targets = [t.reward + t.discount * value for transitions in pushed for t in transitions]
    assert targets == pytest.approx([value] * 10)


def test_nothing_leaks_from_one_episode_into_the_next() -> None:
    n_step = NStep(3, GAMMA)
    n_step.push(np.array([0.0]), np.zeros(1), 100.0, np.array([1.0]), True, False)
    n_step.push(np.array([5.0]), np.zeros(1), 1.0, np.array([6.0]), False, False)
    (transition,) = n_step.cut()
    assert (transition.observation, transition.reward, transition.discount) == (5.0, 1.0, GAMMA)
    assert n_step.cut() == []
