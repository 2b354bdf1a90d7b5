"""The summaries that a report takes its figures from, checked before anything is drawn."""

from pathlib import Path
from typing import Any

from nerf_rl.errors import MissingFileError
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.structure import mapping, number, optional, table, text, whole
from nerf_rl.rl.training.evaluation_results import EVALUATIONS

_FIGURE = optional(number())
_PROBE = table(mapping({"r2": number()}, others=True))
_FIELD = mapping({"psnr_db": number(), "miou": _FIGURE, "depth_mae_m": _FIGURE}, {"ssim": _FIGURE}, others=True)


def _validation(value: Any, place: str) -> None:
    """Check what held-out frames gave; an encoder without a radiance field has nothing there."""
    if value != {}:
        _FIELD(value, place)


_STRUCTURES = {
    "data": mapping(
        {
            **dict.fromkeys(("frames", "views"), whole()),
            **dict.fromkeys(("seconds", "views_per_second"), number(0.0)),
            "renderer": text(),
        },
        others=True,
    ),
    "encoder": mapping(
        {
            "steps": whole(),
            "seconds": number(0.0),
            "validation": _validation,
            "probe": _PROBE,
            "class_iou": table(_FIGURE),
        },
        {"joint_probe": _PROBE, "validation_other_cameras": table(_validation)},
        others=True,
    ),
    "agent": mapping({"seconds": number(0.0), "evaluations": EVALUATIONS}, others=True),
}


def read_summary(part: str, folder: Path) -> dict[str, Any]:
    """Return the summary of a part of a report.

    Args:
        part: data, encoder or agent.
        folder: where it is.

    Raises:
        MissingFileError: there is none, it is damaged, or an agent was never evaluated.
    """
    path = folder / SUMMARY
    if not path.is_file():
        raise MissingFileError("a finished run", folder, f"it holds no {SUMMARY}", "finish it with --resume true")
    remedy = "make it again" if part == "data" else "train it again"
    try:
        summary = read_json(path)
        _STRUCTURES[part](summary, "")
    except (OSError, ValueError) as error:
        raise MissingFileError("a finished run", folder, f"its {SUMMARY} is damaged ({error})", remedy) from error
    if part == "agent" and not summary["evaluations"]:
        raise MissingFileError("a finished run", folder, f"its {SUMMARY} holds no evaluation", remedy)
    return summary
