"""Hindsight relabelling on the task of PandaReach, against an episode that really had the other goal."""

import numpy as np
import pytest

from nerf_rl.rl.environments.goals import ACHIEVED, DESIRED, OBSERVATION, GoalLayout, GoalTask
from nerf_rl.rl.environments.panda_reach import REACHED_BELOW, ReachRules
from nerf_rl.rl.experience.hindsight import Hindsight
from nerf_rl.rl.experience.n_step import NStep, Transition

GAMMA, N = 0.9, 3
LAYOUTS = {"full": GoalLayout(10, 3, displacement=True), "paper": GoalLayout(7, 3)}


def reach_task(reward: str, kind: str = "full") -> GoalTask:
    return GoalTask(ReachRules(reward), LAYOUTS[kind])


def walk(length: int, goal: np.ndarray, kind: str = "full", stride: float = 0.04) -> list[np.ndarray]:
    """Return the observations of an end-effector that moves along x, with this goal."""
    observations = []
    for t in range(length + 1):
        position = np.array([stride * t, 0.0, 0.0])
        own = np.full(LAYOUTS[kind].observation, 0.1 * t)
        observations.append(LAYOUTS[kind].vector({OBSERVATION: own, ACHIEVED: position, DESIRED: goal}))
    return observations


def relive(task: GoalTask, observations: list[np.ndarray], **keys: object) -> list[Transition]:
    hindsight = Hindsight(task, keys.pop("copies", 1), N, GAMMA, np.random.default_rng(0), **keys)
    transitions: list[Transition] = []
    for t in range(len(observations) - 1):
        last = t == len(observations) - 2
        transitions += hindsight.push(observations[t], np.array([float(t)]), observations[t + 1], False, last)
    return transitions


def same(a: Transition, b: Transition) -> bool:
    return all(np.allclose(x, y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("kind", LAYOUTS)
@pytest.mark.parametrize("reward", ["dense", "bonus", "sparse"])
def test_relabelled_steps_are_those_of_an_episode_that_had_this_goal_from_the_start(kind: str, reward: str) -> None:
    task = reach_task(reward, kind)
    far, goal = np.array([0.0, 0.0, 5.0]), np.array([0.3, 0.0, 0.0])
    found = relive(task, walk(10, far, kind), draw_goals=lambda count: np.tile(goal, (count, 1)), random_share=1.0)
    really, n_step, wanted = walk(10, goal, kind), NStep(N, GAMMA), []
    for t in range(10):
        reward_t, reached = task.outcome(task.achieved(really[t + 1]), goal)
        wanted += n_step.push(really[t], np.array([float(t)]), float(reward_t), really[t + 1], bool(reached), t == 9)
        if reached:
            break
    assert t == 6  # 0.28 m is the first place within 5 cm of 0.3 m
    assert len(found) == 10 and len(wanted) == 7
    assert all(same(a, b) for a, b in zip(found, wanted, strict=False))


def test_future_goals_were_achieved_at_the_same_step_or_later_in_the_episode() -> None:
    task = reach_task("sparse")
    for transition in relive(task, walk(20, np.array([0.0, 0.0, 5.0])), copies=8):
        goal = task.with_goal(transition.observation, np.zeros(3))  # the place of the goal in the observation
        place = np.flatnonzero(goal != transition.observation)[0]
        steps = transition.observation[place] / 0.04
        assert steps == pytest.approx(round(steps))
        assert steps >= transition.action[0] + 1


def test_a_share_of_the_goals_comes_from_anywhere_in_training() -> None:
    task, elsewhere = reach_task("dense", "paper"), np.array([0.0, 7.0, 0.0])
    draw = {"draw_goals": lambda count: np.tile(elsewhere, (count, 1)), "random_share": 0.25}
    transitions = relive(task, walk(50, np.ones(3), "paper"), copies=40, **draw)
    drawn = [np.allclose(task.with_goal(t.observation, elsewhere), t.observation) for t in transitions]
    assert np.mean(drawn) == pytest.approx(0.25, abs=0.04)  # 2,000 draws: four standard deviations
    assert all(t.reward < -6.0 for t, far in zip(transitions, drawn, strict=True) if far)


def test_every_step_is_relabelled_as_often_as_asked_and_nothing_leaks_into_the_next_episode() -> None:
    task = reach_task("dense")
    hindsight = Hindsight(task, 4, N, GAMMA, np.random.default_rng(0))
    observations = walk(5, np.ones(3))
    for t in range(4):
        assert hindsight.push(observations[t], np.zeros(1), observations[t + 1], False, False) == []
    assert len(hindsight.push(observations[4], np.zeros(1), observations[5], False, True)) == 20
    assert hindsight.cut() == []


def test_a_step_to_its_own_achievement_terminates_with_the_sparse_reward() -> None:
    task = reach_task("sparse", "paper")
    (last,) = relive(task, walk(1, np.ones(3), "paper"))
    assert (last.reward, last.discount) == (1.0, 0.0)


def test_rewards_of_the_three_kinds_differ_only_by_distance_and_bonus() -> None:
    goal = np.zeros((4, 3))
    achieved = np.array([[0.0, 0, 0], [0.049, 0, 0], [0.051, 0, 0], [0.0, 0.3, 0.4]])
    outcomes = {kind: reach_task(kind).outcome(achieved, goal) for kind in ("dense", "bonus", "sparse")}
    assert outcomes["sparse"][0].tolist() == [1.0, 1.0, 0.0, 0.0]
    assert outcomes["dense"][0] == pytest.approx([0.0, -0.049, -0.051, -0.5])
    assert outcomes["bonus"][0] == pytest.approx(outcomes["dense"][0] + outcomes["sparse"][0])
    assert all((reached == [True, True, False, False]).all() for _, reached in outcomes.values())
    assert REACHED_BELOW == 0.05
