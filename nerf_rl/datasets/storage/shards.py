"""The dataset on disk: array layout of a shard, writing one so that it is complete or absent, and the manifest.

Arrays are contiguous and uncompressed, frames first, so that a reader can fetch any frame with one read; decoding
compressed chunks costs more than a small encoder's training step.
"""

import errno
import hashlib
import os
import shlex
from collections.abc import Collection, Mapping
from pathlib import Path

import h5py
import numpy as np
from numpy import ndarray

from nerf_rl.datasets.storage.stored_manifest import (
    MANIFEST_STRUCTURE,
    StoredManifest,
    content_keys,
    frames_of_shard,
)
from nerf_rl.errors import MissingFileError
from nerf_rl.files.atomic import rename_durably
from nerf_rl.files.checksummed_json import CHECKSUM, is_whole
from nerf_rl.files.json_files import read_json
from nerf_rl.files.structure import mapping, whole

SCHEMA_VERSION = 1
MANIFEST = "manifest.json"
SHARDS = "shards"
UNFINISHED = "unfinished.json"
PARTS = "parts"
_PARTIAL = ".partial"
TRAIN, VALIDATION = 0, 1
SPLIT_NAMES = ("train", "validation")

Layout = Mapping[str, tuple[tuple[int, ...], str]]
"""Array name to (shape of one frame, dtype)."""


def frame_layout(
    views: int,
    size: int | tuple[int, int],
    moving_cameras: bool,
    model_sizes: Mapping[str, int] | None,
    columns: Mapping[str, int],
    tracking_frame: bool = False,
    valid: bool = False,
) -> Layout:
    """Return the arrays of a shard that have one row a frame.

    Args:
        views: cameras.
        size: image height and width [pixels]; one number if they are the same.
        moving_cameras: whether extrinsics differ from frame to frame.
        model_sizes: of the MuJoCo model: nq, nv, nbody, nmocap; None where there is no simulator.
        columns: number of named columns of ``proprio``, ``privileged`` and ``action``.
        tracking_frame: whether the encoder's cameras stand still in a frame that moves.
        valid: whether some pixels do not count.
    """
    height, width = (size, size) if isinstance(size, int) else size
    image = (views, height, width)
    layout = {
        "rgb": ((*image, 3), "u1"),
        "depth": (image, "<f4"),
        "semantic": (image, "u1"),
        "episode": ((), "<i4"),
        "step": ((), "<i4"),
        "split": ((), "u1"),
        **(_model_layout(model_sizes) if model_sizes is not None else {}),
        **{f"state/{name}": ((count,), "<f4") for name, count in columns.items()},
        "reward": ((), "<f4"),
        "success": ((), "u1"),
    }
    if moving_cameras:
        layout["cameras/camera_from_world"] = ((views, 4, 4), "<f8")
        layout["cameras/projection"] = ((views, 3, 4), "<f8")
    if tracking_frame:
        layout["cameras/tracking_origin"] = ((3,), "<f8")
    if valid:
        layout["valid"] = (image, "u1")
    return layout


