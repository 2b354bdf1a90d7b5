"""Reading a dataset: frames by index, from many shards, with memory that does not grow with the dataset."""

import hashlib
import itertools
import os
from collections.abc import Mapping, Sequence
from functools import lru_cache
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import projection_matrix
from nerf_rl.cameras.tracking_frame import TrackingFrame, to_tracking_frame
from nerf_rl.datasets.storage.shard_layout import ArrayLocation, ShardError, known_arrays, locate_arrays
from nerf_rl.datasets.storage.shards import SPLIT_NAMES, read_manifest, read_unfinished
from nerf_rl.datasets.storage.stored_manifest import ROLES
from nerf_rl.errors import MissingFileError, UnknownNameError, UserError

_MOST_OPEN_FILES = 128  # a large dataset has more shards than a process may have open files
_MOST_BYTES = 1 << 26  # of one read
_COMPARED = 3  # layouts of shards
_BYTES_OF_A_PIXEL = 8  # colour, depth and label


class MultiViewDataset:
    """A dataset folder, read lazily: each access reads just the frames asked for.

    Picklable, and safe in threads and under ``fork``, ``spawn`` and ``forkserver``. Array names are those of
    datasets/README.md.

    Args:
        folder: of the dataset.
        unfinished: take what there is of one that is being written: the shards that are whole when it is opened.

    Raises:
        MissingFileError: the folder holds no finished dataset, or a shard is missing or too short.
    """

    def __init__(self, folder: Path | str, unfinished: bool = False):
        self.folder = Path(folder)
        self.manifest: dict[str, Any] = (read_unfinished if unfinished else read_manifest)(self.folder)
        if not all(self.manifest[key] for key in ("shards", "cameras", "classes", "columns")):
            raise MissingFileError("a dataset", self.folder, "its manifest names no shards", "make the dataset again")
        self._paths = [self.folder / shard["file"] for shard in self.manifest["shards"]]
        remedy = "make the dataset again with --resume true"
        views, pixels = len(self.manifest["cameras"]), self.manifest.get("height", 1) * self.manifest.get("width", 1)
        for path, shard in zip(self._paths, self.manifest["shards"], strict=True):
            if not path.is_file():
                raise MissingFileError("a whole dataset", self.folder, f"{path.name} is missing", remedy)
            if path.stat().st_size < shard["frames"] * views * pixels * _BYTES_OF_A_PIXEL:
                reason = f"{path.name} is too short for the {shard['frames']} frames that the manifest counts"
                raise MissingFileError("a whole dataset", self.folder, reason, remedy)
        self._first = np.cumsum([0, *(shard["frames"] for shard in self.manifest["shards"])])
        self._arrays: dict[int, Mapping[str, ArrayLocation]] = {}
        # a file closes itself when the last of its users, perhaps in another thread, has let go of it
        self._open = lru_cache(_MOST_OPEN_FILES)(FileIO)

    def __len__(self) -> int:
        return int(self._first[-1])

    @property
    def is_finished(self) -> bool:
        """Whether these are all shards that there will be."""
        return all("sha256" in shard for shard in self.manifest["shards"])

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

    @property
    def tracking_frame(self) -> TrackingFrame | None:
        """The frame in which the encoder's cameras stand still, where they follow a body; None where it is the world.

        An encoder, its radiance field and what is read from its latent are all meant in this frame.
        """
        return TrackingFrame.from_json(self.manifest.get("tracking_frame"))

    def digest(self) -> str:
        """Return a SHA-256 over the digests of all shards, which identifies the content.

        Raises:
            UserError: the dataset is not finished.
        """
        if not self.is_finished:
            raise UserError(f"{self.folder} is not finished, so nothing identifies its content yet")
        digests = "".join(shard["sha256"] for shard in self.manifest["shards"])
        return hashlib.sha256(digests.encode()).hexdigest()

    def views(self, *roles: str) -> list[int]:
        """Return the positions on the view axis of the cameras with one of the roles.

        Raises:
            UnknownNameError: no camera of any dataset has such a role.
        """
        if unknown := sorted(set(roles) - set(ROLES)):
            raise UnknownNameError("role", unknown[0], ROLES)
        return [i for i, camera in enumerate(self.manifest["cameras"]) if camera["role"] in roles]

    def columns(self, group: str) -> tuple[str, ...]:
        """Return the column names of ``proprio``, ``privileged`` or ``action``.

        Raises:
            UnknownNameError: there is no such group.
        """
        if group not in self.manifest["columns"]:
            raise UnknownNameError("group of columns", group, self.manifest["columns"])
        return tuple(self.manifest["columns"][group])

    @property
    def absent(self) -> tuple[str, ...]:
        """What of ``depth``, ``labels`` and ``state`` the dataset lacks, as one of imported pictures may.

        In place of depth there is that of the far plane then, in place of labels the background; of state no columns.
        """
        return tuple(self.manifest.get("absent", ()))

    def joints(self) -> list[dict[str, str]]:
        """Return ``name`` and ``kind`` of the joints that make up ``state/qpos``; none if the manifest is older."""
        return self.manifest.get("joints", [])

    def split(self, name: str) -> Int[ndarray, "M"]:
        """Return the frame indices of ``train`` or ``validation``."""
        if name not in SPLIT_NAMES:
            raise UnknownNameError("split", name, SPLIT_NAMES)
        return np.flatnonzero(self.read_splits() == SPLIT_NAMES.index(name))

    def read_splits(self, frames: Sequence[int] | ndarray | None = None) -> UInt8[ndarray, "N"]:
        """Return the split of some frames, as an index of its name.

        Raises:
            UserError: there are others.
        """
        splits = self.read("split", frames)
        if splits.max(initial=0) >= len(SPLIT_NAMES):
            raise UserError(f"{self.folder} is damaged: a frame's split is {splits.max()}; make the dataset again")
        return splits

    def read(self, name: str, frames: Sequence[int] | ndarray | None = None) -> ndarray:
        """Return an array's rows for some frames (all if None), in the order asked for.

        Args:
            name: such as ``rgb`` or ``state/qpos``; arrays that are constant over frames are repeated.
            frames: frame indices in the dataset.

        Raises:
            UnknownNameError: the dataset has no such array.
            ShardError: a shard is damaged, cut off or laid out otherwise than shards are.
            IndexError: a frame index is negative or beyond the last frame, or there is none; or what is given are no
                indices, such as a mask.
        """
        indices = np.arange(len(self)) if frames is None else np.asarray(frames)
        if indices.size and (indices.ndim != 1 or indices.dtype.kind not in "iu"):  # NumPy would make numbers of a mask
            got = f"{indices.dtype} of shape {[*indices.shape]}; np.flatnonzero gives the indices of a mask"
            raise IndexError(f"frames must be a list of whole numbers from 0 to {len(self) - 1}, got {got}")
        if indices.size == 0 or indices.min() < 0 or indices.max() >= len(self):
            raise IndexError(f"frames must be some of 0 to {len(self) - 1}")
        indices = indices.astype(np.int64)
        shard_of = np.searchsorted(self._first, indices, side="right") - 1
        like = self._location(int(shard_of[0]), name)
        size = int(np.prod(like.shape)) * like.dtype.itemsize
        rows = np.empty((len(indices), *like.shape), like.dtype)
        if rows.nbytes == 0:
            return rows
        most = max(1, _MOST_BYTES // size)
        breaks = np.flatnonzero((np.diff(indices) != 1) | (np.diff(shard_of) != 0)) + 1
        for begin, end in itertools.pairwise([0, *breaks.tolist(), len(indices)]):  # runs of neighbours in one shard
            shard = int(shard_of[begin])
            location, file = self._location(shard, name), self._open(self._paths[shard])
            if (location.shape, location.dtype) != (like.shape, like.dtype):
                raise ShardError(self._paths[shard], f"{name} has another shape than in {self._paths[0].name}")
            if location.constant:
                rows[begin:end] = _read_rows(file, location.offset, location, 1)
                continue
            for first in range(begin, end, most):
                count = min(most, end - first)
                row = int(indices[first] - self._first[shard])
                rows[first : first + count] = _read_rows(file, location.offset + row * size, location, count)
        return rows

    def read_labels(self, frames: Sequence[int] | ndarray | None = None) -> UInt8[ndarray, "N V H W"]:
        """Return the class ids of some frames, as :meth:`read` does.

        Raises:
            UserError: there are ids beyond the classes that the manifest names.
        """
        labels = self.read("semantic", frames)
        if labels.max(initial=0) >= len(self.class_names):
            most = f"{labels.max()}, but its manifest names {len(self.class_names)} classes"
            raise UserError(f"{self.folder} is damaged: a picture shows the class {most}; make the dataset again")
        return labels

    def read_valid(self, frames: Sequence[int] | ndarray) -> Bool[ndarray, "N V H W"] | None:
        """Tell which pixels of some frames count; None of a dataset of which all do.

        Imported pictures may have masks, and pixels whose depth is not known.
        """
        return self.read("valid", frames) != 0 if "valid" in self._locations(0) else None

    def cameras(self, frames: Sequence[int] | ndarray) -> tuple[Float[ndarray, "V 3 3"], Float[ndarray, "N V 4 4"]]:
        """Return intrinsics [pixels] and the ``camera_from_world`` of each frame and camera.

        Raises:
            UserError: they hold values that are not finite.
        """
        intrinsics, poses = self.read("cameras/intrinsics", [0])[0], self.read("cameras/camera_from_world", frames)
        if not (np.isfinite(intrinsics).all() and np.isfinite(poses).all()):
            raise UserError(f"{self.folder} is damaged: a camera's matrices are not finite; make the dataset again")
        return intrinsics, poses

    def tracking_origins(self, frames: Sequence[int] | ndarray) -> Float[ndarray, "N 3"]:
        """Return where the origin of ``tracking_frame`` is in the world [m]; zero without one.

        Raises:
            UserError: they hold values that are not finite.
        """
        if self.tracking_frame is None:
            return np.zeros((len(frames), 3))
        origins = self.read("cameras/tracking_origin", frames)
        if not np.isfinite(origins).all():
            raise UserError(
                f"{self.folder} is damaged: a tracking frame's origin is not finite; make the dataset again"
            )
        return origins

    def tracked_cameras(
        self, frames: Sequence[int] | ndarray
    ) -> tuple[Float[ndarray, "V 3 3"], Float[ndarray, "N V 4 4"]]:
        """Return what :meth:`cameras` does, but with poses in ``tracking_frame``; without one they are the same."""
        intrinsics, poses = self.cameras(frames)
        if self.tracking_frame is None:
            return intrinsics, poses
        return intrinsics, to_tracking_frame(poses, self.tracking_origins(frames)[:, None])

    def tracked_positions(self, frames: Sequence[int] | ndarray) -> Float[ndarray, "N Q"]:
        """Return the privileged columns, with positions (``NAME_x``, ``NAME_y``, ``NAME_z``) in ``tracking_frame`` [m].

        What the encoder's cameras see tells nothing of how far they have come. Without such a frame these are the
        columns as they are.
        """
        state = self.read("state/privileged", frames)
        if self.tracking_frame is None:
            return state
        state, origins = state.astype(np.float64), self.tracking_origins(frames)
        for column, name in enumerate(self.columns("privileged")):
            for axis, ending in enumerate(("_x", "_y", "_z")):
                state[:, column] -= origins[:, axis] * name.endswith(ending)
        return state

    def projections(self, frames: Sequence[int] | ndarray) -> Float[ndarray, "N V 3 4"]:
        """Return P = K [R | t] of each frame and camera."""
        intrinsics, poses = self.cameras(frames)
        return projection_matrix(np.broadcast_to(intrinsics, (len(poses), *intrinsics.shape)), poses)

    def _locations(self, shard: int) -> Mapping[str, ArrayLocation]:
        if shard not in self._arrays:
            frames = self.manifest["shards"][shard]["frames"]
            found = locate_arrays(self._paths[shard], frames, known_arrays(self.manifest))
            # nearly all shards are laid out alike, and then share one description
            self._arrays[shard] = next(
                (known for known in list(self._arrays.values())[:_COMPARED] if known == found), found
            )
        return self._arrays[shard]

    def _location(self, shard: int, name: str) -> ArrayLocation:
        if name not in self._locations(shard):
            raise UnknownNameError("array", name, self._locations(shard))
        return self._locations(shard)[name]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_open"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._open = lru_cache(_MOST_OPEN_FILES)(FileIO)


def _read_rows(file: FileIO, offset: int, location: ArrayLocation, count: int) -> ndarray:
    """Read neighbouring rows without moving the file's position, which forked processes share.

    Raises:
        ShardError: the file ends before them.
    """
    rows = np.empty((count, *location.shape), location.dtype)
    view = rows.data.cast("B")
    done = 0
    while done < len(view):
        got = os.preadv(file.fileno(), [view[done:]], offset + done)
        if got == 0:
            raise ShardError(Path(str(file.name)), f"{file.name} ends after {offset + done} bytes, within an array")
        done += got
    return rows
