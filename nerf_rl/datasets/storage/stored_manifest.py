"""Reading a manifest that somebody handed in: its structure, said in one place, and what is missing in it.

Shards are named ``shards/NNNNNN.h5`` and nothing else, so that no manifest can lead a reader out of its folder. A file
of that name may be a link: where the bytes of a dataset lie is for the owner of the folder to say.
"""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from nerf_rl.cameras.rig_config import MOST_CAMERAS
from nerf_rl.cameras.tracking_frame import TRACKING_FRAME_STRUCTURE
from nerf_rl.errors import MissingFileError
from nerf_rl.files.structure import array, listing, mapping, number, one_of, optional, table, text, whole
from nerf_rl.rendering.quality import Quality

LARGEST_IMAGE = 16384  # [pixels]
MOST_CLASSES = 256  # labels are bytes
ROLES = ("encoder", "supervision", "test")
IMPORTED_FROM = "imported_from"
"""key of an imported dataset's configuration: the format of its source; others are rendered"""
EPISODE_FRAMES = "episode_frames"
"""key of an imported dataset's configuration: how many frames each episode has; rendered ones have equally many"""
DEPTH, LABELS, STATE = "depth", "labels", "state"
MODALITIES = (DEPTH, LABELS, STATE)
"""what a dataset may lack beside its pictures; of depth and labels, such a dataset holds an empty filling"""
JOINT_NUMBERS = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
"""how many numbers of ``qpos`` a joint has, by its kind"""

_NAME = text()
_RENDERED = mapping({"episodes": whole(1), "frames_per_episode": whole(1), "episodes_per_shard": whole(1)}, others=True)
_FRAMES_OF_EPISODES = listing(whole(1), 1)
_IMPORTED = mapping(
    {IMPORTED_FROM: _NAME, EPISODE_FRAMES: _FRAMES_OF_EPISODES, "episodes_per_shard": whole(1)}, others=True
)
_SHARD = mapping(
    {"file": text(r"shards/\d{6,9}\.h5", "the name of a shard, shards/NNNNNN.h5"), "frames": whole(1)},
    {"sha256": _NAME},
    others=True,
)


def content_keys(value: Any, place: str) -> None:
    """Check of a dataset's configuration what tells how many frames its shards have."""
    (_IMPORTED if isinstance(value, dict) and IMPORTED_FROM in value else _RENDERED)(value, place)


def _config(value: Any, place: str) -> None:
    content_keys(value, place)
    if IMPORTED_FROM not in value:
        mapping({"quality": one_of(*get_args(Quality))}, others=True)(value, place)


MANIFEST_STRUCTURE = mapping(
    {"schema_version": whole()},
    {
        "shards": listing(_SHARD),
        "cameras": listing(mapping({"name": _NAME, "role": one_of(*ROLES)}, others=True), 1, MOST_CAMERAS),
        "classes": listing(mapping({"name": _NAME, "colour": array(3, of=whole(0, 255))}), 1, MOST_CLASSES),
        "columns": mapping({kind: listing(_NAME) for kind in ("proprio", "privileged", "action")}, others=True),
        "config": _config,
        "absent": listing(one_of(*MODALITIES)),
        "scene": mapping({"name": _NAME}, others=True),
        "packages": table(_NAME),
        "height": whole(1, LARGEST_IMAGE),
        "width": whole(1, LARGEST_IMAGE),
        "far": optional(number(0.0)),
        "detail": optional(number(0.0)),
        "joints": listing(mapping({"name": _NAME, "kind": one_of(*JOINT_NUMBERS)})),
        "bodies": listing(_NAME),
        "tracking_frame": TRACKING_FRAME_STRUCTURE,
        "renderer": _NAME,
        "frames": whole(),
        "checksum": _NAME,
    },
    others=True,
)
"""What keys hold; one that is missing is told when it is needed."""


def total_frames(config: Mapping[str, Any]) -> int:
    """Return how many frames a dataset has.

    Args:
        config: of the dataset, as its manifest has it.
    """
    if IMPORTED_FROM in config:
        return sum(config[EPISODE_FRAMES])
    return config["episodes"] * config["frames_per_episode"]


def frames_of_shard(config: Mapping[str, Any], shard: int) -> int:
    """Return how many frames a shard of a dataset has; 0 if the dataset has no such shard."""
    count = config["episodes_per_shard"]
    if IMPORTED_FROM in config:
        return sum(config[EPISODE_FRAMES][shard * count : (shard + 1) * count])
    return max(0, min(count, config["episodes"] - shard * count)) * config["frames_per_episode"]


class StoredManifest(dict[str, Any]):
    """A manifest; what it does not hold is told by the name of its file."""

    def __init__(self, path: Path, content: dict[str, Any]):
        super().__init__(content)
        self._path = path

    def __missing__(self, key: str) -> Any:
        remedy = f"mend it with: nerf-rl check {shlex.quote(str(self._path.parent))} --repair true"
        raise MissingFileError("a whole manifest", self._path, f"it does not say {key}", remedy)

    def __reduce__(self) -> tuple[Any, ...]:
        return StoredManifest, (self._path, dict(self))
