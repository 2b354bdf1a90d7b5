"""The best episodes so far, from which a share of each batch is drawn."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.errors import MissingFileError
from nerf_rl.rl.config import ReplayConfig
from nerf_rl.rl.experience.good_episodes import GoodEpisodes
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.replay import Replay


def episodes(good: GoodEpisodes, scores: list[float], rows: int = 5, oldest: int = 0) -> None:
    """Write episodes of two environments that run side by side, a row of each in turn."""
    for first in range(0, len(scores), 2):
        begun = first * rows
        for env in range(2):
            good.add(torch.arange(begun + env, begun + 2 * rows, 2), scores[first + env], oldest)


def test_rows_of_the_best_tenth_are_drawn_and_no_others() -> None:
    good = GoodEpisodes(0.1)
    scores = [float(i) for i in range(20)]
    scores[7] = 100.0
    episodes(good, scores)
    drawn = set(good.draw(500, torch.Generator().manual_seed(0)).tolist())
    of_the_seventh = {30 + 2 * i + 1 for i in range(5)}
    of_the_last = {90 + 2 * i + 1 for i in range(5)}
    assert drawn == of_the_seventh | of_the_last


def test_few_episodes_have_no_best() -> None:
    good = GoodEpisodes(0.1)
    episodes(good, [1.0] * 8)
    assert len(good) == 0
    episodes(good, [1.0] * 2)
    assert len(good) == 5


def test_an_episode_that_memory_has_overwritten_is_forgotten() -> None:
    good = GoodEpisodes(0.1)
    episodes(good, [9.0, *[1.0] * 11], oldest=0)
    assert 0 in good.draw(100, torch.Generator()).tolist()
    good.add(torch.zeros(0, dtype=torch.int64), 0.0, oldest=1)
    assert 0 not in good.draw(100, torch.Generator()).tolist()


def memory(folder: Path, share: float) -> Replay:
    return Replay(ReplayConfig(capacity=1000, good_share=share), 3, 2, 40, folder, envs=1)


def write(replay: Replay, count: int = 12) -> None:
    for episode in range(count):
        row = [Transition(np.full(3, episode, np.float32), np.zeros(2, np.float32), 0.0, 0.9, np.zeros(3, np.float32))]
        replay.add(row * 10, 0)
        replay.end_episode(0, float(episode))


def test_a_share_of_each_batch_is_of_the_best_episodes_with_the_mean_weight(tmp_path: Path) -> None:
    replay = memory(tmp_path / "replay", 0.25)
    write(replay)
    replay.update_priority(torch.arange(60), torch.full((60,), 50.0))
    batch = replay.sample(1.0)
    assert len(batch.indices) == 40 and (batch.observation[30:, 0] == 11).all()
    assert batch.weight[30:].unique().numel() == 1
    assert float(batch.weight[-1]) == pytest.approx(float(batch.weight[:30].mean()))
    replay.close()


def test_good_episodes_come_back_with_a_checkpoint(tmp_path: Path) -> None:
    replay, again = memory(tmp_path / "replay", 0.25), memory(tmp_path / "again", 0.25)
    write(replay)
    state = {name: tensor.clone() for name, tensor in replay.state().items()}
    again.load_state(state)
    assert torch.equal(replay.sample(0.5).indices, again.sample(0.5).indices)
    for name, value in (("good.rows", state["good.rows"] + 10**6), ("good.length", state["good.length"][:-1])):
        third = memory(tmp_path / "third", 0.25)
        with pytest.raises(MissingFileError, match="good episodes"):
            third.load_state(state | {name: value})
    with pytest.raises(MissingFileError):
        memory(tmp_path / "third", 0.25).load_state({k: v for k, v in state.items() if k != "good.score"})
    replay.close()
    again.close()
