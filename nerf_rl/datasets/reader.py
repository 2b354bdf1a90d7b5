"""Reading a dataset: frames by index, from many shards, with memory that does not grow with the dataset."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from nerf_rl.cameras import projection_matrix
from nerf_rl.datasets.shards import SPLIT_NAMES, read_manifest
from nerf_rl.errors import MissingFileError, UnknownNameError


class _ArrayLocation(NamedTuple):
    """Where a contiguous array lies in its shard file."""

    offset: int
    shape: tuple[int, ...]
    """of one frame"""
    dtype: np.dtype
    constant: bool
    """whether the array holds one row for all frames"""


class MultiViewDataset:
    """A dataset folder, read lazily: each access reads just the frames asked for.

    Safe under ``fork`` and ``spawn``, and picklable. Array names are those of datasets/README.md.

    Args:
        folder: of the dataset.

    Raises:
        MissingFileError: the folder holds no finished dataset, or a shard is missing.
    """

    def __init__(self, folder: Path | str):
        self.folder = Path(folder)
        self.manifest: dict[str, Any] = read_manifest(self.folder)
        self._paths = [self.folder / shard["file"] for shard in self.manifest["shards"]]
        remedy = "make the dataset again with --resume true"
        for path in self._paths:
            if not path.is_file():
                raise MissingFileError("a whole dataset", self.folder, f"{path.name} is missing", remedy)
        self._first = np.cumsum([0, *(shard["frames"] for shard in self.manifest["shards"])])
        self._shards: dict[int, tuple[int, dict[str, _ArrayLocation]]] = {}
        self._owner = os.getpid()

    def __len__(self) -> int:
        return int(self._first[-1])

    @property
    def class_names(self) -> tuple[str, ...]:
        """Names of the semantic classes, by id."""
        return tuple(entry["name"] for entry in self.manifest["classes"])

    @property
    def palette(self) -> ndarray:
        """Colours of the semantic classes, u8 [C, 3]."""
        return np.array([entry["colour"] for entry in self.manifest["classes"]], np.uint8)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of the view axis."""
        return tuple(camera["name"] for camera in self.manifest["cameras"])

    def digest(self) -> str:
        """Return a SHA-256 over the digests of all shards, which identifies the content."""
        digests = "".join(shard["sha256"] for shard in self.manifest["shards"])
        return hashlib.sha256(digests.encode()).hexdigest()

    def views(self, *roles: str) -> list[int]:
        """Return the positions on the view axis of the cameras with one of the roles."""
        return [i for i, camera in enumerate(self.manifest["cameras"]) if camera["role"] in roles]

    def columns(self, group: str) -> tuple[str, ...]:
        """Return the column names of ``proprio``, ``privileged`` or ``action``."""
        return tuple(self.manifest["columns"][group])

    def split(self, name: str) -> Int[ndarray, "M"]:
        """Return the frame indices of ``train`` or ``validation``."""
        if name not in SPLIT_NAMES:
            raise UnknownNameError("split", name, SPLIT_NAMES)
        return np.flatnonzero(self.read("split") == SPLIT_NAMES.index(name))

    def read(self, name: str, frames: Sequence[int] | ndarray | None = None) -> ndarray:
        """Return an array's rows for some frames (all if None), in the order asked for.

        Args:
            name: such as ``rgb`` or ``state/qpos``; arrays that are constant over frames are repeated.
            frames: frame indices in the dataset.

        Raises:
            UnknownNameError: the dataset has no such array.
            IndexError: a frame index is negative or beyond the last frame, or there is none.
        """
        indices = np.arange(len(self)) if frames is None else np.asarray(frames, dtype=np.int64)
        if len(indices) == 0 or indices.min() < 0 or indices.max() >= len(self):
            raise IndexError(f"frames must be some of 0 to {len(self) - 1}")
        shard_of = np.searchsorted(self._first, indices, side="right") - 1
        _, arrays = self._open(int(shard_of[0]))
        if name not in arrays:
            raise UnknownNameError("array", name, arrays)
        shape, dtype = arrays[name].shape, arrays[name].dtype
        size = int(np.prod(shape)) * dtype.itemsize
        rows = np.empty((len(indices), *shape), dtype)
        for shard in np.unique(shard_of):
            descriptor, arrays = self._open(int(shard))
            location = arrays[name]
            for place in np.flatnonzero(shard_of == shard):
                row = 0 if location.constant else int(indices[place] - self._first[shard])
                content = os.pread(descriptor, size, location.offset + row * size)
                rows[place] = np.frombuffer(content, dtype).reshape(shape)
        return rows

    def cameras(self, frames: Sequence[int] | ndarray) -> tuple[Float[ndarray, "V 3 3"], Float[ndarray, "N V 4 4"]]:
        """Return intrinsics [pixels] and the ``camera_from_world`` of each frame and camera."""
        with h5py.File(self._paths[0], "r") as file:
            intrinsics = file["cameras/intrinsics"][:]
            fixed = file["cameras/camera_from_world"]
            if fixed.ndim == 3:
                return intrinsics, np.broadcast_to(fixed[:], (len(frames), *fixed.shape))
        return intrinsics, self.read("cameras/camera_from_world", frames)

    def projections(self, frames: Sequence[int] | ndarray) -> Float[ndarray, "N V 3 4"]:
        """Return P = K [R | t] of each frame and camera."""
        intrinsics, poses = self.cameras(frames)
        return projection_matrix(np.broadcast_to(intrinsics, (len(poses), *intrinsics.shape)), poses)

    def _open(self, shard: int) -> tuple[int, dict[str, _ArrayLocation]]:
        if self._owner != os.getpid():  # a forked child must not share file positions' fate with its parent
            self._shards, self._owner = {}, os.getpid()
        if shard not in self._shards:
            path = self._paths[shard]
            self._shards[shard] = os.open(path, os.O_RDONLY), _locate_arrays(path)
        return self._shards[shard]

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shards": {}}

    def __del__(self) -> None:
        if getattr(self, "_owner", None) == os.getpid():
            for descriptor, _ in self._shards.values():
                os.close(descriptor)


def _locate_arrays(path: Path) -> dict[str, _ArrayLocation]:
    """Return where the arrays of a shard lie."""
    found = {}
    with h5py.File(path, "r") as file:

        def visit(name: str, item: h5py.Group | h5py.Dataset) -> None:
            if isinstance(item, h5py.Dataset):
                constant = name.startswith("cameras/") and item.ndim == 3  # view, row, column: nothing for the frame
                shape = item.shape if constant else item.shape[1:]
                found[name] = _ArrayLocation(item.id.get_offset() or 0, shape, item.dtype, constant)  # empty: no offset

        file.visititems(visit)
    return found
