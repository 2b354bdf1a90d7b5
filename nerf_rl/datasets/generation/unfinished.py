"""What a generation writes beside its shards, and what of an earlier one it may go on with.

A whole dataset's record lies in its folder. That of a part, one of N jobs that may share the folder, lies in
``parts/I-of-N`` below it, so that jobs write no file in common.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.generation.manifest import finished_shard
from nerf_rl.datasets.generation.shard_episodes import RenderedShard, shard_count
from nerf_rl.datasets.storage.plan import PLAN, begun_plan, plan_of
from nerf_rl.datasets.storage.shards import MANIFEST, PARTS, SHARDS, partial_files, shard_file, shard_path
from nerf_rl.errors import OutputExistsError, UserError
from nerf_rl.files.checksummed_json import is_whole
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, write_provenance


class OutputRecord:
    """The record of one run of ``gen-dataset``.

    Args:
        config: of the run.

    Attributes:
        plan: of the dataset, as it was begun with.
    """

    def __init__(self, config: GenDatasetConfig):
        self._config, self.dataset = config, Path(config.out)
        part, parts = config.share()
        self.folder = self.dataset / PARTS / f"{part}-of-{parts}" if config.shard else self.dataset
        self.manifest = self.folder / MANIFEST
        self.shards = range(part - 1, shard_count(config), parts)
        begun = begun_plan(self._plans(), plan_of(config))
        self._is_other, self.plan = begun is None, begun or plan_of(config)

    def check(self) -> None:
        """Refuse a folder in use, unless an interrupted run with the same plan is to go on, before anything slow.

        Raises:
            UserError: a folder in use, or one begun with another configuration.
        """
        config, begun = self._config, self._begun()
        if config.shard:
            in_use = self.dataset.exists() and (not self.dataset.is_dir() or any(self.dataset.iterdir()))
            if in_use and not (self.dataset / PARTS).is_dir():
                raise OutputExistsError(self.dataset, "it holds no parts that this one could join; use another --out")
        check_output(self.folder, config.overwrite, config.resume, begun)
        if self._is_other:
            raise UserError(
                f"{self.dataset} was begun with another configuration; use the same one, or --overwrite true"
            )

    def finished_shards(self, scene: Mapping[str, Any]) -> dict[int, RenderedShard]:
        """Return the shards that an interrupted run left whole, by number; none unless it is to be resumed.

        A shard that is not what an earlier manifest says is not among them, so that no damage is signed anew; nor is
        one made from another version of the scene.

        Args:
            scene: the scene's provenance.
        """
        if not self._config.resume:
            return {}
        signed = is_whole(self.manifest) and read_json(self.manifest)["shards"]
        recorded = {entry["file"]: entry["sha256"] for entry in signed or []}
        found = {}
        for number in self.shards:
            shard = finished_shard(self.dataset, self._config, number, scene, self.plan)
            if shard is not None and recorded.get(shard_file(number), shard.sha256) == shard.sha256:
                found[number] = shard
        return found

    def is_complete(self) -> bool:
        """Tell whether the record is that of a finished run."""
        return is_whole(self.manifest) and (self.folder / SUMMARY).is_file()

    def prepare(self, finished: Collection[int]) -> None:
        """Create the output folder, or keep that of an interrupted run.

        Args:
            finished: the shards to keep; others are removed, then the manifest, which comes last.
        """
        config = self._config
        self.dataset.mkdir(parents=True, exist_ok=True)
        prepare_output(self.folder, config.overwrite, config.resume, self._begun())
        write_json(self.folder / PLAN, self.plan)
        write_provenance(self.folder, "gen-dataset", config)
        (self.dataset / SHARDS).mkdir(exist_ok=True)
        lost = [shard_path(self.dataset, shard) for shard in self.shards if shard not in finished]
        for path in [*partial_files(self.dataset, self.shards), *lost, self.manifest, self.dataset / MANIFEST]:
            path.unlink(missing_ok=True)

    def _plans(self) -> list[Path]:
        """Return where the plan of a dataset that this run goes on with, or joins, may be written down."""
        plans = [self.folder / PLAN] if self._config.resume else []
        return plans + (sorted(self.dataset.glob(f"{PARTS}/*/{PLAN}")) if self._config.shard else [])

    def _begun(self) -> bool:
        """Tell whether an earlier run was cut off here, be it before it had written its plan."""
        return (self.folder / PLAN).is_file() or (
            self.folder.is_dir() and all(path.name.startswith(".partial-") for path in self.folder.iterdir())
        )
