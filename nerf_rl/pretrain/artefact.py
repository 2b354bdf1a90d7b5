"""Finding an exported encoder and reading its description, without loading weights or importing PyTorch."""

from pathlib import Path
from typing import Any

from nerf_rl.errors import MissingFileError
from nerf_rl.runs import read_json

WEIGHTS = "encoder.safetensors"
DESCRIPTION = "encoder.json"


def read_description(path: Path | str) -> tuple[Path, dict[str, Any]]:
    """Return the folder of an exported encoder and the content of its ``encoder.json``.

    Args:
        path: a run folder, the folder or a file of an exported encoder, or a Lightning checkpoint in a run folder.

    Raises:
        MissingFileError: there is no encoder at the path, or its description is damaged.
    """
    path = Path(path)
    remedy = "make one with: nerf-rl pretrain --config pretrain/snerl.yaml --data DATASET --out FOLDER"
    if not path.exists():
        raise MissingFileError("an encoder", path, "it does not exist", remedy)
    candidates = [path] if path.is_dir() else [path.parent, path.parent.parent]
    folder = next((c for c in candidates if (c / DESCRIPTION).is_file() and (c / WEIGHTS).is_file()), None)
    if folder is None:
        raise MissingFileError("an encoder", path, f"there is no {DESCRIPTION} with its {WEIGHTS}", remedy)
    try:
        description = read_json(folder / DESCRIPTION)
        for key in ("architecture", "rig", "scene"):
            description[key]
    except (ValueError, KeyError, TypeError) as error:
        raise MissingFileError("an encoder", path, f"its {DESCRIPTION} is damaged", remedy) from error
    return folder, description
