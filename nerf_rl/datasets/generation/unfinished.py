"""What a generation writes beside its shards, and what of an earlier one it may go on with.

A whole dataset's record lies in its folder. That of a part, one of N jobs that may share the folder, lies in
``parts/I-of-N`` below it, so that jobs write no file in common.
"""

from pathlib import Path

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.shard_episodes import shard_count, shard_frames
from nerf_rl.datasets.storage.output_record import DatasetRecord
from nerf_rl.datasets.storage.plan import PLAN, plan_of
from nerf_rl.datasets.storage.shards import PARTS
from nerf_rl.errors import OutputExistsError
from nerf_rl.files.outputs import require_outside


class OutputRecord(DatasetRecord):
    """The record of one run of ``gen-dataset``.

    Args:
        config: of the run.
    """

    def __init__(self, config: GenDatasetConfig):
        dataset, (part, parts) = Path(config.out), config.share()
        self._is_part, self._states = bool(config.shard), config.behaviour.states
        if self._states:
            self._another = f"another configuration, or with other states in {self._states}"
        shards = range(part - 1, shard_count(config), parts)
        super().__init__(
            dataset,
            "gen-dataset",
            config,
            plan_of(config),
            {shard: shard_frames(config, shard) for shard in shards},
            dataset / PARTS / f"{part}-of-{parts}" if config.shard else None,
            sorted(dataset.glob(f"{PARTS}/*/{PLAN}")) if config.shard else (),
        )

    def check(self) -> None:
        """Refuse a folder in use, unless a run with the same plan is to go on, or parts of it are to be joined.

        Raises:
            UserError: a folder in use, one begun with another configuration, or one that holds the states to replay.
        """
        if self._states:
            require_outside(self.dataset, self._states)
        if self._is_part:
            in_use = self.dataset.exists() and (not self.dataset.is_dir() or any(self.dataset.iterdir()))
            if in_use and not (self.dataset / PARTS).is_dir():
                raise OutputExistsError(self.dataset, "it holds no parts that this one could join; use another --out")
        super().check()
