"""How batches reach the training loop: an epoch of steps, prepared while the device works."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import lightning
import numpy as np
from torch.utils.data import DataLoader, Dataset

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.machine.cores import usable_cores
from nerf_rl.pretrain.config import FIELD, PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.data.view_batches import ViewBatches
from nerf_rl.pretrain.data.worker_batches import Batch, WorkerBatches
from nerf_rl.pretrain.model.encoder_rig import EncoderRig

_AHEAD = 2  # batches that are prepared before they are asked for
_WORKERS_OF_A_GPU = 4  # a batch takes longer to prepare than a step on a GPU takes
NO_FRAME = -1


class EpochSteps:
    """The numbers of the steps that are left of the current epoch; an epoch is what lies between two checkpoints.

    It is found by the number of steps: Lightning, when resumed, begins with the number of the epoch that ended.

    Args:
        steps: of the run.
        steps_per_epoch: of an epoch.
        done: tells how many steps are done.
    """

    def __init__(self, steps: int, steps_per_epoch: int, done: Callable[[], int]):
        self._steps, self._steps_per_epoch, self._done = steps, steps_per_epoch, done

    def __iter__(self) -> Iterator[int]:
        return iter(self._left())

    def __len__(self) -> int:
        return len(self._left())

    def _left(self) -> range:
        done = self._done()
        return range(done, min((done // self._steps_per_epoch + 1) * self._steps_per_epoch, self._steps))


class BatchesAhead:
    """Iterates over batches; a thread prepares the next ones while one is in use.

    Args:
        batches: by step.
        steps: to iterate over.
    """

    def __init__(self, batches: Dataset, steps: EpochSteps):
        self._batches, self._steps = batches, steps

    def __iter__(self) -> Iterator[Batch]:
        with ThreadPoolExecutor(1, "batches") as thread:
            waiting: deque[Future[Batch]] = deque()
            for step in self._steps:
                waiting.append(thread.submit(self._batches.__getitem__, step))
                if len(waiting) > _AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()

    def __len__(self) -> int:
        return len(self._steps)


class MultiViewDataModule(lightning.LightningDataModule):
    """Batches of an epoch for training, and whole held-out frames for validation.

    Args:
        dataset: to train on.
        config: of the run.
        rank, ranks: of the processes that share each step, which one this is and how many there are.
        on_gpu: whether it trains on one.
    """

    def __init__(
        self, dataset: MultiViewDataset, config: PretrainConfig, rank: int = 0, ranks: int = 1, on_gpu: bool = False
    ):
        super().__init__()
        self._dataset, self._config, self._rank, self._ranks = dataset, config, rank, ranks
        self._on_gpu = on_gpu
        usual = min(_WORKERS_OF_A_GPU, usable_cores()) if on_gpu else 0
        self._workers = usual if config.loader_workers is None else config.loader_workers
        self.statistics = measure(dataset, config)
        self.rig = EncoderRig.of_dataset(dataset)
        self._train: Iterable[Batch] | None = None

    def train_dataloader(self) -> Iterable[Batch]:
        """Return the batches of the current epoch, in this process's share; it is one object for all epochs.

        Its worker processes, if there are any, thereby live as long as the run.
        """
        if self._train is None:
            scenes = self._config.scenes_per_step // self._ranks
            share = slice(self._rank * scenes, (self._rank + 1) * scenes)
            kind = RayBatches if self._config.objective == FIELD else ViewBatches
            batches = kind(self._dataset, self._config, self.statistics, share)
            steps = EpochSteps(self._config.steps, self._config.steps_per_epoch, self._steps_done)
            self._train = (
                WorkerBatches(batches, steps, self._workers, self._on_gpu)
                if self._workers
                else BatchesAhead(batches, steps)
            )
        return self._train

    def val_dataloader(self) -> DataLoader:
        """Return this process's share of the held-out frames, which are spread evenly over the held-out episodes.

        All shares are of one length, since the processes wait for each other; what is missing is ``NO_FRAME``.
        """
        frames = self._dataset.split("validation")
        chosen = frames[
            np.linspace(0, len(frames) - 1, min(self._config.validation_frames, len(frames))).astype(int)
        ].tolist()
        chosen += [NO_FRAME] * (-len(chosen) % self._ranks)
        return DataLoader(chosen[self._rank :: self._ranks], batch_size=None)  # type: ignore[arg-type]

    def _steps_done(self) -> int:
        return self.trainer.global_step if self.trainer is not None else 0
