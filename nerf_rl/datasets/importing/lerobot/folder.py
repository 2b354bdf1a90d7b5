"""A LeRobotDataset with camera matrices as a source, as ``nerf-rl export --format lerobot`` writes it."""

import contextlib
import math
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.export.lerobot.depth_codes import TOPMOST
from nerf_rl.datasets.export.lerobot.files import CAMERAS, INFO, LABELS, VIDEO, file_path
from nerf_rl.datasets.importing.camera_matrices import camera_from_pose
from nerf_rl.datasets.importing.config import LEROBOT, ImportConfig
from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.datasets.importing.lerobot.description import Camera, describe
from nerf_rl.datasets.importing.lerobot.tables import Episode, FrameTables, read_episodes
from nerf_rl.datasets.importing.lerobot.videos import COLOURS, DEPTH, read_pictures
from nerf_rl.datasets.importing.lerobot.videos import LABELS as LABEL_PIXELS
from nerf_rl.datasets.importing.source import BACKGROUND, Source, SourceEpisode, SourceFrame
from nerf_rl.datasets.importing.source_files import SourceDigest, file_inside
from nerf_rl.datasets.storage import stored_manifest
from nerf_rl.datasets.storage.frames import position_columns
from nerf_rl.machine.extras import import_extra

_GROUPS = {"proprio": "observation.state", "privileged": "privileged_state", "action": "action"}
_MOST_COLUMNS = 4096
_REWARD, _SUCCESS = "next.reward", "next.success"


