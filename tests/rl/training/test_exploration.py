"""When exploration begins to become less."""

import json

import numpy as np
import pytest

from nerf_rl.rl.config import NoiseConfig, TrainRLConfig
from nerf_rl.rl.training.exploration import Exploration


def exploration(successes: int) -> Exploration:
    noise = NoiseConfig(start=1.0, end=0.0, decay_steps=1000, wait_for_successes=successes)
    return Exploration(TrainRLConfig(out="x", noise=noise), 2, 3, np.random.default_rng(0))


def test_exploration_falls_from_the_first_step_if_it_waits_for_nothing() -> None:
    made = exploration(0)
    assert made.scale(0) == 1.0 and made.scale(250) == pytest.approx(0.75)


@pytest.mark.parametrize(("between", "enough"), [(0, True), (18, True), (19, False)])
def test_one_success_may_be_luck_and_two_of_the_last_20_episodes_are_not(between: int, enough: bool) -> None:
    made = exploration(2)
    for number, success in enumerate([True, *[False] * between, True]):
        assert made.scale(100 * number) == 1.0
        made.end_episode(success, 100 * number)
    last = 100 * (between + 1)
    assert made.scale(last) == 1.0
    assert made.scale(last + 250) == pytest.approx(0.75 if enough else 1.0)
    made.end_episode(False, last + 250)
    made.end_episode(True, last + 250)
    assert made.scale(last + 500) == pytest.approx(0.5 if enough else 0.75), "what has begun goes on"


def test_what_an_echo_does_says_nothing_of_whether_exploration_may_be_over() -> None:
    noise = NoiseConfig(decay_steps=1000, wait_for_successes=2, renew_after=3)
    made = Exploration(TrainRLConfig(out="x", noise=noise), 2, 3, np.random.default_rng(0))
    for success in (True, True, False, False, True, False, False):
        made.end_episode(success, 100)
    for success in (False, False, True):
        made.end_episode(success, 1100, echoed=True)
    assert made.scale(1100) == pytest.approx(noise.end)
    made.end_episode(False, 1100)
    assert made.scale(9100) == noise.start


@pytest.mark.parametrize("kind", ["gaussian", "pink"])
def test_episodes_without_an_end_need_no_memory_without_an_end(kind: str) -> None:
    config = TrainRLConfig(out="x", episode_steps=10**9, action_repeat=1, noise=NoiseConfig(kind=kind))
    made = Exploration(config, 2, 3, np.random.default_rng(0))
    assert made._noise._pink.nbytes < 10**7
    assert np.isfinite(made.around(np.zeros((2, 3), np.float32), 0)).all()


def retry_noise(retries: str, env_step: int, again: bool) -> np.ndarray:
    """Standard deviations [50, 2] of the noise in episodes of two environments, the second of which try again."""
    noise = NoiseConfig(kind="gaussian", start=0.3, end=0.0, decay_steps=1000, retries=retries, epsilon_z=0.0)
    made = Exploration(TrainRLConfig(out="x", retry_share=0.5, noise=noise), 2, 1000, np.random.default_rng(0))
    found = []
    for _ in range(50):
        for env in range(2):
            made.begin_episode(env, env_step, again and env == 1)
            made._held.reset(env)
        found.append(made.around(np.zeros((2, 1000), np.float32), env_step).std(axis=1))
    return np.stack(found)


@pytest.mark.parametrize("retries", ["first", "drawn"])
def test_only_retries_have_noise_of_their_own(retries: str) -> None:
    sizes = retry_noise(retries, 800, again=True)
    assert sizes[:, 0] == pytest.approx(0.06, rel=0.15), "as scheduled"
    assert retry_noise(retries, 800, again=False) == pytest.approx(0.06, rel=0.15)
    if retries == "first":
        assert sizes[:, 1] == pytest.approx(0.3, rel=0.15), "as at the first step, however late"
    else:
        assert sizes[:, 1].min() == pytest.approx(0.06, rel=0.15), "never less than the others"
        assert 0.25 < sizes[:, 1].max() < 0.33 and 0.12 < np.median(sizes[:, 1]) < 0.21, "anything up to the first"


