"""Where a pretraining run keeps its pictures of held-out frames."""

from pathlib import Path

FOLDER = "reconstructions"
"""in a run's folder"""
_BEGIN = "step_"


def picture_name(step: int) -> str:
    """Return the name of the picture that is drawn after a step."""
    return f"{_BEGIN}{step:06d}.png"


def newest_reconstruction(run: Path) -> Path | None:
    """Return the picture of the latest step in a run's folder, if there is one.

    Their names sort by steps up to a million only.
    """
    found = {path.stem.removeprefix(_BEGIN): path for path in (run / FOLDER).glob(f"{_BEGIN}*.png")}
    steps = [step for step in found if step.isdecimal()]
    return found[max(steps, key=int)] if steps else None
