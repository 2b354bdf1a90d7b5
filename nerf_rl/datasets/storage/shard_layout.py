"""Where the arrays of a shard lie in its file, after a look at whether they lie there as shards are written.

A reader fetches rows by their place in the file, so an array that was compressed, moved to another file or turned into
other numbers since would be read as noise. It is refused here.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from nerf_rl.errors import MissingFileError

_DEEPEST = 3  # groups within groups

Known = Mapping[str, tuple[tuple[int | None, ...], str]]
"""Array name to (shape of one frame, with None for lengths that the manifest does not tell, and dtype)."""


class ShardError(MissingFileError, OSError):
    """A shard that is not laid out as shards are, or is cut off."""

    def __init__(self, path: Path, reason: str, remedy: str = "make the dataset again"):
        super().__init__("a readable shard", path, reason, remedy)


class ArrayLocation(NamedTuple):
    """Where a contiguous array lies in its shard file."""

    offset: int
    shape: tuple[int, ...]
    """of one frame"""
    dtype: np.dtype
    constant: bool
    """whether the array holds one row for all frames"""


def known_arrays(manifest: Mapping[str, Any]) -> Known:
    """Return what a dataset's manifest tells of the arrays in its shards."""
    views, height, width = len(manifest["cameras"]), manifest.get("height"), manifest.get("width")
    image = (views, height, width)
    columns = {f"state/{name}": ((len(names),), "<f4") for name, names in manifest["columns"].items()}
    return {
        "rgb": ((*image, 3), "u1"),
        "depth": (image, "<f4"),
        **dict.fromkeys(("semantic", "valid"), (image, "u1")),
        **dict.fromkeys(("episode", "step"), ((), "<i4")),
        **dict.fromkeys(("split", "success"), ((), "u1")),
        **{f"state/{name}": ((None,), "<f8") for name in ("qpos", "qvel")},
        **{f"state/{name}_pos": ((None, 3), "<f8") for name in ("mocap", "body")},
        **{f"state/{name}_quat": ((None, 4), "<f8") for name in ("mocap", "body")},
        **columns,
        "reward": ((), "<f4"),
        "cameras/intrinsics": ((views, 3, 3), "<f8"),
        "cameras/camera_from_world": ((views, 4, 4), "<f8"),
        "cameras/projection": ((views, 3, 4), "<f8"),
        "cameras/tracking_origin": ((3,), "<f8"),
    }


def locate_arrays(path: Path, frames: int, known: Known) -> dict[str, ArrayLocation]:
    """Return where the arrays of a shard lie.

    Args:
        path: of the shard.
        frames: how many it has, as the manifest says.
        known: what else the manifest says.

    Raises:
        ShardError: the file is damaged, or an array is not what a reader could fetch by its place.
    """
    try:
        size = path.stat().st_size
        with h5py.File(path, "r") as file:
            return {name: _locate(path, name, array, frames, known, size) for name, array in _arrays(path, file)}
    except ShardError:
        raise
    except (OSError, KeyError, ValueError, TypeError, RuntimeError) as error:  # what h5py makes of damaged files
        raise ShardError(path, f"HDF5 cannot read it ({error})") from error


def _arrays(path: Path, group: h5py.Group, prefix: str = "", depth: int = 1) -> Iterator[tuple[str, h5py.Dataset]]:
    for key in group:
        name = f"{prefix}{key}"
        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            raise ShardError(path, f"{name} is a link to somewhere else")
        item = group[key]
        if isinstance(item, h5py.Dataset):
            yield name, item
        elif isinstance(item, h5py.Group):
            if depth == _DEEPEST:
                raise ShardError(path, f"its groups are nested too deeply, at {name}")
            yield from _arrays(path, item, f"{name}/", depth + 1)


def _locate(path: Path, name: str, array: h5py.Dataset, frames: int, known: Known, size: int) -> ArrayLocation:
    constant = name.startswith("cameras/") and array.ndim == 3  # view, row, column: nothing for the frame
    shape = array.shape if constant else array.shape[1:]
    _require_kind(path, name, array, constant, frames, known)
    plan = array.id.get_create_plist()
    length = math.prod(array.shape) * array.dtype.itemsize
    if plan.get_external_count():
        raise ShardError(path, f"{name} lies in another file")
    if plan.get_layout() != h5py.h5d.CONTIGUOUS:
        remedy = f"undo that with: h5repack -l CONTI -f NONE {path} NEW, or make the dataset again"
        raise ShardError(path, f"{name} is not contiguous but in chunks, compressed or virtual", remedy)
    offset = array.id.get_offset()
    if length == 0:
        return ArrayLocation(0, shape, array.dtype, constant)
    if offset is None:
        raise ShardError(path, f"{name} was never written")
    if offset + length > size:
        raise ShardError(path, f"it ends within {name}")
    return ArrayLocation(offset, shape, array.dtype, constant)


def _require_kind(path: Path, name: str, array: h5py.Dataset, constant: bool, frames: int, known: Known) -> None:
    """Raise ShardError unless an array has the numbers and the shape that the manifest says."""
    shape = array.shape if constant else array.shape[1:]
    expected, dtype = known.get(name, ((None,) * len(shape), array.dtype))
    if array.dtype != np.dtype(dtype) or array.dtype.kind not in "iuf" or array.dtype.byteorder == ">":
        wanted = np.dtype(dtype).str if name in known else "little-endian numbers"
        raise ShardError(path, f"{name} holds {array.dtype.str} instead of {wanted}")
    if not _fits(shape, expected) or not (constant or (array.ndim > 0 and array.shape[0] == frames)):
        lengths = "x".join("?" if length is None else str(length) for length in ((frames, *expected)[constant:]))
        found = "x".join(map(str, array.shape)) or "nothing"
        raise ShardError(path, f"{name} has the shape {found} instead of {lengths or 'any'}")


def _fits(shape: Sequence[int], expected: Sequence[int | None]) -> bool:
    return len(shape) == len(expected) and all(
        wanted in (None, length) for length, wanted in zip(shape, expected, strict=True)
    )
