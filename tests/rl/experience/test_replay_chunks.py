"""Replay memory in checkpoints: rows are written once, and a checkpoint is whole whatever happens to the next one."""

import itertools
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv
from tiny_run import config, train

from nerf_rl.errors import UserError
from nerf_rl.rl.config import ReplayConfig
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.replay import Replay
from nerf_rl.rl.experience.replay_chunks import load_rows, most_rows, save_rows
from nerf_rl.rl.training.checkpoint import last_checkpoint, load_checkpoint, save_checkpoint
from nerf_rl.rl.training.deadlock import DeadlockMonitor
from nerf_rl.rl.training.loop import Trainer

CAPACITY = 10
FACTS = {  # of a checkpoint that has nothing but memory
    **dict.fromkeys(("env_steps", "updates", "episodes"), 0),
    "credit": 0.0,
    "episode_index": [0],
    "seconds": 0.0,
    "rng": np.random.default_rng(0).bit_generator.state,
    "evaluations": [],
    "monitor": DeadlockMonitor().state_dict(),
    "explored_from": 0,
}


class Memory:
    """A memory whose n-th row holds nothing but n, with its checkpoints."""

    def __init__(self, run: Path, capacity: int = CAPACITY):
        self.run = run
        self.replay = Replay(ReplayConfig(capacity=capacity), 3, 2, 4, run / "replay")
        self.before: Path | None = None

    def add(self, count: int) -> None:
        from_here = range(self.replay.stored, self.replay.stored + count)
        self.replay.add([Transition(np.full(3, n), np.full(2, n), n, n, np.full(3, n)) for n in from_here])

    def save(self) -> Path:
        before, state = self.before, self.replay.bookkeeping()
        self.before = save_checkpoint(
            self.run, self.replay.stored, state, FACTS, lambda folder: save_rows(self.replay, folder, before)
        )
        return self.before


def rows_of(folder: Path, capacity: int = CAPACITY) -> list[float]:
    """Return the first number of each row that a checkpoint holds, oldest first, having seen that all are the same."""
    stored = int(load_checkpoint(folder)[0]["stored"])
    rows = load_rows(folder, max(0, stored - capacity), stored)
    assert (rows == rows[:, :1]).all()
    return rows[:, 0].tolist()


@pytest.mark.parametrize("steps", [[3, 4, 2], [3, 4, 5, 6], [10, 10, 10], [25, 1, 9, 14], [7] * 9, [1] * 25])
def test_each_checkpoint_holds_what_memory_held_then(tmp_path: Path, steps: list[int]) -> None:
    memory, stored = Memory(tmp_path), 0
    for count in steps:
        for _ in range(count):
            memory.add(1)
        stored += count
        folder = memory.save()
        assert rows_of(folder) == list(range(max(0, stored - CAPACITY), stored))


def test_a_row_is_written_once_and_goes_when_it_is_no_longer_needed(tmp_path: Path) -> None:
    memory, inodes = Memory(tmp_path), {}
    for _ in range(12):
        for _ in range(4):
            memory.add(1)
        files = {path.name: path.stat() for path in memory.save().glob("rows-*")}
        new = set(files) - set(inodes)
        assert len(new) == 1
        assert all(files[name].st_ino == inode for name, inode in inodes.items() if name in files)
        assert len(files) <= 4  # ten rows in files of four
        inodes = {name: file.st_ino for name, file in files.items()}
    assert [folder.name for folder in (tmp_path / "checkpoints").iterdir()] == ["00000048"]


def test_checkpoints_never_hold_more_rows_than_the_disk_was_asked_for(tmp_path: Path) -> None:
    for capacity, between in itertools.product((5, 10), (1, 3, 7, 12)):
        run = tmp_path / f"{capacity}-{between}"
        run.mkdir()
        memory, most = Memory(run, capacity), 0
        for _ in range(9):
            kept = {path.name for path in (run / "checkpoints").rglob("rows-*")}
            for _ in range(between):
                memory.add(1)
            kept |= {path.name for path in memory.save().glob("rows-*")}
            spans = [name.removesuffix(".safetensors").split("-")[1:] for name in kept]
            most = max(most, sum(int(end) - int(first) for first, end in spans))
        assert min(capacity, 9 * between) <= most <= most_rows(capacity, between, 9 * between)


