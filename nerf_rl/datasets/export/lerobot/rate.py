"""How many steps a second a scene takes, which a dataset does not say."""

import numpy as np

from nerf_rl.errors import UserError
from nerf_rl.scenes.base import GYM
from nerf_rl.scenes.make import make_scene


def steps_per_second(scene: str) -> int:
    """Return the steps that an environment takes in a second of simulated time, rounded, by taking one.

    Args:
        scene: its name. One whose environment a module of its own registers is not opened: a dataset may come from
            anybody, and must not choose what is imported here.

    Raises:
        UserError: the scene cannot be opened here.
    """
    remedy = "say how many steps a second it takes with --fps"
    if scene.startswith(GYM) and ":" in scene:
        raise UserError(f"{scene} is not opened for an export; {remedy}")
    try:
        opened = make_scene(scene)
    except UserError as error:
        raise UserError(f"{error}; or {remedy}") from error
    env = opened.env
    env.reset(seed=0)
    before = opened.data.time
    env.step(np.zeros(env.action_space.shape or (), np.float32))
    period = opened.data.time - before
    env.close()
    if period <= 0:
        raise UserError(f"the clock of {scene} does not run; {remedy}")
    return max(1, round(1 / period))
