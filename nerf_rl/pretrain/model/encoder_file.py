"""Finding an encoder and reading its description, without loading weights; PyTorch is imported for checkpoints only."""

from pathlib import Path
from typing import Any, get_args

from nerf_rl.cameras.rig_config import MOST_CAMERAS
from nerf_rl.cameras.tracking_frame import TRACKING_FRAME_STRUCTURE
from nerf_rl.datasets.storage.stored_manifest import LARGEST_IMAGE
from nerf_rl.errors import MissingFileError
from nerf_rl.files.json_files import read_json
from nerf_rl.files.structure import array, flag, listing, mapping, number, one_of, optional, table, text, whole
from nerf_rl.hub.fetch import resolve
from nerf_rl.rendering.quality import Quality

WEIGHTS = "encoder.safetensors"
DESCRIPTION = "encoder.json"
CHECKPOINT = Path("checkpoints") / "last.ckpt"
"""in a run's folder"""
FORMAT = 3
_READABLE = (2, FORMAT)  # before 3 no encoder looked for landmarks
_FIRST_FORMAT = 1  # of descriptions that name none
SIMULATORS = ("mujoco", "metaworld")
"""packages that decide what a rendered picture shows"""

_MOST_LAYERS, _MOST_LANDMARKS = 16, 255
_REMEDY = "make one with: nerf-rl pretrain --config pretrain/snerl.yaml --data DATASET --out FOLDER"
_SIZE = whole(1, 2**20)

_STRUCTURE = mapping(
    {
        "format": whole(),
        "architecture": mapping(
            {},
            {
                "latent": _SIZE,
                "patch": _SIZE,
                "channels": listing(_SIZE, 1, _MOST_LAYERS),
                "hidden": _SIZE,
                "landmarks": flag,
            },
        ),
        "rig": mapping(
            {
                "names": listing(text(), 1, MOST_CAMERAS),
                "intrinsics": array(-1, 3, 3),
                "camera_from_world": array(-1, 4, 4),
                "height": whole(1, LARGEST_IMAGE),
                "width": whole(1, LARGEST_IMAGE),
            },
            {"tracking_frame": TRACKING_FRAME_STRUCTURE},
        ),
        "scene": mapping({"name": text(), "quality": one_of(*get_args(Quality))}, {"detail": optional(number(0.0))}),
    },
    {
        "landmarks": whole(0, _MOST_LANDMARKS),
        "classes": listing(text(), 1),
        "palette": array(-1, 3, of=whole(0, 255)),
        "dataset": mapping({}, {"sha256": text()}, others=True),
        "packages": table(text()),
        "renderer": text(),
    },
    others=True,
)


def read_description(path: Path | str) -> tuple[Path, dict[str, Any]]:
    """Return an encoder's run folder and its description, the content of ``encoder.json``.

    A checkpoint carries a description of its own, so that one of a run without an export can be used as well.

    Args:
        path: a run folder, the folder or a file of an exported encoder, a Lightning checkpoint, or an address on the
            Hub (``hf://USER/NAME``).

    Raises:
        MissingFileError: there is no encoder at the path, its description is damaged, or of another format.
        UserError: an address that nothing can be fetched from.
    """
    named, path = path, resolve(path)
    if not path.exists():
        raise MissingFileError("an encoder", named, "it does not exist", _REMEDY)
    candidates = [path] if path.is_dir() else [path.parent, path.parent.parent]
    folder = next((c for c in candidates if (c / DESCRIPTION).is_file() and (c / WEIGHTS).is_file()), None)
    if is_checkpoint(path):
        from nerf_rl.pretrain.model.checkpoint_file import described_encoder

        run = path.parent.parent if path.parent.name == "checkpoints" else path.parent
        return folder or run, _checked(path, path.name, described_encoder(path))
    if folder is None:
        raise MissingFileError("an encoder", named, f"there is no {DESCRIPTION} with its {WEIGHTS}", _REMEDY)
    try:
        description = read_json(folder / DESCRIPTION)
    except (OSError, ValueError) as error:
        raise MissingFileError("an encoder", path, f"its {DESCRIPTION} is damaged ({error})", _REMEDY) from error
    return folder, _checked(path, DESCRIPTION, description)


def described_classes(folder: Path) -> tuple[list[str], list[list[int]]]:
    """Return names and colours of the classes that the radiance field beside an encoder tells apart.

    Args:
        folder: of an exported encoder.

    Raises:
        MissingFileError: its description does not name them, or there is none.
    """
    _, description = read_description(folder)
    names, colours = description.get("classes", []), description.get("palette", [])
    if not names or len(names) != len(colours):
        reason = f"its {DESCRIPTION} does not name the classes and their colours"
        raise MissingFileError("an encoder with its radiance field", folder, reason, _REMEDY)
    return names, colours


def is_checkpoint(path: Path | str) -> bool:
    """Tell whether a path is that of a Lightning checkpoint."""
    return Path(path).suffix == ".ckpt" and Path(path).is_file()


def _checked(path: Path, file: str, description: Any) -> dict[str, Any]:
    """Return a description after a look at its format, which decides on the rest, and at its structure."""
    found = description.get("format", _FIRST_FORMAT) if isinstance(description, dict) else FORMAT
    if found not in _READABLE or isinstance(found, bool):
        reason = f"the format in {file} is {found!r}, this version reads {' and '.join(map(str, _READABLE))}"
        raise MissingFileError(
            "an encoder for this version", path, reason, "train it again, or use the version of then"
        )
    try:
        _STRUCTURE(description, "")
        rig = description["rig"]
        views = {len(rig[what]) for what in ("names", "intrinsics", "camera_from_world")}
        if len(views) > 1:
            raise ValueError("its cameras have different numbers of names, intrinsics and poses")
        if any(matrix[i][i] <= 0 for matrix in rig["intrinsics"] for i in range(3)):
            raise ValueError("a camera's focal length is not positive")
    except ValueError as error:
        raise MissingFileError("an encoder", path, f"its {file} is damaged ({error})", _REMEDY) from error
    return description
