"""Neighbouring episodes in one file of each kind: numbers, and videos of each camera's colours, depth and labels."""

import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from nerf_rl.datasets.export.lerobot.depth_codes import TOPMOST
from nerf_rl.datasets.export.lerobot.episodes import Episode
from nerf_rl.datasets.export.lerobot.features import columns
from nerf_rl.datasets.export.lerobot.files import DATA, LABELS, MOST_SECONDS, MOST_VIDEO_MB, VIDEO, file_path, place
from nerf_rl.datasets.export.lerobot.plan import ExportedCamera, Plan, blocks
from nerf_rl.datasets.export.lerobot.statistics import Statistics, of_histograms, of_values
from nerf_rl.datasets.export.lerobot.tables import open_frames
from nerf_rl.datasets.export.lerobot.videos import DEPTH, Codec, Video, colours, open_video
from nerf_rl.datasets.export.lerobot.videos import LABELS as LABEL_CODEC
from nerf_rl.machine.cores import usable_cores

_COUNTED = 150  # pixels along an edge that statistics look at, as LeRobot's do
_BYTES = np.linspace(0.0, 1.0, 256)
Counts = Int[ndarray, "C L"]


class Part:
    """Files that are being written; made by :func:`open_part`."""

    def __init__(self, plan: Plan, number: int, videos: dict[str, Video], append: Callable):
        self._plan, self._number, self._videos, self._append = plan, number, videos, append
        self._frames = 0
        self._pool = ThreadPoolExecutor(usable_cores())

    def has_room(self, episode: Episode) -> bool:
        """Tell whether another episode fits; the first one always does."""
        if self._frames == 0:
            return True
        longest = (self._frames + episode.transitions) / self._plan.fps
        largest = max(video.size for video in self._videos.values())
        return longest <= MOST_SECONDS and largest < MOST_VIDEO_MB << 20

    def add(self, index: int, episode: Episode, first: int) -> dict[str, Any]:
        """Write an episode and return its row in the table of episodes.

        Args:
            index: of the episode in the export.
            episode: to write.
            first: how many frames of the export are before it.
        """
        plan, T = self._plan, episode.transitions
        values = columns(plan, index, episode, first)
        found: dict[str, Statistics] = self._write_pictures(episode)
        self._append(values)
        found |= {key: of_values(value) for key, value in values.items()}
        row: dict[str, Any] = {
            "episode_index": index,
            "tasks": [plan.task],
            "length": T,
            "source/episode": episode.number,
            "source/split": episode.split,
            "dataset_from_index": first,
            "dataset_to_index": first + T,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        row |= {f"data/{name}": number for name, number in place(self._number).items()}
        span = {"from_timestamp": self._frames / plan.fps, "to_timestamp": (self._frames + T) / plan.fps}
        for key in _video_keys(plan):
            row |= {f"videos/{key}/{name}": number for name, number in (place(self._number) | span).items()}
        for key, statistics in found.items():
            row |= {f"stats/{key}/{name}": value.tolist() for name, value in statistics.items()}
        self._frames += T
        return row

    def close(self) -> None:
        """Wait for what is being encoded."""
        self._pool.shutdown(cancel_futures=True)

    def _write_pictures(self, episode: Episode) -> dict[str, Statistics]:
        plan = self._plan
        counts: dict[str, Any] = defaultdict(int)
        for block in blocks(episode.states[:-1], plan.dataset):
            rgb = plan.dataset.read("rgb", block)
            labels = plan.dataset.read_labels(block) if plan.has_labels else None
            depth = plan.dataset.read("depth", block) if plan.cameras[0].codes is not None else None
            work: dict[str, Callable[[], Counts | None]] = {}
            for camera in plan.cameras:
                view = camera.view
                work[camera.image_key] = partial(_write_colours, self._videos[camera.image_key], rgb[:, view])
                if labels is not None:
                    work[_labels(camera)] = partial(_write_labels, self._videos[_labels(camera)], labels[:, view])
                if depth is not None:
                    video = self._videos[camera.depth_key]
                    work[camera.depth_key] = partial(_write_depth, video, depth[:, view], camera, plan.hit)
            started = {key: self._pool.submit(task) for key, task in work.items()}
            for key, future in started.items():
                counted = future.result()
                if counted is not None:
                    counts[key] += counted
        levels = {
            camera.depth_key: camera.codes.decode(np.arange(TOPMOST + 1)) for camera in plan.cameras if camera.codes
        }
        return {key: of_histograms(c, levels.get(key, _BYTES), episode.transitions) for key, c in counts.items()}


@contextlib.contextmanager
def open_part(folder: Path, plan: Plan, number: int) -> Iterator[Part]:
    """Give files to write episodes to; each exists whole or not at all.

    Args:
        folder: of the export.
        plan: what is exported.
        number: of the files, from 0.
    """
    height, width = plan.dataset.manifest["height"], plan.dataset.manifest["width"]
    with contextlib.ExitStack() as stack:
        videos: dict[str, Video] = {}

        def add(key: str, pattern: str, folder_key: str, codec: Codec) -> None:
            path = file_path(folder, pattern, number, folder_key)
            videos[key] = stack.enter_context(open_video(path, codec, height, width, plan.fps))

        for camera in plan.cameras:
            add(camera.image_key, VIDEO, camera.image_key, colours(height, width))
            if plan.has_labels:
                add(_labels(camera), LABELS, camera.image_key, LABEL_CODEC)
            if camera.codes is not None:
                add(camera.depth_key, VIDEO, camera.depth_key, DEPTH)
        append = stack.enter_context(open_frames(file_path(folder, DATA, number)))
        part = Part(plan, number, videos, append)
        stack.callback(part.close)  # before any file is closed, also when an error ends the export
        yield part


def _video_keys(plan: Plan) -> list[str]:
    keys = [camera.image_key for camera in plan.cameras]
    return keys + [camera.depth_key for camera in plan.cameras if camera.codes is not None]


def _labels(camera: ExportedCamera) -> str:
    return f"labels of {camera.image_key}"


def _write_colours(video: Video, rgb: ndarray) -> Counts:
    video.append(rgb)
    seen = _thinned(rgb)
    return np.stack([np.bincount(seen[..., channel].ravel(), minlength=256) for channel in range(3)])


def _write_labels(video: Video, labels: ndarray) -> None:
    video.append(labels)


def _write_depth(video: Video, depth: ndarray, camera: ExportedCamera, hit: float) -> Counts:
    assert camera.codes is not None
    codes = camera.codes.encode(depth, hit)
    video.append(codes)
    return np.bincount(_thinned(codes).ravel(), minlength=TOPMOST + 1)[None]


def _thinned(pictures: ndarray) -> ndarray:
    """Return every so manieth pixel of [T, H, W, ...]."""
    step = max(1, round(max(pictures.shape[1:3]) / _COUNTED))
    return pictures[:, ::step, ::step]
