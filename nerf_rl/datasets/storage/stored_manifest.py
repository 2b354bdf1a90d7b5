"""Reading a manifest that somebody handed in: its structure, said in one place, and what is missing in it.

Shards are named ``shards/NNNNNN.h5`` and nothing else, so that no manifest can lead a reader out of its folder. A file
of that name may be a link: where the bytes of a dataset lie is for the owner of the folder to say.
"""

from pathlib import Path
from typing import Any

from nerf_rl.cameras.rig_config import MOST_CAMERAS
from nerf_rl.cameras.tracking_frame import TRACKING_FRAME_STRUCTURE
from nerf_rl.errors import MissingFileError
from nerf_rl.files.structure import array, listing, mapping, number, one_of, optional, table, text, whole

LARGEST_IMAGE = 16384  # [pixels]
_MOST_CLASSES = 256  # labels are bytes
ROLES = ("encoder", "supervision", "test")
COUNTS = {"episodes": whole(1), "frames_per_episode": whole(1), "episodes_per_shard": whole(1)}
"""of a dataset's configuration: what tells how many frames its shards have"""
JOINT_NUMBERS = {"free": 7, "ball": 4, "slide": 1, "hinge": 1}
"""how many numbers of ``qpos`` a joint has, by its kind"""

_NAME = text()
_SHARD = mapping(
    {"file": text(r"shards/\d{6,9}\.h5", "the name of a shard, shards/NNNNNN.h5"), "frames": whole(1)},
    {"sha256": _NAME},
    others=True,
)

MANIFEST_STRUCTURE = mapping(
    {"schema_version": whole()},
    {
        "shards": listing(_SHARD),
        "cameras": listing(mapping({"name": _NAME, "role": one_of(*ROLES)}, others=True), 1, MOST_CAMERAS),
        "classes": listing(mapping({"name": _NAME, "colour": array(3, of=whole(0, 255))}), 1, _MOST_CLASSES),
        "columns": mapping({kind: listing(_NAME) for kind in ("proprio", "privileged", "action")}, others=True),
        "config": mapping({**COUNTS, "quality": one_of("fast", "full")}, others=True),
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


class StoredManifest(dict[str, Any]):
    """A manifest; what it does not hold is told by the name of its file."""

    def __init__(self, path: Path, content: dict[str, Any]):
        super().__init__(content)
        self._path = path

    def __missing__(self, key: str) -> Any:
        remedy = f"mend it with: nerf-rl check {self._path.parent} --repair true"
        raise MissingFileError("a whole manifest", self._path, f"it does not say {key}", remedy)

    def __reduce__(self) -> tuple[Any, ...]:
        return StoredManifest, (self._path, dict(self))
