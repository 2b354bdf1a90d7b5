"""Statistics of exploration noise."""

import numpy as np
import pytest

from nerf_rl.rl.config import NoiseConfig
from nerf_rl.rl.experience.noise import EpsilonZGreedy, Noise, linear_schedule, pink_noise


def samples(kind: str, theta: float = 0.15) -> np.ndarray:
    config = NoiseConfig(kind=kind, start=0.3, end=0.3, theta=theta)
    noise = Noise(config, 200, 2, 400, np.random.default_rng(0))
    return np.stack([noise.sample(0) for _ in range(400)])


@pytest.mark.parametrize("kind", ["gaussian", "ou", "pink"])
def test_both_kinds_have_the_scheduled_deviation(kind: str) -> None:
    assert samples(kind).std() == pytest.approx(0.3, rel=0.02)


def test_only_ou_is_correlated_in_time_and_by_one_minus_theta() -> None:
    def correlation(x: np.ndarray) -> float:
        return float((x[1:] * x[:-1]).mean() / (x**2).mean())

    assert correlation(samples("gaussian")) == pytest.approx(0.0, abs=0.02)
    assert correlation(samples("ou", theta=0.2)) == pytest.approx(0.8, abs=0.02)


def test_environments_and_components_are_independent() -> None:
    x = samples("ou").reshape(400, -1)[:, :6]
    assert np.abs(np.corrcoef(x.T) - np.eye(6)).max() < 0.35


def test_the_deviation_falls_linearly_and_then_stays() -> None:
    noise = Noise(NoiseConfig(start=0.5, end=0.1, decay_steps=100), 1, 1, 8, np.random.default_rng(0))
    assert [noise.scale(step) for step in (0, 50, 100, 1000)] == pytest.approx([0.5, 0.3, 0.1, 0.1])
    assert linear_schedule(1.0, 2.0, 10, -5) == 1.0


def test_reset_forgets_one_environment_only() -> None:
    noise = Noise(NoiseConfig(kind="ou", start=1.0, end=1.0, theta=1e-6), 2, 3, 8, np.random.default_rng(0))
    before = noise.sample(0)
    noise.reset(0)
    after = noise.sample(0)
    assert np.abs(after[0] - before[0]).max() > 0.1
    assert np.abs(after[1] - before[1]).max() < 0.02


@pytest.mark.parametrize("share", [0.0, 0.2, 0.7])
def test_held_actions_replace_the_given_share_and_last_the_given_time_on_average(share: float) -> None:
    held = EpsilonZGreedy(50, 16, 6, np.random.default_rng(0))
    own = np.full((50, 16), 9.0, np.float32)
    actions = np.stack([held.override(own, share) for _ in range(2000)])
    replaced = actions[..., 0] != 9.0
    assert replaced.mean() == pytest.approx(share, abs=0.03)
    if share:
        begins = replaced[1:] & (~replaced[:-1] | (actions[1:] != actions[:-1]).any(-1))
        assert replaced[1:].sum() / begins.sum() == pytest.approx(6, rel=0.05)
        assert np.all(np.abs(actions[replaced]) == 1.0)


def test_held_actions_anywhere_fill_the_box_and_every_third_is_a_rest() -> None:
    held = EpsilonZGreedy(200, 3, 1, np.random.default_rng(0), "anywhere")
    own = np.full((200, 3), 9.0, np.float32)
    actions = np.concatenate([held.override(own, 0.9) for _ in range(50)])
    actions = actions[actions[:, 0] != 9.0]
    rests = (actions == 0.0).all(1)
    assert rests.mean() == pytest.approx(1 / 3, abs=0.03)
    moves = actions[~rests]
    assert np.abs(moves).max() < 1.0 and moves.std() == pytest.approx(1 / np.sqrt(3), rel=0.03)


def test_a_hold_ends_with_its_episode() -> None:
    held = EpsilonZGreedy(2, 1, 10**6, np.random.default_rng(0))
    own = np.full((2, 1), 9.0, np.float32)
    while (held.override(own, 0.999999) == 9.0).any():
        pass
    held.reset(0)
    assert (held.override(own, 0.0) == 9.0).tolist() == [[True], [False]]


@pytest.mark.parametrize("length", [64, 65])
def test_the_power_of_pink_noise_falls_as_one_over_frequency(length: int) -> None:
    x = pink_noise(length, 4000, np.random.default_rng(0))
    power = (np.abs(np.fft.rfft(x, axis=0)) ** 2).mean(1)[1 : length // 2]
    slope = np.polyfit(np.log(np.arange(1, len(power) + 1)), np.log(power), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.05)
    assert x.std() == pytest.approx(1.0, rel=0.02)


def test_an_episode_can_begin_with_a_hold() -> None:
    held = EpsilonZGreedy(1, 1, 5, np.random.default_rng(0))
    own = np.full((1, 1), 9.0, np.float32)
    begun = 0
    for _ in range(2000):
        held.reset(0, start_probability=0.3)
        begun += int(held.override(own, 0.0)[0, 0] != 9.0)
    assert begun / 2000 == pytest.approx(0.3, abs=0.03)
