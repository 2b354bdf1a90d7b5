"""How a user sorts what is seen into classes; importing this module loads nothing heavy."""

from dataclasses import dataclass


@dataclass
class ClassConfig:
    """A semantic class by pattern: geoms whose path (body/body/.../geom or mesh name) matches belong to it."""

    name: str
    """class name"""
    pattern: str
    """regular expression, searched in the path"""
