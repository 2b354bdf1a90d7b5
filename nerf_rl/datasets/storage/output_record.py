"""What a dataset's maker writes beside its shards, and what of an earlier run it may go on with."""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from nerf_rl.datasets.storage.disk import bytes_needed
from nerf_rl.datasets.storage.finished_shards import FinishedShard, finished_shard
from nerf_rl.datasets.storage.plan import PLAN, Plan, begun_plan, different_keys
from nerf_rl.datasets.storage.shards import (
    MANIFEST,
    SHARDS,
    UNFINISHED,
    Layout,
    partial_files,
    shard_file,
    shard_path,
)
from nerf_rl.errors import UserError
from nerf_rl.files.checksummed_json import is_whole, write_checksummed
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, require_place, write_provenance


@runtime_checkable
class RunKeys(Protocol):
    """The keys of a command that decide what happens to an output folder in use."""

    resume: bool
    overwrite: bool


class DatasetRecord:
    """The record of one run of a command that makes a dataset.

    Args:
        dataset: folder of the dataset.
        command: the sub-command's name.
        config: its configuration, a dataclass.
        plan: what decides the content, as it would be begun now.
        frames: how many frames each shard of this run has, by its number.
        folder: where the record lies; in the dataset's folder if it is None.
        plans: where else the plan of this dataset may be written down.

    Attributes:
        plan: of the dataset, as it was begun with.
        shards: numbers of those that this run makes.
    """

    _another = "another configuration"  # with which it was begun, as a refusal says

    def __init__(
        self,
        dataset: Path,
        command: str,
        config: RunKeys,
        plan: Plan,
        frames: Mapping[int, int],
        folder: Path | None = None,
        plans: Iterable[Path] = (),
    ):
        self.dataset, self.folder = dataset, dataset if folder is None else folder
        self.manifest = self.folder / MANIFEST
        self.frames, self.shards = frames, list(frames)
        self._command, self._config = command, config
        written = [*([self.folder / PLAN] if config.resume else []), *plans]
        begun = begun_plan(written, plan)
        self._other, self.plan = different_keys(written, plan) if begun is None else None, begun or plan

    def check(self) -> None:
        """Refuse a folder in use, unless an interrupted run with the same plan is to go on, before anything slow.

        Raises:
            UserError: a folder in use, or one begun with another configuration, or a place where no folder can be.
        """
        require_place(self.dataset)
        check_output(self.folder, self._config.overwrite, self._config.resume, self._begun())
        if self._other is not None:
            what = f"{self._another} (what differs: {', '.join(self._other)})" if self._other else self._another
            raise UserError(f"{self.dataset} was begun with {what}; use the same one, or --overwrite true")

    def finished_shards(self, scene: Mapping[str, Any]) -> dict[int, FinishedShard]:
        """Return the shards that an interrupted run left whole, by number; none unless it is to be resumed.

        A shard that is not what an earlier manifest says is not among them, so that no damage is signed anew.

        Args:
            scene: the scene's provenance.

        Raises:
            UserError: one is of another version of the scene.
        """
        if not self._config.resume:
            return {}
        signed = is_whole(self.manifest) and read_json(self.manifest)["shards"]
        recorded = {entry["file"]: entry["sha256"] for entry in signed or []}
        found = {}
        for number, frames in self.frames.items():
            shard = finished_shard(self.dataset, number, frames, scene, self.plan)
            if shard is not None and recorded.get(shard_file(number), shard.sha256) == shard.sha256:
                found[number] = shard
        return found

    def is_complete(self, finished: Collection[int]) -> bool:
        """Tell whether, with these shards, nothing is left to do; if so, say it."""
        complete = len(finished) == len(self.frames) and is_whole(self.manifest) and (self.folder / SUMMARY).is_file()
        if complete:
            print(f"{self.dataset}: nothing to do, all {len(finished)} shards are there")
        return complete

    def bytes_missing(self, finished: Collection[int], layout: Layout) -> int:
        """Return what the shards beside these will take on disk."""
        missing = [frames for shard, frames in self.frames.items() if shard not in finished]
        return bytes_needed(layout, sum(missing), len(missing))

    def begin(self, finished: Collection[int], description: Mapping[str, Any]) -> None:
        """Create the output folder, or keep that of an interrupted run.

        Args:
            finished: the shards to keep; others are removed, then the manifest, which comes last.
            description: what the manifest will say but of the shards.
        """
        config = self._config
        self.dataset.mkdir(parents=True, exist_ok=True)
        prepare_output(self.folder, config.overwrite, config.resume, self._begun())
        write_json(self.folder / PLAN, self.plan)
        write_provenance(self.folder, self._command, config)
        (self.dataset / SHARDS).mkdir(exist_ok=True)
        lost = [shard_path(self.dataset, shard) for shard in self.shards if shard not in finished]
        for path in [*partial_files(self.dataset, self.shards), *lost, self.manifest, self.dataset / MANIFEST]:
            path.unlink(missing_ok=True)
        write_checksummed(self.folder / UNFINISHED, description)

    def end(self, manifest: Mapping[str, Any]) -> None:
        """Write the manifest, once all shards are there."""
        write_checksummed(self.manifest, manifest)
        (self.folder / UNFINISHED).unlink()

    def _begun(self) -> bool:
        """Tell whether an earlier run was cut off here."""
        return (self.folder / PLAN).is_file()
