"""What a model says of pictures itself."""

import mujoco
import numpy as np
from test_renderer import loaded, random_cameras

from nerf_rl.rendering.renderer import MultiViewRenderer, Views


def views_of(model: mujoco.MjModel, data: mujoco.MjData) -> Views:
    """Return what four cameras see."""
    renderer = MultiViewRenderer(model, 48, 48, 4)
    views = renderer.render(data, *random_cameras(np.random.default_rng(5), 4, 48, (0.0, 0.0, 0.1)))
    renderer.close()
    return views


def test_cameras_are_pinholes_where_the_models_own_free_camera_is_not():
    parallel = loaded('</worldbody><visual><global orthographic="true"/></visual><worldbody>')
    for mine, theirs in zip(views_of(*loaded()), views_of(*parallel), strict=True):
        np.testing.assert_array_equal(mine, theirs)
