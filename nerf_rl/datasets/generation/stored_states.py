"""States stored earlier, to be rendered again: those of a dataset, or trajectories in a NumPy archive."""

import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from numpy.lib.npyio import NpzFile

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, UNFINISHED
from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.scenes.base import Scene
from nerf_rl.scenes.imported import require_simulator

_KEPT = ("state/action", "reward", "success")
_NAMED = ("proprio", "privileged")
_MODEL = ("state/body_pos", "state/body_quat")
_STATE = ("state/qpos", "state/qvel", "state/mocap_pos", "state/mocap_quat")
_UNREADABLE = (OSError, EOFError, ValueError, RuntimeError, zipfile.BadZipFile, zlib.error)  # as zipfile and NumPy say

Row = Mapping[str, ndarray]
"""Arrays of a dataset's shard for one state, ``step`` and ``state/qpos`` at least."""


@runtime_checkable
class StoredStates(Protocol):
    """Trajectories, each a sequence of states."""

    def trajectories(self) -> int:
        """Return how many there are."""

    def shortest(self) -> int:
        """Return the number of states of the shortest one."""

    def rows(self, trajectory: int, count: int) -> Iterator[Row]:
        """Return the first states of a trajectory."""


def open_states(path: Path, scene: Scene) -> StoredStates:
    """Return the stored states of a dataset's folder, or of an .npz archive, that a scene can be put into.

    Raises:
        UserError: there is nothing of the kind, or it belongs to another model.
    """
    if (path / MANIFEST).is_file():
        return _DatasetStates(path, scene)
    if path.suffix == ".npz" and path.is_file():
        return _ArchiveStates(path, scene)
    if (path / UNFINISHED).is_file():
        raise MissingFileError(
            "a source of states", path, "a dataset that is not finished", "complete it by gen-dataset --resume true"
        )
    raise MissingFileError(
        "a source of states", path, "neither a dataset nor an .npz file", "give --behaviour.states one of the two"
    )


def restore_state(scene: Scene, row: Row) -> None:
    """Put a scene into a stored state."""
    model = scene.model
    if "state/body_pos" in row:
        model.body_pos[:], model.body_quat[:] = row["state/body_pos"], row["state/body_quat"]
    mocap = (row["state/mocap_pos"], row["state/mocap_quat"]) if "state/mocap_pos" in row else (None, None)
    scene.set_state(row["state/qpos"], row.get("state/qvel", np.zeros(model.nv)), *mocap)


class _DatasetStates:
    """The episodes of a dataset; columns that have the same names here are taken over."""

    def __init__(self, folder: Path, scene: Scene):
        self._dataset = MultiViewDataset(folder)
        require_simulator(self._dataset.manifest["scene"]["name"])
        widths = [self._dataset.read(name, [0]).shape[1:] for name in (*_STATE, *_MODEL)]
        model = scene.model
        own = [(model.nq,), (model.nv,), (model.nmocap, 3), (model.nmocap, 4), (model.nbody, 3), (model.nbody, 4)]
        if widths != own:
            raise UserError(f"the states in {folder} belong to another model than {scene.name}: {widths}, not {own}")
        columns = zip(_NAMED, (scene.proprio_names, scene.privileged_names), strict=True)
        same = [f"state/{kind}" for kind, names in columns if list(self._dataset.columns(kind)) == list(names)]
        self._arrays = ("step", *_STATE, *_MODEL, *_KEPT, *same)
        episode = self._dataset.read("episode", np.arange(len(self._dataset)))
        self._ends = [*(np.flatnonzero(np.diff(episode)) + 1).tolist(), len(episode)]

    def trajectories(self) -> int:
        return len(self._ends)

    def shortest(self) -> int:
        return int(np.diff([0, *self._ends]).min())

    def rows(self, trajectory: int, count: int) -> Iterator[Row]:
        first = self._ends[trajectory - 1] if trajectory else 0
        frames = np.arange(first, first + count)
        arrays = {name: self._dataset.read(name, frames) for name in self._arrays}
        for i in range(count):
            yield {name: array[i] for name, array in arrays.items()}


class _ArchiveStates:
    """An archive with ``qpos`` [T, nq] or [E, T, nq], and perhaps ``qvel``, ``mocap_pos`` and ``mocap_quat``."""

    def __init__(self, path: Path, scene: Scene):
        model = scene.model
        shapes = {
            "qpos": (model.nq,),
            "qvel": (model.nv,),
            "mocap_pos": (model.nmocap, 3),
            "mocap_quat": (model.nmocap, 4),
        }
        try:
            archive = np.load(path, allow_pickle=False)
            if not isinstance(archive, NpzFile):
                raise ValueError("it holds a single array, as .npy files do")
            with archive:
                found = {name: np.asarray(archive[name], np.float64) for name in shapes if name in archive.files}
        except _UNREADABLE as error:
            raise MissingFileError("a source of states", path, str(error), "save it with numpy.savez") from error
        if "qpos" not in found:
            raise UserError(f"{path} has no array qpos; it needs qpos [T, nq] or [E, T, nq], and may have qvel")
        if ("mocap_pos" in found) != ("mocap_quat" in found):
            raise UserError(f"{path} needs both of mocap_pos and mocap_quat, or neither")
        self._states = {name: self._trajectories(path, name, found[name], shapes[name]) for name in found}
        if len({array.shape[:2] for array in self._states.values()}) > 1:
            raise UserError(f"the arrays in {path} differ in their numbers of episodes or steps")

    def _trajectories(self, path: Path, name: str, array: ndarray, row: tuple[int, ...]) -> Float[ndarray, "E T *R"]:
        if array.ndim == 1 + len(row):
            array = array[None]
        if array.shape[2:] != row or 0 in array.shape[:2]:
            raise UserError(
                f"{name} in {path} has shape {array.shape}, the model needs [T, {', '.join(map(str, row))}]"
            )
        if not np.isfinite(array).all():
            raise UserError(f"{name} in {path} holds values that are not finite")
        return array

    def trajectories(self) -> int:
        return len(self._states["qpos"])

    def shortest(self) -> int:
        return self._states["qpos"].shape[1]

    def rows(self, trajectory: int, count: int) -> Iterator[Row]:
        for step in range(count):
            row = {f"state/{name}": array[trajectory, step] for name, array in self._states.items()}
            yield {"step": np.array(step), **row}