class LeRobotSource(Source):
    """Episodes of a LeRobotDataset.

    Args:
        folder: of the dataset.
        config: of the import.

    Raises:
        SourceError: it is damaged, or does not say where its cameras are.
        UserError: PyArrow or PyAV is not installed.
    """

    format = LEROBOT

    def __init__(self, folder: Path, config: ImportConfig):
        import_extra("av", "lerobot", "an import from LeRobot")  # told before anything is written
        self._described, self._scale = describe(folder, config.scale), config.scale
        self._episodes = read_episodes(self._described)
        cameras, features = self._described.cameras, self._described.features
        self.camera_names = [camera.name for camera in cameras]
        self.roles = {camera.name: camera.role for camera in cameras if camera.role is not None}
        self.intrinsics = np.stack([camera.intrinsics for camera in cameras])
        self.height, self.width = self._described.height, self._described.width
        fixed = [camera.camera_from_world for camera in cameras if camera.camera_from_world is not None]
        self.still = {camera.name for camera in cameras if camera.camera_from_world is not None}
        self.camera_from_world = np.stack(fixed) if len(fixed) == len(cameras) else None
        self.columns = {group: _names(folder / INFO, key, features.get(key)) for group, key in _GROUPS.items()}
        keys = [key for group, key in _GROUPS.items() if self.columns[group]]
        moving = [camera.pose_key for camera in cameras if camera.pose_key is not None]
        self._tables = FrameTables(self._described, [*keys, *moving], [_REWARD, _SUCCESS])
        self._has_labels = self._labels_are_there()
        named = self._described.classes
        if self._has_labels and named is None:
            raise SourceError(folder / CAMERAS, "it names no classes, and there are labels")
        entries = [{"name": entry["name"], "colour": entry["colour"]} for entry in named or ()]
        self.classes = entries if self._has_labels else [BACKGROUND]
        there = {
            stored_manifest.DEPTH: cameras[0].codes is not None,
            stored_manifest.LABELS: self._has_labels,
            stored_manifest.STATE: bool(self.columns["privileged"]),
        }
        self.absent = tuple(kind for kind, is_there in there.items() if not is_there)
        self.has_invalid = False
        self.episodes = [SourceEpisode(episode.length, episode.split) for episode in self._episodes]
        digest = SourceDigest()
        for name in (INFO, CAMERAS):
            digest.describe(folder / name)
        for kind in ("meta", "data", "videos", "labels"):
            for path in sorted((folder / kind).rglob("*")):
                if path.is_file():
                    digest.name(path)
        self.digest = digest.text()

    def frames(self, episode: int) -> Iterator[SourceFrame]:
        """Yield the frames of an episode, in order."""
        found, cameras = self._episodes[episode], self._described.cameras
        rows = self._tables.read(found)
        # a state says what the step that led to it gave, a frame what the step from it will give
        rewards, successes = (_of_the_step_before(rows.get(key), found.length) for key in (_REWARD, _SUCCESS))
        with contextlib.ExitStack() as stack:
            views = [self._open(stack, found, camera) for camera in cameras]
            for step in range(found.length):
                seen = [{kind: next(pictures) for kind, pictures in view.items()} for view in views]
                stacked = {kind: np.stack([view[kind] for view in seen]) for kind in seen[0]}
                labels = stacked.get("labels")
                if labels is not None and labels.max() >= len(self.classes):
                    most = f"a class {labels.max()}, and {CAMERAS} names {len(self.classes)}"
                    raise SourceError(self._described.folder, f"episode {episode} shows {most}")
                yield SourceFrame(
                    f"{self._described.folder}, episode {episode}",
                    step,
                    stacked["colours"],
                    stacked.get("depth"),
                    labels,
                    None,
                    None if self.camera_from_world is not None else self._poses(rows, step),
                    {group: self._values(rows, key, step) for group, key in _GROUPS.items()},
                    float(rewards[step]),
                    bool(successes[step]),
                )

    def _values(self, rows: dict[str, ndarray], key: str, step: int) -> ndarray:
        if key not in rows:
            return np.zeros(0, np.float32)
        values = rows[key][step].reshape(-1).astype(np.float64)
        if self._scale != 1.0 and key == _GROUPS["privileged"]:
            values[position_columns(self.columns["privileged"])] *= self._scale
        return values.astype(np.float32)

    def _poses(self, rows: dict[str, ndarray], step: int) -> Float[ndarray, "V 4 4"]:
        """Return where the cameras are at a step."""
        poses = []
        for camera in self._described.cameras:
            if camera.pose_key is None:
                assert camera.camera_from_world is not None
                poses.append(camera.camera_from_world)
                continue
            try:
                poses.append(camera_from_pose(rows[camera.pose_key][step], self._scale))
            except ValueError as error:
                raise SourceError(self._described.folder, f"{error} ({camera.pose_key}, step {step})") from error
        return np.stack(poses)

    def _open(self, stack: contextlib.ExitStack, episode: Episode, camera: Camera) -> dict[str, Iterator[ndarray]]:
        """Return what yields a camera's pictures of an episode, by kind."""

        def pictures(pattern: str, key: str, place: str, pixels: str) -> Generator[ndarray, None, None]:
            number, begin = episode.videos[place]
            path = file_path(self._described.folder, pattern, number, key)
            path = file_inside(self._described.folder, str(path.relative_to(self._described.folder)), path)
            size = self.height, self.width
            found = read_pictures(path, pixels, size, begin, episode.length, self._described.fps)
            return stack.enter_context(contextlib.closing(found))

        opened: dict[str, Iterator[ndarray]] = {"colours": pictures(VIDEO, camera.image_key, camera.image_key, COLOURS)}
        if self._has_labels:
            opened["labels"] = pictures(LABELS, camera.image_key, camera.image_key, LABEL_PIXELS)
        if camera.depth_key is not None:
            coded = pictures(VIDEO, camera.depth_key, camera.depth_key, DEPTH)
            opened["depth"] = (_depth(codes, camera) for codes in coded)
        return opened

    def _labels_are_there(self) -> bool:
        """Tell whether there are labels: of all cameras or of none, by the files of the first episode."""
        folder, first = self._described.folder, self._episodes[0]
        there = {
            file_path(folder, LABELS, first.videos[camera.image_key][0], camera.image_key).is_file()
            for camera in self._described.cameras
        }
        if len(there) > 1:
            raise SourceError(folder / "labels", "some of the cameras have labels and some have none")
        return there.pop()


def _depth(codes: ndarray, camera: Camera) -> ndarray:
    """Return planar depth [m], infinite where nothing was hit."""
    assert camera.codes is not None
    return np.where(codes < TOPMOST, camera.codes.decode(codes), np.inf).astype(np.float32)


def _of_the_step_before(values: ndarray | None, length: int) -> ndarray:
    """Return what led to each of T states from what each step gave; nothing led to the first."""
    if values is None:
        return np.zeros(length)
    return np.concatenate([[0], values.reshape(length).astype(np.float64)[:-1]])


def _names(path: Path, key: str, feature: dict[str, Any] | None) -> list[str]:
    """Return the names of a feature's numbers; none if there is no such feature."""
    if feature is None:
        return []
    count, names = math.prod(feature["shape"]), feature.get("names")
    if count > _MOST_COLUMNS:
        raise SourceError(path, f"{key} has {count} numbers; at most {_MOST_COLUMNS} are read")
    if isinstance(names, list) and len(names) == count and all(_is_name(name) for name in names):
        return names
    return [f"{key.rpartition('.')[2]}_{i}" for i in range(count)]


def _is_name(name: Any) -> bool:
    return isinstance(name, str) and name.isprintable()
