"""The example that makes scenes of robosuite's tasks; robosuite is no extra, since it brings an OpenCV of its own."""

import numpy as np
import pytest
from own_environments import ROOT

from nerf_rl.scenes.make import make_scene
from nerf_rl.scenes.workspace import drawn_geoms

pytest.importorskip("robosuite")


@pytest.mark.parametrize("task, things", [("Lift", {"cube_main"}), ("NutAssemblySquare", {"SquareNut_main"})])
def test_a_task_of_robosuite_is_a_scene(task: str, things: set[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    scene = make_scene(f"gym/robosuite_tasks:{task}-v0")
    first, again, other = (scene.env.reset(seed=seed)[0] for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert scene.env.step(scene.env.action_space.sample())[4] == {"success": False}
    assert things <= {name.removesuffix("_x") for name in scene.privileged_names}
    assert (scene.model.geom_group[drawn_geoms(scene.model)] > 0).all()  # shapes for collisions are not drawn
    assert scene.workspace().radius < 1.0