def test_wherever_a_checkpoint_breaks_off_the_one_before_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every operation that changes the disk is refused once, and memory has overwritten rows meanwhile."""
    calls = {(os, "replace"), (os, "link"), (os, "fsync"), (os, "open"), (shutil, "rmtree"), (Path, "mkdir")}
    for broken in itertools.count():
        run = tmp_path / str(broken)
        run.mkdir()
        memory = Memory(run)
        for count in (7, 6):
            for _ in range(count):
                memory.add(1)
            memory.save()
        for _ in range(8):
            memory.add(1)
        left = iter(range(broken))

        with monkeypatch.context() as patches:
            for owner, name in calls:
                original = getattr(owner, name)

                def refuse(*arguments: Any, _original: Any = original, _left: Any = left, **keys: Any) -> Any:
                    if next(_left, None) is None:
                        raise InterruptedError("killed here")
                    return _original(*arguments, **keys)

                patches.setattr(owner, name, refuse)
            try:
                memory.save()
                whole = True
            except InterruptedError:
                whole = False
        folder = last_checkpoint(run)
        assert folder is not None
        expected = {"00000013": list(range(3, 13)), "00000021": list(range(11, 21))}
        assert rows_of(folder) == expected[folder.name]
        if whole:
            assert folder.name == "00000021" and broken > 8
            return
        survivor = Memory(run)  # goes on from what is left
        stored = int(load_checkpoint(folder)[0]["stored"])
        state = load_checkpoint(folder)[0] | {"rows": load_rows(folder, stored - CAPACITY, stored)}
        survivor.replay.load_state(state)
        survivor.before = folder
        survivor.add(1)
        assert rows_of(survivor.save()) == list(range(stored + 1 - CAPACITY, stored + 1))


def test_file_systems_without_hard_links_get_copies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise OSError("not supported")

    monkeypatch.setattr(os, "link", refuse)
    memory = Memory(tmp_path)
    for _ in range(3):
        memory.add(4)
        folder = memory.save()
    assert rows_of(folder) == list(range(2, 12))


def test_a_checkpoint_without_its_rows_is_refused_in_a_sentence(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    for _ in range(2):
        memory.add(4)
        folder = memory.save()
    next(folder.glob("rows-*-*04.safetensors")).unlink()
    with pytest.raises(UserError, match=r"00000008 lacks rows 0 to 7 of replay memory; train again with --overwrite"):
        load_rows(folder, 0, 8)


@pytest.mark.parametrize("capacity", [60, 90])
def test_a_run_whose_memory_has_wrapped_around_resumes_bit_for_bit(
    envs: AsyncVectorEnv, tmp_path: Path, capacity: int
) -> None:
    def prepared(**keys: Any) -> Trainer:
        changed = config(tmp_path, **keys)
        changed.replay.capacity = capacity
        return Trainer(changed, envs, tmp_path)

    def finish(trainer: Trainer) -> dict[str, torch.Tensor]:
        train(trainer, 540)
        state = trainer.replay.state() | trainer.agent.actor.state_dict() | trainer.agent.target_critic.state_dict()
        trainer.replay.close()
        return state

    uninterrupted = prepared()
    for until in (148, 248, 348):
        train(uninterrupted, until)
        uninterrupted.save()
    wanted = finish(uninterrupted)
    resumed = prepared(resume=True)
    assert resumed.env_steps == 348 and resumed.replay.stored > capacity
    found = finish(resumed)
    assert all(torch.equal(found[name], wanted[name]) for name in wanted)


def test_room_for_checkpoints_is_asked_for_before_training(
    envs: AsyncVectorEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = 4 * (2 + 1 + 2 + 2)  # bytes of observation, action, reward, discount and next observation
    memory = row * config(tmp_path).replay.capacity
    for free, enough in ((1.1 * memory, False), (2.5 * memory, True)):
        monkeypatch.setattr(shutil, "disk_usage", lambda _, free=free: type("Usage", (), {"free": free}))
        if enough:
            Trainer(config(tmp_path), envs, tmp_path).replay.close()
            continue
        with pytest.raises(UserError, match=r"needs .* GB of disk, its checkpoints included"):
            Trainer(config(tmp_path), envs, tmp_path)
    assert not (tmp_path / "checkpoints").exists()
