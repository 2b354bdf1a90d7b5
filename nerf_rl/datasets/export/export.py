"""``nerf-rl export``: choose frames and write each in the format asked for."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from nerf_rl.datasets.export.config import ExportConfig
from nerf_rl.datasets.export.mesh import load_open3d, write_mesh
from nerf_rl.datasets.export.nerfstudio import write_scene
from nerf_rl.datasets.export.seen import Seen, seen_in_frame
from nerf_rl.datasets.storage.frames import in_world, read_frame
from nerf_rl.datasets.storage.point_cloud import write_point_cloud
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UnknownNameError, UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.outputs import SUMMARY, check_output, prepare_output, write_provenance
from nerf_rl.progress import Progress


def export(config: ExportConfig) -> None:
    """Write frames of a dataset to ``config.out``; the formats are described in datasets/README.md.

    Raises:
        UserError: no such dataset, frame, episode or class; the output folder is in use; Open3D is missing.
    """
    dataset, out = MultiViewDataset(config.dataset), Path(config.out)
    check_output(out, config.overwrite)
    frames = chosen_frames(dataset, config.frames, config.episodes)
    for name in config.exclude:
        if name not in dataset.class_names:
            raise UnknownNameError("class", name, dataset.class_names)
    if config.format == "mesh":
        load_open3d()
    write: dict[str, Callable[[Seen, Path], None]] = {
        "nerfstudio": lambda seen, path: write_scene(path, seen, dataset, bool(config.exclude)),
        "pointcloud": lambda seen, path: write_point_cloud(path.with_suffix(".ply"), seen.cloud()),
        "mesh": lambda seen, path: write_mesh(path.with_suffix(".ply"), seen, config.voxel),
    }
    prepare_output(out, config.overwrite)
    write_provenance(out, "export", config)
    print(f"writing {len(frames)} frames as {config.format} to {out}")
    with Progress(len(frames), "frames") as progress:
        for index in frames:
            seen = seen_in_frame(dataset, in_world(read_frame(dataset, int(index))), config.exclude, config.reach)
            write[config.format](seen, out / f"frame_{index:06d}")
            progress.advance()
    write_json(out / SUMMARY, {"frames": len(frames), "format": config.format, "dataset": dataset.digest()})


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
