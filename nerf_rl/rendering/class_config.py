"""How a user sorts what is seen into classes; importing this module loads nothing heavy."""

from dataclasses import dataclass
from typing import Literal

from nerf_rl.errors import UserError

RobotLinks = Literal["together", "apart", "apart_if_alone"]
"""``together``: a robot is one class beside its gripper; ``apart``: each of its links that moves by a joint of its own
is one; ``apart_if_alone``: so it is where nothing moves but robots without a gripper"""


@dataclass
class ClassConfig:
    """A semantic class by pattern: geoms whose path (body/body/.../geom or mesh name) matches belong to it."""

    name: str
    """class name"""
    pattern: str
    """regular expression, searched in the path"""

    def __post_init__(self) -> None:
        if not self.name:
            raise UserError("'classes' need names, got an empty one")
