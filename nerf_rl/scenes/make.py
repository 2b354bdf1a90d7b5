"""From a scene's name to the scene."""

import importlib

from nerf_rl.errors import UserError
from nerf_rl.scenes.base import GYM, METAWORLD, Scene
from nerf_rl.scenes.imported import require_simulator

MJCF_ENDINGS = (".xml", ".mjcf")
_SCENES = {
    METAWORLD: ("nerf_rl.scenes.metaworld", "MetaWorldScene"),
    GYM: ("nerf_rl.scenes.gym", "GymScene"),
}
"""Where the scenes are whose names begin so; modules are imported late, since Meta-World takes a second."""


def scene_modules(name: str) -> list[str]:
    """Return the modules that a scene of this name needs, for processes that are to have imported them."""
    return [module for prefix, (module, _) in _SCENES.items() if name.startswith(prefix)]


def make_scene(name: str) -> Scene:
    """Return a fresh scene, already reset once.

    Args:
        name: ``metaworld/TASK``, ``gym/ID`` with the id of a Gymnasium environment on MuJoCo, or the path of an MJCF
            file, which ends with .xml or .mjcf.

    Raises:
        UserError: no scene has this name, or it is that of imported images.
    """
    require_simulator(name)
    for prefix, (module, scene) in _SCENES.items():
        if name.startswith(prefix):
            return getattr(importlib.import_module(module), scene)(name.removeprefix(prefix))
    if name.endswith(MJCF_ENDINGS):
        from nerf_rl.scenes.mjcf import MjcfScene

        return MjcfScene(name)
    raise UserError(
        f"unknown scene '{name}'; available: {METAWORLD}TASK, for example {METAWORLD}drawer-open-v3, {GYM}ID, for "
        f"example {GYM}Ant-v5, and the path of an MJCF file that ends with {' or '.join(MJCF_ENDINGS)}"
    )
