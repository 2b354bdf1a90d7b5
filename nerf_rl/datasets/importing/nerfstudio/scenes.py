"""A folder of nerfstudio scenes as a source: each scene is a moment in time, seen by the same cameras."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy import ndarray

from nerf_rl.datasets.importing.config import NERFSTUDIO, UNKNOWN, ImportConfig
from nerf_rl.datasets.importing.faults import SourceError
from nerf_rl.datasets.importing.nerfstudio.lens import shown, unbend
from nerf_rl.datasets.importing.nerfstudio.transforms import TRANSFORMS, Scene, View, read_scene
from nerf_rl.datasets.importing.picture_files import has_alpha, read_colours, read_numbers, read_opaque
from nerf_rl.datasets.importing.source import BACKGROUND, NO_COLUMNS, Source, SourceEpisode, SourceFrame, no_values
from nerf_rl.datasets.importing.source_files import SourceDigest
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS, STATE


def scene_folders(folder: Path) -> list[Path]:
    """Return the scenes in a folder, by name, or the folder itself if it is one; none if there are none.

    Raises:
        SourceError: one of them lies outside the folder, be it by a link.
    """
    if (folder / TRANSFORMS).is_file():
        return [folder]
    found = sorted(path.parent for path in folder.glob(f"*/{TRANSFORMS}"))
    for scene in found:
        if not (scene / TRANSFORMS).resolve().is_relative_to(folder.resolve()):
            raise SourceError(scene, f"it is a link that leads out of {folder} (cp -rL makes a copy)")
    return found


class ScenesSource(Source):
    """Scenes as frames.

    Args:
        folder: of the scenes.
        config: of the import.

    Raises:
        SourceError: a scene is damaged, or has other cameras, files or classes than the first.
    """

    format = NERFSTUDIO

    def __init__(self, folder: Path, config: ImportConfig):
        self._scale, self._empty_is_unknown = config.scale, config.empty_depth == UNKNOWN
        scenes = [read_scene(path, config.scale) for path in scene_folders(folder)]
        self._scenes = _in_episodes(scenes)
        first = scenes[0]
        self.camera_names = [view.name for view in first.views]
        self.height, self.width = first.views[0].height, first.views[0].width
        self._kinds = set(first.views[0].others)
        for scene in scenes:
            _require_alike(scene, first)
        self.roles = {view.name: view.role for view in first.views if view.role is not None}
        self.intrinsics = np.stack([view.intrinsics for view in first.views])
        poses = np.array([[view.camera_from_world for view in scene.views] for scene in scenes])
        stands = (poses == poses[0]).all((0, 2, 3))
        self.still = {name for name, still in zip(self.camera_names, stands, strict=True) if still}
        self.camera_from_world = poses[0] if stands.all() else None
        self.classes, self.columns = list(first.classes or [BACKGROUND]), NO_COLUMNS
        if "labels" in self._kinds and first.classes is None:
            raise SourceError(first.path, "it has semantic_path but no semantic_classes, which would name the classes")
        held = {DEPTH: "depth" in self._kinds, LABELS: "labels" in self._kinds, STATE: False}
        self.absent = tuple(kind for kind, there in held.items() if not there)
        bent = any(view.lens is not None for view in first.views)
        self.has_invalid = bent or "mask" in self._kinds or (held[DEPTH] and self._empty_is_unknown)
        self.has_invalid |= any(has_alpha(view.colours) for scene in scenes for view in scene.views)
        self.episodes = [SourceEpisode(len(group), _split(group)) for group in self._scenes]
        digest = SourceDigest()
        for scene in (scene for group in self._scenes for scene in group):
            digest.describe(scene.path)
            for view in scene.views:
                for path in (view.colours, *view.others.values()):
                    digest.name(path)
        self.digest = digest.text()
        self._maps: dict[str, tuple[ndarray, ndarray]] = {
            view.name: view.lens.maps(view.intrinsics, view.height, view.width)
            for view in first.views
            if view.lens is not None
        }

    def frames(self, episode: int) -> Iterator[SourceFrame]:
        """Yield the frames of an episode, in order."""
        for place, scene in enumerate(self._scenes[episode]):
            seen = [self._read(view, scene) for view in scene.views]
            stacked = {kind: np.stack([view[kind] for view in seen]) for kind in seen[0]}
            yield SourceFrame(
                str(scene.path.parent),
                int(scene.source.get("step", place)),
                stacked["colours"],
                stacked.get("depth"),
                stacked.get("labels"),
                stacked.get("valid"),
                None if self.camera_from_world is not None else np.stack([v.camera_from_world for v in scene.views]),
                no_values(),
            )

    def _read(self, view: View, scene: Scene) -> dict[str, ndarray]:
        """Return what a view shows, by kind."""
        size = view.height, view.width
        found = {"colours": read_colours(view.colours, *size)}
        for kind, dtype in (("depth", np.uint16), ("labels", np.uint8), ("mask", np.uint8)):
            if kind in view.others:
                found[kind] = read_numbers(view.others[kind], *size, dtype)
        if has_alpha(view.colours):
            opaque = np.where(read_opaque(view.colours, *size), 255, 0).astype(np.uint8)
            found["mask"] = np.minimum(found.get("mask", opaque), opaque)
        valid = np.ones(size, bool)
        if view.name in self._maps:
            found = {kind: unbend(picture, self._maps[view.name]) for kind, picture in found.items()}
            valid = shown(self._maps[view.name], *size)
        if "mask" in found:
            valid &= found.pop("mask") > 0
        if "labels" in found and found["labels"].max() >= len(self.classes):
            most = f"the class {found['labels'].max()}, and {scene.path.name} names {len(self.classes)}"
            raise SourceError(view.others["labels"], f"it shows {most}")
        if "depth" in found:
            units = found["depth"]
            metres = units * (view.unit * self._scale)
            found["depth"] = np.where(units > 0, metres, np.inf).astype(np.float32)
            if self._empty_is_unknown:
                valid &= units > 0
        return found | ({"valid": valid} if self.has_invalid else {})


def _in_episodes(scenes: list[Scene]) -> list[list[Scene]]:
    """Return the scenes of each episode, in order.

    Scenes that were exported from one dataset say of which episode and frame they are; others are one each. Steps tell
    no order, since an environment that ends within an episode counts them anew.

    Raises:
        SourceError: two scenes are of one frame.
    """
    known = all("episode" in scene.source and "step" in scene.source for scene in scenes)
    if not known or len({scene.source.get("dataset") for scene in scenes}) > 1:
        return [[scene] for scene in scenes]
    episodes: dict[int, list[Scene]] = {}
    for scene in sorted(scenes, key=_moment):
        group = episodes.setdefault(scene.source["episode"], [])
        if group and _moment(group[-1]) == _moment(scene):
            raise SourceError(scene.path, f"it is of the same moment as {group[-1].path}")
        group.append(scene)
    return list(episodes.values())


def _moment(scene: Scene) -> tuple[int, int]:
    """Return the episode of a scene and what orders it within: its frame or, where that is not known, its step."""
    return scene.source["episode"], scene.source.get("frame", scene.source["step"])


def _split(scenes: list[Scene]) -> str | None:
    named = {scene.source.get("split") for scene in scenes}
    return named.pop() if len(named) == 1 else None


def _require_alike(scene: Scene, first: Scene) -> None:
    """Raise SourceError unless a scene has the cameras of the first: names, sizes, intrinsics, files and classes."""
    names, others = ([view.name for view in one.views] for one in (scene, first))
    if names != others:
        odd = sorted({*names} ^ {*others})[0]
        counts = f"{len(names)} views and {first.path} {len(others)}"
        raise SourceError(scene.path, f"it has {counts}, and only one has a camera {odd}; all scenes need the same")
    kinds, size = set(first.views[0].others), (first.views[0].height, first.views[0].width)
    for view, like in zip(scene.views, first.views, strict=True):
        if (view.height, view.width) != size:
            raise SourceError(
                scene.path, f"camera {view.name} has {view.width} x {view.height} pixels, others {size[1]} x {size[0]}"
            )
        if set(view.others) != kinds:
            odd = sorted({*view.others} ^ kinds)[0]
            raise SourceError(scene.path, f"all views need {odd} or none, unlike {view.name} here and in {first.path}")
        if not np.allclose(view.intrinsics, like.intrinsics, atol=1e-6) or view.lens != like.lens:
            raise SourceError(scene.path, f"camera {view.name} has other intrinsics than in {first.path}")
    if scene.classes != first.classes:
        raise SourceError(scene.path, f"it has other semantic_classes than {first.path}")
