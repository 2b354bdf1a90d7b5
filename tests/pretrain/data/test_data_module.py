"""How batches reach the training loop: in order, ahead of time, by a thread or by processes that stay."""

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import Dataset

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.data_module import NO_FRAME, BatchesAhead, EpochSteps, MultiViewDataModule
from nerf_rl.pretrain.data.view_batches import ViewBatch
from nerf_rl.pretrain.data.worker_batches import Layout, WorkerBatches


@pytest.fixture
def dataset(tiny_dataset: Path) -> MultiViewDataset:
    return MultiViewDataset(tiny_dataset)


def config(**settings: Any) -> PretrainConfig:
    return PretrainConfig("data", "out", **{"scenes_per_step": 4, "rays_per_scene": 8, **settings})


def begin(module: MultiViewDataModule, step: int) -> None:
    module.trainer = type("Trainer", (), {"global_step": step})()  # type: ignore[assignment]


def test_a_resumed_epoch_has_the_steps_that_are_left_of_it():
    done = [0]
    steps = EpochSteps(10, 4, lambda: done[0])
    for done[0], left in ((0, [0, 1, 2, 3]), (4, [4, 5, 6, 7]), (6, [6, 7]), (8, [8, 9]), (10, [])):
        assert list(steps) == left and len(steps) == len(left)


class Recorded(Dataset):
    """Batches that tell when they are prepared."""

    def __init__(self) -> None:
        self.prepared = [threading.Event() for _ in range(6)]

    def __getitem__(self, step: int) -> int:
        self.prepared[step].set()
        return step


def test_the_next_batches_are_prepared_while_one_is_in_use():
    batches = Recorded()
    ahead = iter(BatchesAhead(batches, EpochSteps(6, 6, lambda: 0)))
    assert next(ahead) == 0
    assert batches.prepared[1].wait(10) and batches.prepared[2].wait(10)  # though nobody has asked for them
    assert not batches.prepared[3].wait(0.05)  # nor does it run away
    assert list(ahead) == [1, 2, 3, 4, 5]


def test_what_goes_wrong_in_a_batch_is_raised_where_it_is_used():
    class Broken(Dataset):
        def __getitem__(self, step: int) -> int:
            raise OSError("the disk is gone")

    with pytest.raises(OSError, match="the disk is gone"):
        list(BatchesAhead(Broken(), EpochSteps(2, 2, lambda: 0)))


def test_processes_prepare_the_same_batches_as_a_thread_and_stay_for_the_next_epoch(dataset: MultiViewDataset):
    settings = {"steps": 5, "steps_per_epoch": 3}
    thread = MultiViewDataModule(dataset, config(**settings))
    processes = MultiViewDataModule(dataset, config(**settings, loader_workers=1))
    assert processes.train_dataloader() is processes.train_dataloader()
    workers = set()
    for first in (0, 3):
        for module in (thread, processes):
            begin(module, first)
        loader: Any = processes.train_dataloader()
        for mine, theirs in zip(thread.train_dataloader(), loader, strict=True):
            assert all(torch.equal(a, b) for a, b in zip(mine, theirs, strict=True))
            workers |= {worker.pid for worker in loader.loader._iterator._workers}
    assert len(workers) == 1
    loader.loader._iterator._shutdown_workers()


@pytest.mark.parametrize("views", [1, 3])
def test_batches_of_any_shape_lie_in_one_memory_and_in_the_slots_of_processes(views: int):
    batch = ViewBatch(
        torch.randint(0, 255, (3, views, 5, 7, 3), dtype=torch.uint8),
        torch.rand(3, views, 3, 4),
        torch.rand(3, views, 5, 7),
        torch.rand(3, 5),
        torch.rand(3, 0, 3),
        torch.ones(3, 0, dtype=torch.bool),
        torch.rand(3, views, 0, 0, 0),
    )
    layout = Layout.of(batch)
    for memory in torch.zeros(3, layout.bytes, dtype=torch.uint8):
        for target, array in zip(layout.view(memory), batch, strict=True):
            target.copy_(array)
        assert all(torch.equal(mine, theirs) for mine, theirs in zip(layout.view(memory), batch, strict=True))


@pytest.mark.parametrize("objective", ["autoencoder", "anchors"])
def test_processes_prepare_whole_views_too(dataset: MultiViewDataset, objective: str):
    expected = MultiViewDataModule(dataset, config(objective=objective, steps=2))
    processes = MultiViewDataModule(dataset, config(objective=objective, steps=2, loader_workers=1))
    for module in (expected, processes):
        begin(module, 0)
    for mine, theirs in zip(expected.train_dataloader(), processes.train_dataloader(), strict=True):
        assert all(torch.equal(a, b) for a, b in zip(mine, theirs, strict=True))
    processes.train_dataloader().loader._iterator._shutdown_workers()  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("on_gpu", "asked", "processors", "workers"),
    [(False, None, 16, 0), (True, None, 16, 4), (True, None, 2, 2), (False, 3, 2, 3), (True, 0, 16, 0)],
)
@pytest.mark.filterwarnings("ignore:This DataLoader will create")  # more processes than processors, as asked
def test_a_gpu_has_processes_that_prepare_its_batches(
    dataset: MultiViewDataset,
    on_gpu: bool,
    asked: int | None,
    processors: int,
    workers: int,
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(processors)))
    made = MultiViewDataModule(dataset, config(loader_workers=asked), on_gpu=on_gpu).train_dataloader()
    assert isinstance(made, WorkerBatches if workers else BatchesAhead)
    if isinstance(made, WorkerBatches):
        assert (made.loader.num_workers, made._pinned) == (workers, on_gpu)


@pytest.mark.parametrize("ranks", [2, 4])
def test_shares_of_a_batch_make_up_the_batch(dataset: MultiViewDataset, ranks: int):
    whole = RayBatches(dataset, config(), MultiViewDataModule(dataset, config()).statistics)[3]
    parts = []
    for rank in range(ranks):
        module = MultiViewDataModule(dataset, config(steps=9), rank, ranks)
        begin(module, 3)
        parts.append(next(iter(module.train_dataloader())))
    for name, expected in whole._asdict().items():
        assert torch.equal(torch.cat([getattr(part, name) for part in parts]), expected), name


@pytest.mark.parametrize("ranks", [1, 2, 5])
def test_shares_of_validation_are_equally_long_and_hold_each_frame_once(dataset: MultiViewDataset, ranks: int):
    shares = [
        [int(frame) for frame in MultiViewDataModule(dataset, config(), rank, ranks).val_dataloader()]
        for rank in range(ranks)
    ]
    assert len({len(share) for share in shares}) == 1
    frames = [frame for share in shares for frame in share if frame != NO_FRAME]
    assert sorted(frames) == dataset.split("validation").tolist()


@pytest.mark.benchmark
@pytest.mark.parametrize("workers", [0, 1, 2])
def test_a_step_of_20_ms_does_not_wait_for_its_batch(tiny_dataset: Path, workers: int):
    """As large batches as the demo's; the median wait is at most 2 ms."""
    module = MultiViewDataModule(MultiViewDataset(tiny_dataset), PretrainConfig("data", "out", loader_workers=workers))
    begin(module, 0)
    waits, batches = [], iter(module.train_dataloader())
    for _ in range(100):
        start = time.perf_counter()
        next(batches)
        waits.append(time.perf_counter() - start)
        time.sleep(0.02)
    assert np.median(waits[10:]) < 0.002
