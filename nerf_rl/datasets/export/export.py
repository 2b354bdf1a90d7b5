"""``nerf-rl export``: choose frames or episodes and write them in the format asked for."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from nerf_rl.datasets.export.config import ExportConfig
from nerf_rl.datasets.export.lerobot.plan import make_plan
from nerf_rl.datasets.export.lerobot.tables import load_parquet
from nerf_rl.datasets.export.lerobot.videos import load_av
from nerf_rl.datasets.export.lerobot.write import write_dataset
from nerf_rl.datasets.export.mesh import load_open3d, write_mesh
from nerf_rl.datasets.export.nerfstudio import FARTHEST, write_scene
from nerf_rl.datasets.export.seen import Seen, seen_in_frame
from nerf_rl.datasets.storage.disk import explain_full_disk
from nerf_rl.datasets.storage.frames import in_world, read_frame
from nerf_rl.datasets.storage.point_cloud import write_point_cloud
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, require_outside, write_provenance
from nerf_rl.progress import Progress

_NAMED_FRAMES = 5  # of those without content


def export(config: ExportConfig) -> None:
    """Write what was chosen of a dataset to ``config.out``; the formats are described in datasets/README.md.

    Raises:
        UserError: no such dataset, frame, episode, class or camera; the dataset lacks what the format is made of; the
            output folder is in use; an extra is missing.
        FailureError: the disk is full.
    """
    dataset, out = MultiViewDataset(config.dataset), Path(config.out)
    require_outside(out, config.dataset)
    check_output(out, config.overwrite)
    write = _lerobot(dataset, config) if config.format == "lerobot" else _frame_by_frame(dataset, config)
    with explain_full_disk(out, remedy="free some space or choose another --out, and export with --overwrite true"):
        prepare_output(out, config.overwrite)
        write_provenance(out, "export", config)
        written = write(out)
        write_json(out / SUMMARY, {**written, "format": config.format, "dataset": dataset.digest()})


def _lerobot(dataset: MultiViewDataset, config: ExportConfig) -> Callable[[Path], dict[str, int]]:
    """Check what is asked for, and return what writes it and tells how much it was."""
    load_parquet()
    load_av()
    plan = make_plan(dataset, config)

    def write(out: Path) -> dict[str, int]:
        print(f"writing {plan.frames} frames of {len(plan.episodes)} episodes as {config.format} to {out}")
        write_dataset(out, plan)
        return {"frames": plan.frames, "episodes": len(plan.episodes)}

    return write


def _frame_by_frame(dataset: MultiViewDataset, config: ExportConfig) -> Callable[[Path], dict[str, int]]:
    """Check what is asked for, and return what writes it and tells how much it was."""
    frames = chosen_frames(dataset, config.frames, config.episodes)
    for name in config.exclude:
        if name not in dataset.class_names:
            raise UnknownNameError("class", name, dataset.class_names)
    if DEPTH in dataset.absent and config.format in ("pointcloud", "mesh"):
        raise UserError(f"{dataset.folder} has no depth, which --format {config.format} is made of; use nerfstudio")
    if config.format == "mesh":
        load_open3d()
    too_far = 0

    def as_scene(path: Path, seen: Seen) -> bool:
        nonlocal too_far
        too_far += write_scene(path, seen, dataset, bool(config.exclude))
        return True

    def as_points(path: Path, seen: Seen) -> bool:
        cloud = seen.cloud()
        if len(cloud.points):
            write_point_cloud(path.with_suffix(".ply"), cloud)
        return len(cloud.points) > 0

    def as_mesh(path: Path, seen: Seen) -> bool:
        return write_mesh(path.with_suffix(".ply"), seen, config.voxel)

    write_frame = {"nerfstudio": as_scene, "pointcloud": as_points, "mesh": as_mesh}[config.format]

    def write(out: Path) -> dict[str, int]:
        print(f"writing {len(frames)} frames as {config.format} to {out}")
        pixels, empty = 0, list[int]()
        with Progress(len(frames), "frames") as progress:
            for index in frames:
                seen = seen_in_frame(dataset, in_world(read_frame(dataset, int(index))), config.exclude, config.reach)
                if not write_frame(out / f"frame_{index:06d}", seen):
                    empty.append(int(index))
                pixels += seen.frame.depth.size
                progress.advance()
        if empty:
            _tell_of_empty(empty, len(frames), config.format)
        if too_far:
            print(
                f"warning: {too_far / pixels:.1%} of the pixels show what is more than {FARTHEST:.1f} m away, which "
                "nerfstudio's depth cannot hold; it is unknown there",
                file=sys.stderr,
            )
        return {"frames": len(frames) - len(empty)}

    return write


def _tell_of_empty(empty: Sequence[int], frames: int, form: str) -> None:
    """Tell which frames nothing was written of; raise UserError if these are all."""
    some = ", ".join(map(str, empty[:_NAMED_FRAMES])) + (", ..." if len(empty) > _NAMED_FRAMES else "")
    which = f"frame {some} shows" if len(empty) == 1 else f"{len(empty)} of {frames} frames ({some}) show"
    what, remedies = ("points", "") if form == "pointcloud" else ("surface to fuse", "lower --voxel, ")
    told = f"{which} no {what}"
    remedy = f"{remedies}raise --reach or --exclude fewer classes"
    if len(empty) == frames:
        raise UserError(f"{told}; {remedy}")
    print(f"warning: {told}, of which no file is written; {remedy}", file=sys.stderr)


def chosen_frames(dataset: MultiViewDataset, frames: list[int], episodes: list[int]) -> Int[ndarray, "N"]:
    """Return the indices of some frames and of all frames of some episodes, in order; all if both are empty.

    Raises:
        UserError: the dataset has no such frame or episode.
    """
    if not frames and not episodes:
        return np.arange(len(dataset))
    absent = [index for index in frames if not 0 <= index < len(dataset)]
    if absent:
        raise UserError(f"{dataset.folder} has no frame {absent[0]}; available: 0 to {len(dataset) - 1}")
    episode_of = dataset.read("episode")
    for episode in episodes:
        if episode not in episode_of:
            raise UserError(
                f"{dataset.folder} has no episode {episode}; available: {episode_of.min()} to {episode_of.max()}"
            )
    chosen = np.isin(episode_of, episodes)
    chosen[frames] = True
    return np.flatnonzero(chosen)