def test_where_the_scene_does_not_tell_there_is_nothing_to_wait_for() -> None:
    made = exploration(2)
    made.end_episode(None, 100)
    assert made.scale(250) == pytest.approx(0.75)


def test_exploration_that_begins_anew_waits_anew() -> None:
    made = exploration(2)
    for _ in range(2):
        made.end_episode(True, 100)
    made.begin(400)
    made.end_episode(True, 500)
    assert made.scale(900) == 1.0
    made.end_episode(True, 900)
    assert made.scale(1150) == pytest.approx(0.75)


def test_a_run_that_is_resumed_knows_of_the_successes_before() -> None:
    first, second = exploration(2), exploration(2)
    first.end_episode(True, 100)
    second.load_state_dict(json.loads(json.dumps(first.state_dict())))
    assert second.scale(200) == 1.0
    second.end_episode(True, 200)
    assert second.scale(450) == pytest.approx(0.75)
    second.load_state_dict({"explored_from": 7})
    assert second.elapsed(10) == 3, "of a version that waited for nothing"


@pytest.mark.parametrize("env_step, elsewhere", [(0, 0.5), (400, 0.3), (2000, 0.0)])
def test_retries_have_held_actions_however_late(env_step: int, elsewhere: float) -> None:
    noise = NoiseConfig(start=0.0, end=0.0, decay_steps=1000, epsilon_z=0.5, epsilon_z_start=0.0, epsilon_z_retries=0.2)
    made = Exploration(TrainRLConfig(out="x", retry_share=0.5, noise=noise), 40, 4, np.random.default_rng(0))
    for env in range(40):
        made.begin_episode(env, env_step, again=env < 20)
    own = np.full((40, 4), 0.5, np.float32)
    held = np.stack([(made.around(own, env_step) != own).any(axis=1) for _ in range(2000)]).mean(axis=0)
    assert held[20:].mean() == pytest.approx(elsewhere, abs=0.03)
    assert held[:20].mean() == pytest.approx(max(elsewhere, 0.2), abs=0.03)
    for env in range(40):
        made.begin_episode(env, 2000)
    assert np.array_equal(made.around(own, 2000), own), "what is no retry has none of it"


@pytest.mark.parametrize("renew_after, anew", [(0, False), (5, True), (6, False)])
def test_exploration_begins_anew_after_so_many_failures_in_a_row(renew_after: int, anew: bool) -> None:
    noise = NoiseConfig(start=1.0, end=0.0, decay_steps=1000, wait_for_successes=1, renew_after=renew_after)
    made = Exploration(TrainRLConfig(out="x", noise=noise), 2, 3, np.random.default_rng(0))
    for success in [*[False] * 9, True, *[False] * 4, True, *[False] * 4]:
        made.end_episode(success, 100)
    assert made.scale(600) == pytest.approx(0.5), "failures before the first success, and fewer in a row, do not count"
    resumed = Exploration(TrainRLConfig(out="x", noise=noise), 2, 3, np.random.default_rng(0))
    resumed.load_state_dict(json.loads(json.dumps(made.state_dict())))
    for each in (made, resumed):
        each.end_episode(False, 600)
        assert each.scale(5000) == (1.0 if anew else 0.0), "it waits for a success again"
        each.end_episode(True, 5000)
        assert each.scale(5500) == (pytest.approx(0.5) if anew else 0.0)


def test_what_does_not_tell_of_success_does_not_fail() -> None:
    noise = NoiseConfig(start=1.0, end=0.0, decay_steps=1000, wait_for_successes=1, renew_after=2)
    made = Exploration(TrainRLConfig(out="x", noise=noise), 2, 3, np.random.default_rng(0))
    for _ in range(9):
        made.end_episode(None, 0)
    assert made.scale(1000) == 0.0
