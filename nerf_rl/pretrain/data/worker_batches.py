"""Batches that processes prepare, handed over in memory that is shared once and for all.

PyTorch's loader hands over each array of each batch by a file descriptor, for which two processes shake hands while
both compute. With one such a batch, a run on an H100 took 17 ms a step; with none, 11.
"""

import math
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, get_worker_info

from nerf_rl.pretrain.data.batches import RayBatch
from nerf_rl.pretrain.data.view_batches import ViewBatch

Batch = RayBatch | ViewBatch
_AHEAD = 2  # batches that a process prepares before they are asked for
_SLOTS = _AHEAD + 1  # of a process: it gets the step for a used one only after the batch there was copied
_ALIGNMENT = 16  # of each array's beginning, and so of each slot's [bytes]


class Layout(NamedTuple):
    """How the arrays of a batch lie in one run of bytes; those of all steps lie alike."""

    kind: Callable[..., Batch]
    parts: list[tuple[int, int, torch.dtype, torch.Size]]
    """first byte, number of bytes, dtype and shape of each array"""
    bytes: int

    @classmethod
    def of(cls, batch: Batch) -> "Layout":
        """Return how to lay out batches like this one."""
        parts, end = [], 0
        for array in batch:
            parts.append((end, array.nbytes, array.dtype, array.shape))
            end += math.ceil(array.nbytes / _ALIGNMENT) * _ALIGNMENT
        return cls(type(batch), parts, end)

    def view(self, memory: Tensor) -> Batch:
        """Return the batch that lies in a memory."""
        return self.kind(
            *(memory[start : start + count].view(dtype).view(shape) for start, count, dtype, shape in self.parts)
        )


class BatchesToSlots(Dataset):
    """Maps a step's number to the slot that its batch is in; each process writes to its own ones by turns.

    Args:
        batches: by step.
        workers: number of processes.
    """

    def __init__(self, batches: Dataset, workers: int):
        self._batches, self._written = batches, 0
        self.layout = Layout.of(batches[0])
        self.slots = torch.empty(workers * _SLOTS, self.layout.bytes, dtype=torch.uint8).share_memory_()

    def __getitem__(self, step: int) -> int:
        worker = get_worker_info()
        assert worker is not None, "only a loader's processes write to slots"
        slot = worker.id * _SLOTS + self._written % _SLOTS
        for target, array in zip(self.layout.view(self.slots[slot]), self._batches[step], strict=True):
            target.copy_(array)
        self._written += 1
        return slot


class WorkerBatches:
    """Iterates over batches that processes prepare; a thread takes them over while one is in use.

    The processes live as long as this.

    Args:
        batches: by step.
        steps: to iterate over.
        workers: number of processes.
        pinned: whether batches lie where a GPU can fetch them from by itself.
    """

    def __init__(self, batches: Dataset, steps: Iterable[int], workers: int, pinned: bool):
        self._shared, self._pinned = BatchesToSlots(batches, workers), pinned
        self.loader = DataLoader(
            self._shared,
            batch_size=None,
            sampler=steps,
            num_workers=workers,
            multiprocessing_context="spawn",
            persistent_workers=True,
            prefetch_factor=_AHEAD,
            worker_init_fn=_leave_interrupts_to_parent,
        )

    def __iter__(self) -> Iterator[Batch]:
        arriving = iter(self.loader)
        with ThreadPoolExecutor(1, "batches") as thread:
            waiting = deque(thread.submit(self._taken_over, arriving) for _ in range(_AHEAD))
            while (batch := waiting.popleft().result()) is not None:
                waiting.append(thread.submit(self._taken_over, arriving))
                yield batch

    def __len__(self) -> int:
        return len(self.loader)

    def _taken_over(self, arriving: Iterator[int]) -> Batch | None:
        slot = next(arriving, None)
        if slot is None:
            return None
        own = torch.empty(self._shared.layout.bytes, dtype=torch.uint8, pin_memory=self._pinned)
        return self._shared.layout.view(own.copy_(self._shared.slots[slot]))


def _leave_interrupts_to_parent(worker: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
