"""When a run is good enough: a measure of its validations and what it has to reach."""

import re
from collections.abc import Mapping
from typing import NamedTuple

from nerf_rl.errors import UnknownNameError, UserError

MEASURES = ("psnr_db", "ssim", "miou", "depth_mae_m")
_FORM = re.compile(r"\s*(\w+)\s*(>=|<=)\s*([-+.\deE]+)\s*")


class Goal(NamedTuple):
    """What one measure has to reach."""

    measure: str
    at_least: bool
    """else at most"""
    value: float

    def is_reached(self, figures: Mapping[str, float | None]) -> bool:
        """Return whether a validation's figures reach it; one that could not be measured does not."""
        found = figures.get(self.measure)
        return found is not None and (found >= self.value if self.at_least else found <= self.value)


def parse_goal(text: str) -> Goal:
    """Return the goal that a text such as ``miou>=0.9`` or ``depth_mae_m<=0.02`` names.

    Raises:
        UserError: it is no measure, sign and number.
    """
    found = _FORM.fullmatch(text)
    try:
        value = float(found[3]) if found else None
    except ValueError:
        value = None
    if found is None or value is None:
        raise UserError(
            "--stop_when takes MEASURE>=NUMBER or MEASURE<=NUMBER in quotes, since a shell takes > and < for itself, "
            f"such as \"miou>=0.9\", got '{text}'"
        )
    if found[1] not in MEASURES:
        raise UnknownNameError("measure", found[1], MEASURES)
    return Goal(found[1], found[2] == ">=", value)
