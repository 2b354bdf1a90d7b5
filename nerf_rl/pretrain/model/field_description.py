"""The description of a radiance field, ``field.json``, which somebody may hand in."""

from pathlib import Path
from typing import Any

from nerf_rl.errors import MissingFileError
from nerf_rl.files.json_files import read_json
from nerf_rl.files.structure import array, mapping, number, optional, whole

WEIGHTS, DESCRIPTION = "field.safetensors", "field.json"
FORMAT = 4
_READABLE = (2, 3, FORMAT)  # before 3 no field had planes that move, before 4 none a box of all that is seen
_FIRST_FORMAT = 1  # of descriptions that name none

_SIZE = whole(1, 2**20)
_STRUCTURE = mapping(
    {
        "config": mapping(
            {},
            {
                "width": _SIZE,
                "layers": whole(1, 64),
                "frequencies": whole(0, 64),
                "free_frames": whole(0, 2**10),
                "plane_size": _SIZE,
                "object_plane_size": whole(0, 2**20),
                "plane_features": _SIZE,
            },
        ),
        "bounds": mapping(
            {"near": number(1e-9), "far": number(1e-9), "centre": array(3), "half_extent": number(1e-9)},
            {"low": optional(array(3)), "high": optional(array(3))},
        ),
        "latent": _SIZE,
        "classes": whole(1, 256),
        "teacher_features": whole(0, 2**16),
        "anchors": whole(0, 256),
    },
    {"format": whole()},
)


def read_field_description(folder: Path) -> dict[str, Any]:
    """Return the content of ``field.json``.

    Raises:
        MissingFileError: there is none, it is damaged, or of another format.
    """
    remedy = "give the run folder that pretrain wrote, or train again"
    path = folder / DESCRIPTION
    try:
        described = read_json(path)
        found = described.get("format", _FIRST_FORMAT) if isinstance(described, dict) else FORMAT
        if found not in _READABLE or isinstance(found, bool):
            older = ", ".join(map(str, _READABLE[:-1]))
            reason = f"its format is {found!r}, this version reads {older} and {FORMAT}"
            raise MissingFileError("a radiance field for this version", path, reason, remedy)
        _STRUCTURE(described, "")
        if not described["bounds"]["near"] < described["bounds"]["far"]:
            raise ValueError("bounds.near is not below bounds.far")
        low, high = (described["bounds"].get(corner) for corner in ("low", "high"))
        if (low is None) != (high is None) or (low and not all(a < b for a, b in zip(low, high, strict=True))):
            raise ValueError("bounds.low is not below bounds.high")
    except (OSError, ValueError) as error:
        raise MissingFileError("a radiance field", path, f"it is damaged ({error})", remedy) from error
    return described
