"""Prioritised replay against its formulas."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.errors import UserError
from nerf_rl.rl.config import ReplayConfig
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.replay import Replay, require_room


def filled(folder: Path, count: int = 8, capacity: int = 8, batch_size: int = 4096, **keys: object) -> Replay:
    replay = Replay(ReplayConfig(capacity=capacity, **keys), 3, 2, batch_size, folder / "replay")
    replay.add([transition(i) for i in range(count)])
    return replay


def transition(i: int) -> Transition:
    return Transition(np.full(3, i), np.full(2, i + 0.25), i + 0.5, 0.9, np.full(3, i + 1))


def test_a_batch_holds_what_was_stored(tmp_path: Path) -> None:
    batch = filled(tmp_path).sample(beta=0.5)
    i = batch.indices.float()
    assert torch.equal(batch.observation, i[:, None].expand(-1, 3))
    assert torch.equal(batch.action, i[:, None].expand(-1, 2) + 0.25)
    assert torch.equal(batch.reward, i + 0.5)
    assert torch.allclose(batch.discount, torch.tensor(0.9))
    assert torch.equal(batch.next_observation, i[:, None].expand(-1, 3) + 1)


def test_draws_follow_the_priorities_and_weights_follow_the_formula(tmp_path: Path) -> None:
    alpha, beta, epsilon, count = 0.7, 0.6, 0.05, 8
    replay = filled(tmp_path, alpha=alpha, epsilon=epsilon, batch_size=100_000)
    error = torch.linspace(0.0, 3.0, count)
    replay.update_priority(torch.arange(count), -error)
    batch = replay.sample(beta)
    probability = (error + epsilon) ** alpha
    probability /= probability.sum()
    frequency = torch.bincount(batch.indices, minlength=count) / len(batch.indices)
    assert torch.allclose(frequency, probability, atol=0.006)
    weight = (count * probability) ** -beta
    assert batch.weight.shape == batch.reward.shape == (100_000,)
    assert torch.allclose(batch.weight, (weight / weight.max())[batch.indices], rtol=1e-4)


def test_weights_at_beta_1_undo_the_priorities(tmp_path: Path) -> None:
    """The weighted mean over draws is then proportional to the plain mean over memory: every item counts the same."""
    replay = filled(tmp_path, alpha=1.0, batch_size=200_000)
    replay.update_priority(torch.arange(8), torch.linspace(0.1, 2.0, 8))
    batch = replay.sample(1.0)
    share = torch.zeros(8).index_add_(0, batch.indices, batch.weight) / batch.weight.sum()
    assert torch.allclose(share, torch.full((8,), 1 / 8), atol=0.01)


def test_uniform_replay_has_unit_weights(tmp_path: Path) -> None:
    replay = filled(tmp_path, prioritised=False, batch_size=40_000)
    replay.update_priority(torch.arange(8), torch.arange(8.0))
    batch = replay.sample(0.4)
    assert torch.equal(batch.weight, torch.ones(40_000))
    assert torch.allclose(torch.bincount(batch.indices) / 40_000, torch.tensor(1 / 8), atol=0.01)


def test_a_new_transition_has_the_greatest_priority(tmp_path: Path) -> None:
    replay = filled(tmp_path, count=7, alpha=1.0, epsilon=1e-6)
    replay.update_priority(torch.arange(7), torch.full((7,), 1e-4))
    replay.update_priority(torch.tensor([3]), torch.tensor([5.0]))
    replay.add([transition(7)])
    frequency = torch.bincount(replay.sample(0.5).indices, minlength=8) / 4096
    assert frequency[3] == pytest.approx(0.5, abs=0.05)
    assert frequency[7] == pytest.approx(0.5, abs=0.05)


def test_full_memory_forgets_the_oldest(tmp_path: Path) -> None:
    replay = filled(tmp_path, count=8)
    replay.add([transition(8), transition(9)])
    assert len(replay) == 8
    assert set(replay.sample(0.5).observation[:, 0].tolist()) == set(map(float, range(2, 10)))


@pytest.mark.parametrize("prioritised", [True, False])
@pytest.mark.parametrize("count", [5, 11])
def test_a_restored_memory_draws_and_grows_like_the_original(tmp_path: Path, prioritised: bool, count: int) -> None:
    original = Replay(ReplayConfig(capacity=8, prioritised=prioritised), 3, 2, 16, tmp_path / "a", seed=3)
    for i in range(count):
        original.add([transition(i)])
    original.update_priority(torch.arange(4), torch.tensor([0.3, 2.0, 0.1, 0.7]))
    original.sample(0.5)
    copy = Replay(ReplayConfig(capacity=8, prioritised=prioritised), 3, 2, 16, tmp_path / "b", seed=4)
    copy.load_state(original.state())
    for i in range(20, 24):
        for memory in (original, copy):
            memory.add([transition(i)])
        first, second = original.sample(0.5), copy.sample(0.5)
        assert all(torch.equal(a, b) for a, b in zip(first, second, strict=True))
        assert torch.equal(original.sample_uniform().indices, copy.sample_uniform().indices)


def test_the_file_lies_in_the_given_folder_until_closed(tmp_path: Path) -> None:
    replay = filled(tmp_path)
    assert list((tmp_path / "replay").iterdir())
    replay.close()
    assert not (tmp_path / "replay").exists()


def test_a_full_disk_is_told_before_anything_is_stored(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"replay memory needs .* GB of disk, .* smaller --replay.capacity"):
        require_room(tmp_path, 100, 10, 10**15)


def test_a_memory_of_one_transition_has_a_spread_and_comes_back(tmp_path: Path) -> None:
    replay = filled(tmp_path, count=1, batch_size=2)
    assert replay.priority_spread() == pytest.approx(1.0)
    again = Replay(ReplayConfig(capacity=8), 3, 2, 2, tmp_path / "again", seed=1)
    again.load_state(replay.state())
    assert torch.equal(again.sample(0.5).observation, replay.sample(0.5).observation)


def test_an_episode_of_which_nothing_is_left_in_memory_ends_without_bounds(tmp_path: Path) -> None:
    replay = Replay(ReplayConfig(capacity=2), 3, 2, 4, tmp_path / "replay", envs=2, bounded_steps=1)
    replay.add([transition(0)], env=0)
    replay.add([transition(1), transition(2)], env=1)
    replay.end_episode(0, lambda observation: 1.0)
    assert (replay.sample(0.5).bound < -1e38).all(), "nothing is known of what another episode's steps brought"
    replay.end_episode(1, lambda observation: 1.0)
    assert (replay.sample(0.5).bound > 0).all()
