"""Starts that failed come back once, with noise of their own; episodes end after successes that are not news."""

import dataclasses
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv
from tiny_run import config, train

from nerf_rl.rl.training.curriculum import Curriculum
from nerf_rl.rl.training.episodes import training_seed
from nerf_rl.rl.training.loop import Trainer


def curriculum(share: float = 0.999, count: int = 1, steps: int | None = None) -> Curriculum:
    return Curriculum(7, count, share, steps, np.random.default_rng(0))


def new(env: int, index: int) -> int:
    return training_seed(7, env, index)


def test_a_start_that_failed_is_tried_once_more_and_then_new_ones_follow() -> None:
    made = curriculum()
    made.begin(0)
    made.end(0, True)
    failed = made.begin(0)
    made.end(0, False)
    assert failed == new(0, 1) and not made.retried[0]
    assert made.begin(0) == failed and made.retried[0]
    made.end(0, False)
    assert made.begin(0) == new(0, 2) and not made.retried[0]


def test_the_oldest_failure_comes_first_to_whichever_environment_is_free() -> None:
    made = curriculum(count=2)
    for env in (0, 1):
        made.begin(env)
        made.end(env, True)
    failed = [made.begin(env) for env in (1, 0)]
    for env in (1, 0):
        made.end(env, False)
    assert [made.begin(env) for env in (0, 1)] == failed and made.retried.all()


@pytest.mark.parametrize("told", [False, None], ids=["nothing has succeeded", "success is not told"])
def test_nothing_is_tried_again_as_long_as(told: bool | None) -> None:
    made = curriculum()
    for index in range(5):
        assert made.begin(0) == new(0, index)
        made.end(0, told)


def test_without_a_share_nothing_is_tried_again() -> None:
    made = curriculum(share=0.0)
    for index, success in enumerate([True, False, False, False]):
        assert made.begin(0) == new(0, index)
        made.end(0, success)


def test_half_of_the_episodes_may_be_retries() -> None:
    made = curriculum(share=0.5)
    made.begin(0)
    made.end(0, True)
    retried = []
    for _ in range(2000):
        made.begin(0)
        retried.append(bool(made.retried[0]))
        made.end(0, False)
    assert 0.42 < np.mean(retried) <= 0.5, "now and then there is nothing left to try"


def test_what_is_broken_off_is_left_to_try_and_a_copy_goes_on_alike() -> None:
    made = curriculum()
    made.begin(0)
    made.end(0, True)
    failed = made.begin(0)
    made.end(0, False)
    assert made.begin(0) == failed
    made.break_off(0)
    copy = curriculum()
    copy.load_state_dict(made.state_dict())
    assert not copy.retried[0]
    for each in (made, copy):
        assert each.begin(0) == failed and each.retried[0]
        each.end(0, True)
        assert each.begin(0) == new(0, 2)


def test_a_checkpoint_of_before_there_were_retries_has_nothing_to_try() -> None:
    made = curriculum()
    made.load_state_dict({"episode_index": [4]})
    assert made.begin(0) == new(0, 4) and not made.retried[0]


def test_an_episode_ends_after_its_success_once_half_of_the_latest_have_succeeded() -> None:
    made, yes, no = curriculum(share=0.0, count=2, steps=4), np.array([True, False]), np.zeros(2, bool)
    two = np.array([2, 2])

    def steps_until_the_end() -> int | None:
        made.begin(0)
        assert not made.step(no, two).any(), "the steps with the success in them do not count"
        ends = [made.step(yes, two).tolist() for _ in range(5)]
        return 2 * (ends.index([True, False]) + 1) if [True, False] in ends else None

    for index in range(40):
        assert steps_until_the_end() == (4 if index >= 30 else None)
        made.end(0, index >= 20)
    copy = curriculum(share=0.0, count=2, steps=4)
    copy.load_state_dict(made.state_dict())
    made = copy
    assert steps_until_the_end() == 4


def test_retries_do_not_tell_how_many_succeed_at_new_places() -> None:
    made = curriculum()
    for success in [True] * 10 + [False]:
        made.begin(0)
        made.end(0, success)
    made.begin(0)
    assert made.retried[0]
    before = made.state_dict()
    made.end(0, True)
    assert made.state_dict() == before


def test_whole_episodes_are_acted_unless_an_end_is_asked_for() -> None:
    made = curriculum()
    for _ in range(40):
        made.begin(0)
        made.end(0, True)
    made.begin(0)
    assert not any(made.step(np.ones(1, bool), np.array([1])).any() for _ in range(1000))


def trained(trainer: Trainer, until: int) -> np.ndarray:
    train(trainer, until)
    return trainer.replay.rows(0, trainer.replay.stored)


@pytest.mark.parametrize("noise", ["first", "drawn"])
def test_a_run_tries_again_where_it_failed_and_resumes_to_the_same_episodes(
    envs: AsyncVectorEnv,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    noise: Literal["first", "drawn"],
) -> None:
    begun: list[tuple[int, bool]] = []
    begin = Curriculum.begin

    def noted(self: Curriculum, env: int, successes: int = 0) -> int:
        seed = begin(self, env, successes)
        begun.append((seed, bool(self.retried[env])))
        return seed

    monkeypatch.setattr(Curriculum, "begin", noted)
    (tmp_path / "whole").mkdir()
    plain = config(tmp_path / "whole", retry_share=0.5)
    keys = dataclasses.replace(plain, noise=dataclasses.replace(plain.noise, retries=noise, epsilon_z_retries=0.3))
    whole = Trainer(keys, envs, tmp_path / "whole")
    trained(whole, 240)
    whole.save()
    rows = trained(whole, 480)
    whole.replay.close()
    retries = [(i, seed) for i, (seed, retried) in enumerate(begun) if retried]
    assert len(retries) >= 3
    assert all(seed in [earlier for earlier, _ in begun[:i]] for i, seed in retries)
    first = len(begun)
    resumed = Trainer(dataclasses.replace(keys, resume=True), envs, tmp_path / "whole")
    again = trained(resumed, 480)
    resumed.replay.close()
    later = begun[first:]
    assert later == begun[first - len(later) : first]
    assert np.array_equal(rows, again)
