"""What the processes of tests begin with: models that are installed are compiled once for all scenes.

A test's process imports this, and so does the server that its workers are forks of: before any of them starts, it has
compiled the model of drawer-open and simplified its meshes. Models of a test's own are compiled anew each time.
"""

import copy
import functools
import sysconfig
from typing import Any

import mujoco
from metaworld.asset_path_utils import full_V3_path_for

from nerf_rl.rendering.level_of_detail import simplify_meshes

INSTALLED = sysconfig.get_path("purelib")
MODEL = full_V3_path_for("sawyer_xyz/sawyer_drawer.xml")
PIXELS = 24
"""a side of the tiny dataset's pictures"""

_compile = mujoco.MjModel.from_xml_path
_compiled = functools.lru_cache(maxsize=8)(_compile)


def from_xml_path(filename: str, assets: Any = None) -> mujoco.MjModel:
    """Return a model of its own, as MuJoCo's function of this name does."""
    if assets is None and filename.startswith(INSTALLED):
        return copy.copy(_compiled(filename))
    return _compile(filename, assets)


mujoco.MjModel.from_xml_path = staticmethod(from_xml_path)
simplify_meshes(from_xml_path(MODEL), PIXELS, pixels_per_metre=1.0)
