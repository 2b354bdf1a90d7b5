"""Marks that show people what leads a robot: seen in colours, and seen through in depth and labels."""

import numpy as np
import pytest
from test_renderer import loaded, random_cameras

from nerf_rl.rendering.renderer import MultiViewRenderer


@pytest.mark.parametrize("quality", ["fast", "smooth", "full"])
@pytest.mark.parametrize(
    "body, geom, seen_through",
    [
        ('mocap="true"', 'rgba="1 1 0 0.3" contype="0" conaffinity="0"', True),
        ('mocap="true"', 'rgba="1 1 0 0.7" contype="0" conaffinity="0"', False),
        ('mocap="true"', 'rgba="1 1 0 0.3"', False),
        ('mocap="true"', 'material="faint" contype="0" conaffinity="0"', True),
        ("", 'rgba="1 1 0 0.3" contype="0" conaffinity="0"', False),
    ],
)
def test_a_faint_mark_of_a_mocap_body_is_seen_and_has_no_depth(quality: str, body: str, geom: str, seen_through: bool):
    """It shows people what leads a hand, as the axes of two metres do in Fetch's scenes."""
    material = '</worldbody><asset><material name="faint" rgba="1 1 0 0.3"/></asset><worldbody>'
    model, data = loaded(f'{material}<body {body} pos="0 0 0.4"><geom type="box" size="1 0.05 0.05" {geom}/></body>')
    bare, bare_data = loaded()
    intrinsics, poses = random_cameras(np.random.default_rng(3), 4, 48, (0.0, 0.0, 0.1))
    marked, unmarked = (MultiViewRenderer(each, 48, 48, 4, quality) for each in (model, bare))
    views, expected = marked.render(data, intrinsics, poses), unmarked.render(bare_data, intrinsics, poses)
    np.testing.assert_array_equal(marked.render_rgb(data, intrinsics, poses), views.rgb)
    marked.close()
    unmarked.close()
    assert (views.rgb != expected.rgb).any(-1).mean() > 0.02  # it is drawn
    same = np.array_equal(views.geom, expected.geom) and np.array_equal(views.depth, expected.depth)
    assert same == seen_through
