"""Numbers of a LeRobotDataset, read from Parquet: which file an episode is in, and what was recorded in it."""

from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from nerf_rl.datasets.export.lerobot.files import CHUNK, DATA, EPISODES, file_path
from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.datasets.importing.lerobot.description import Description
from nerf_rl.datasets.importing.source_files import file_inside
from nerf_rl.datasets.storage.shards import SPLIT_NAMES
from nerf_rl.machine.extras import import_extra

_MOST_BYTES = 1 << 30  # of a table, unpacked
_PURPOSE = "an import from LeRobot"


class Episode(NamedTuple):
    """Where an episode is."""

    number: int
    length: int
    """frames"""
    data_file: int
    """number of the file of its numbers"""
    videos: dict[str, tuple[int, float]]
    """number of the file and beginning within it [s], by the video's key"""
    split: str | None


def read_episodes(described: Description) -> list[Episode]:
    """Return the episodes of a dataset, in order.

    Raises:
        SourceError: the table is damaged, or of other episodes than the dataset says.
        UserError: PyArrow is not installed.
    """
    keys = [key for camera in described.cameras for key in (camera.image_key, camera.depth_key) if key is not None]
    places = [f"videos/{key}/{what}" for key in keys for what in ("chunk_index", "file_index", "from_timestamp")]
    wanted = ["episode_index", "length", "data/chunk_index", "data/file_index", *places]
    episodes: list[Episode] = []
    path = file_path(described.folder, EPISODES, 0)
    for file in sorted(path.parent.parent.glob("*/*.parquet")) or [path]:
        path = file_inside(described.folder, str(file.relative_to(described.folder)), file)
        table = _read(path, described.episodes, wanted, ("source/split",))
        for row in range(len(table["episode_index"])):
            values = {name: column[row] for name, column in table.items()}
            episodes.append(_episode(path, values, keys))
    episodes.sort(key=lambda episode: episode.number)
    if [episode.number for episode in episodes] != list(range(described.episodes)):
        raise SourceError(path, f"its episodes are not those numbered 0 to {described.episodes - 1}")
    if sum(episode.length for episode in episodes) != described.frames:
        raise SourceError(path, f"its episodes do not have {described.frames} frames together")
    return episodes


class FrameTables:
    """What was recorded in each frame; the file of the last episode is kept, since the next is most often in it too.

    Args:
        described: the dataset.
        columns: features that there must be.
        optional: those that may be missing.
    """

    def __init__(self, described: Description, columns: list[str], optional: list[str]):
        self._described, self._columns, self._optional = described, columns, optional
        self._kept: tuple[Path, dict[str, ndarray]] | None = None

    def read(self, episode: Episode) -> dict[str, ndarray]:
        """Return what was recorded in an episode, [T, ...] by feature.

        Raises:
            SourceError: the table is damaged, or has other rows than the episode.
        """
        folder = self._described.folder
        path = file_path(folder, DATA, episode.data_file)
        path = file_inside(folder, str(path.relative_to(folder)), path)
        if self._kept is None or self._kept[0] != path:
            wanted = ["episode_index", "frame_index", *self._columns]
            self._kept = path, _read(path, self._described.frames, wanted, self._optional)
        rows = np.flatnonzero(self._kept[1]["episode_index"] == episode.number)
        found = {name: column[rows] for name, column in self._kept[1].items()}
        if found["frame_index"].tolist() != list(range(episode.length)):
            raise SourceError(path, f"episode {episode.number} does not have frames 0 to {episode.length - 1} in order")
        for name in {*self._columns, *self._optional} & set(found):
            self._require_numbers(path, name, found[name], episode)
        return found

    def _require_numbers(self, path: Path, name: str, values: ndarray, episode: Episode) -> None:
        shape = tuple(self._described.features.get(name, {}).get("shape", values.shape[1:]))
        if values.shape[1:] != shape and (shape, values.shape[1:]) != ((1,), ()):
            raise SourceError(path, f"{name} has the shape {values.shape[1:]} instead of {shape}")
        if values.dtype.kind not in "iufb" or not np.isfinite(values.astype(np.float64)).all():
            raise SourceError(path, f"{name} of episode {episode.number} is not finite numbers")


def _episode(path: Path, row: dict[str, Any], keys: list[str]) -> Episode:
    try:
        videos = {
            key: (
                _file_number(row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"]),
                float(row[f"videos/{key}/from_timestamp"]),
            )
            for key in keys
        }
        split = row.get("source/split")
        episode = Episode(
            int(row["episode_index"]),
            int(row["length"]),
            _file_number(row["data/chunk_index"], row["data/file_index"]),
            videos,
            str(split) if split in SPLIT_NAMES else None,
        )
        if episode.length < 1 or not all(0 <= begin < 1e9 for _, begin in videos.values()):
            raise ValueError("an episode has no length, or begins nowhere")
    except (TypeError, ValueError, OverflowError) as error:
        raise SourceError(path, f"its table of episodes is damaged ({error})") from error
    return episode


def _file_number(chunk: Any, file: Any) -> int:
    if not (0 <= int(chunk) < 10**6 and 0 <= int(file) < CHUNK):
        raise ValueError(f"no file has the chunk {chunk} and the number {file}")
    return int(chunk) * CHUNK + int(file)


def _read(path: Path, most: int, columns: list[str], optional: Sequence[str]) -> dict[str, ndarray]:
    """Return columns of a file, after a look at how large they are.

    Raises:
        SourceError: it is no Parquet file, too large, or has no such columns.
    """
    parquet = import_extra("pyarrow.parquet", "lerobot", _PURPOSE)
    arrow = import_extra("pyarrow", "lerobot", _PURPOSE)
    try:
        with parquet.ParquetFile(path) as file:
            meta = file.metadata
            groups = [meta.row_group(index) for index in range(meta.num_row_groups)]
            if meta.num_rows > most or sum(group.total_byte_size for group in groups) > _MOST_BYTES:
                raise ValueError(f"it has {meta.num_rows} rows, more than the dataset has, or is too large to be read")
            there = set(file.schema_arrow.names)
            missing = [name for name in columns if name not in there]
            if missing:
                raise ValueError(f"it has no column {missing[0]}")
            table = file.read(columns=[*columns, *(name for name in optional if name in there)])
        return {name: _array(arrow, table.column(name)) for name in table.column_names}
    except (OSError, ValueError, TypeError, arrow.ArrowException) as error:
        raise SourceError(path, " ".join(str(error).split())[:300]) from error


def _array(arrow: ModuleType, column: Any) -> ndarray:
    """Return a column of T numbers, texts or (nested) lists of equal lengths as [T, ...]."""
    if column.null_count:
        raise ValueError("a column has empty places")
    values, shape, kinds = column.combine_chunks(), [len(column)], arrow.types
    while kinds.is_list(values.type) or kinds.is_large_list(values.type) or kinds.is_fixed_size_list(values.type):
        inner = values.flatten()
        length, rest = divmod(len(inner), max(len(values), 1))
        lengths = {length} if kinds.is_fixed_size_list(values.type) else set(values.value_lengths().to_pylist())
        if rest or lengths - {length} or inner.null_count:
            raise ValueError("the lists of a column have different lengths, or empty places")
        shape.append(length)
        values = inner
    return np.asarray(values.to_numpy(zero_copy_only=False)).reshape(shape)