def _model_layout(sizes: Mapping[str, int]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return the arrays that hold the state of a MuJoCo model."""
    return {
        "state/qpos": ((sizes["nq"],), "<f8"),
        "state/qvel": ((sizes["nv"],), "<f8"),
        "state/mocap_pos": ((sizes["nmocap"], 3), "<f8"),
        "state/mocap_quat": ((sizes["nmocap"], 4), "<f8"),
        "state/body_pos": ((sizes["nbody"], 3), "<f8"),
        "state/body_quat": ((sizes["nbody"], 4), "<f8"),
    }


class ShardWriter:
    """Writes one shard aside and renames it when it is whole; use as a context manager.

    HDF5 lays the file out; its space is then claimed from the disk at once and rows are written by plain calls, because
    HDF5 may crash when it finds the disk full.

    Args:
        path: of the finished shard.
        frames: how many frames it has.
        layout: its arrays with one row a frame.
        constant: its other arrays.
        attributes: what else to record of it, as attributes of the file.

    Raises:
        OSError: the disk has no room for it.
    """

    def __init__(
        self,
        path: Path,
        frames: int,
        layout: Layout,
        constant: Mapping[str, ndarray],
        attributes: Mapping[str, str] | None = None,
    ):
        self._path, self._aside = path, partial_path(path)
        self._frames, self._written, self._layout = frames, 0, layout
        self._descriptor = os.open(self._aside, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            self._claim_space(frames * bytes_of_a_frame(layout))
            self._offsets = _lay_out(self._aside, frames, layout, constant, attributes or {})
            self._claim_space(os.fstat(self._descriptor).st_size)
        except BaseException:
            self._discard()
            raise

    def append(self, rows: Mapping[str, ndarray]) -> None:
        """Write some frames; every array of the layout needs the same number of rows.

        Raises:
            ValueError: the rows are not of the layout, or too many.
        """
        count = len(rows["rgb"])
        if self._written + count > self._frames:
            raise ValueError(f"{self._path.name}: {self._written + count} frames are more than {self._frames}")
        for name, (shape, dtype) in self._layout.items():
            array = np.ascontiguousarray(rows[name], dtype)
            if array.shape != (count, *shape):
                raise ValueError(f"{self._path.name}: {name} has the shape {array.shape} instead of {(count, *shape)}")
            content = memoryview(array.tobytes())
            place = self._offsets[name] + self._written * (array.nbytes // count)
            while content:
                written = os.pwrite(self._descriptor, content, place)
                content, place = content[written:], place + written
        self._written += count

    def __enter__(self) -> "ShardWriter":
        return self

    def __exit__(self, *exception: object) -> None:
        try:
            if exception[0] is not None:
                return
            if self._written != self._frames:
                raise RuntimeError(f"{self._path.name}: {self._written} frames were written instead of {self._frames}")
            rename_durably(self._aside, self._path)
        finally:
            self._discard()

    def _claim_space(self, size: int) -> None:
        try:
            os.posix_fallocate(self._descriptor, 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):  # not every file system can
                raise

    def _discard(self) -> None:
        os.close(self._descriptor)
        self._aside.unlink(missing_ok=True)


def bytes_of_a_frame(layout: Layout) -> int:
    """Return the size of a frame's rows [bytes]."""
    return sum(int(np.prod(shape)) * np.dtype(dtype).itemsize for shape, dtype in layout.values())


def _lay_out(
    path: Path, frames: int, layout: Layout, constant: Mapping[str, ndarray], attributes: Mapping[str, str]
) -> dict[str, int]:
    """Write a shard without its rows; return where each array with rows begins in the file."""
    creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    creation.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    creation.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    offsets = {}
    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        for name, (shape, dtype) in layout.items():
            array = file.create_dataset(name, (frames, *shape), dtype, track_times=False, dcpl=creation)
            offsets[name] = array.id.get_offset() or 0  # empty: no offset
        for name, value in constant.items():
            file.create_dataset(name, data=value, track_times=False)
        for name, text in attributes.items():
            file.attrs[name] = text
    return offsets


def shard_file(shard: int) -> str:
    """Return the name of a shard's file below the dataset's folder."""
    return f"{SHARDS}/{shard:06d}.h5"


def shard_path(folder: Path, shard: int) -> Path:
    """Return where a shard is written."""
    return folder / shard_file(shard)


def partial_path(path: Path) -> Path:
    """Return where this process writes a shard before it is whole."""
    return path.with_name(f".{path.name}.{os.getpid()}{_PARTIAL}")


def partial_files(folder: Path, shards: Collection[int]) -> dict[Path, tuple[int, int]]:
    """Return the files of some shards that are not whole, each with its shard and the id of its process."""
    found = {}
    for path in (folder / SHARDS).glob(f".*{_PARTIAL}"):
        shard, _, pid = path.name.removeprefix(".").removesuffix(_PARTIAL).partition(".h5.")
        if shard.isdigit() and pid.isdigit() and int(shard) in shards:
            found[path] = int(shard), int(pid)
    return found


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_manifest(folder: Path) -> dict:
    """Return a dataset's manifest.

    Raises:
        MissingFileError: the folder holds no finished dataset, or one of a schema that this version cannot read.
    """
    remedy = "make one with: nerf-rl gen-dataset --config datasets/drawer-open.yaml --out FOLDER"
    path, quoted = folder / MANIFEST, shlex.quote(str(folder))
    if not path.is_file():
        reason = "the folder does not exist" if not folder.exists() else f"it holds no {MANIFEST}"
        if (folder / PARTS).is_dir():
            reason, remedy = "it holds parts of one", f"put them together with: nerf-rl merge {quoted}"
        elif (folder / SHARDS).is_dir():
            reason, remedy = "it is not finished", "finish it with the same command and --resume true"
        raise MissingFileError("a dataset", folder, reason, remedy)
    mend = f"mend it with: nerf-rl check {quoted} --repair true"
    try:
        content = read_json(path)
        mapping({"schema_version": whole()}, others=True)(content, "")
        version = content["schema_version"]
        if version != SCHEMA_VERSION:
            raise MissingFileError("a dataset for this version", folder, f"its schema version is {version}", remedy)
        if CHECKSUM in content and not is_whole(path):
            raise ValueError("its checksum is that of another content")
        MANIFEST_STRUCTURE(content, "")
    except (OSError, ValueError) as error:
        raise MissingFileError("a dataset", folder, f"{MANIFEST} is damaged", f"{mend} ({error})") from error
    return StoredManifest(path, content)


def read_unfinished(folder: Path) -> dict:
    """Return the manifest of what there is so far of a dataset that is being written, or was cut off.

    It lists the shards that are whole now, without digests. Of a finished dataset it is the manifest.

    Raises:
        MissingFileError: the folder holds no dataset, or one without a whole shard yet.
    """
    descriptions = [folder / UNFINISHED, *sorted(folder.glob(f"{PARTS}/*/{UNFINISHED}"))]
    description = next((path for path in descriptions if is_whole(path)), None)
    if (folder / MANIFEST).is_file() or description is None:
        return read_manifest(folder)
    content = read_json(description)
    entries = []
    try:
        mapping({"config": content_keys}, others=True)(content, "")
        for path in sorted((folder / SHARDS).glob("[0-9]*.h5")):
            frames = frames_of_shard(content["config"], int(path.stem)) if path.stem.isdecimal() else 0
            if frames:
                entries.append({"file": f"{SHARDS}/{path.name}", "frames": frames})
        if not entries:
            raise MissingFileError("a dataset", folder, "it has no whole shard yet", "wait for the first one")
        whole_so_far = {**content, "frames": sum(entry["frames"] for entry in entries), "shards": entries}
        MANIFEST_STRUCTURE(whole_so_far, "")
    except ValueError as error:
        remedy = "go on with the same command and --resume true"
        raise MissingFileError("a dataset", folder, f"{description.name} is damaged ({error})", remedy) from error
    return StoredManifest(description, whole_so_far)
