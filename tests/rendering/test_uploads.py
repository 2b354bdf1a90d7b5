"""Textures and height fields that an environment has written anew are drawn, by every renderer, as they are now."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.rendering import renderer as renderer_module
from nerf_rl.rendering.renderer import MultiViewRenderer, Views

SIZE = 48
SCENE = """<mujoco>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.3 0.5 0.7" rgb2="0 0 0" width="32" height="192"/>
    <texture name="paper" type="2d" builtin="flat" rgb1="0.8 0.8 0.8" width="64" height="64"/>
    <material name="paper" texture="paper"/>
    <hfield name="ground" nrow="12" ncol="12" size="0.5 0.5 0.2 0.05"/>
  </asset>
  <worldbody>
    <light pos="0 0 2" dir="0 0 -1" directional="true"/>
    <geom name="ground" type="hfield" hfield="ground" rgba="0.4 0.6 0.3 1"/>
    <geom name="wall" type="box" pos="0 0.4 0.2" size="0.3 0.02 0.2" material="paper"/>
    <body pos="0 0 0.5"><freejoint/><geom name="ball" size="0.06" rgba="0.9 0.1 0.1 1"/></body>
  </worldbody>
</mujoco>"""
CAMERAS = (
    np.repeat(intrinsics_from_fovy(50.0, SIZE, SIZE)[None], 2, 0),
    np.stack([look_at(np.array([0.0, 0.0, 0.2]), 1.4, azimuth, -20.0) for azimuth in (60.0, 120.0)]),
)


def paint_wall(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    wall = model.tex("paper").id
    first = model.tex_adr[wall]
    model.tex_data[first : first + 64 * 64 * 3] = np.repeat(rng.integers(0, 255, 64 * 64), 3)


def dot_the_wall(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    """Paint a few texels that lie between those that are looked at in the midst of an episode."""
    first = model.tex_adr[model.tex("paper").id]
    texels = model.tex_data[first : first + 64 * 64 * 3]
    colour = rng.integers(0, 255)
    for _ in range(500):
        texels[13 * rng.integers(1, len(texels) // 13) + 1 :][:12] = colour


def paint_the_sky(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    first = model.tex_adr[model.tex("sky").id]
    model.tex_data[first : first + 32 * 192 * 3] = rng.integers(0, 255)


def raise_the_ground(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    model.hfield_data[:] = rng.uniform(size=model.nhfielddata)


def stretch_the_ground(model: mujoco.MjModel, rng: np.random.Generator) -> None:
    model.hfield_data[:] = np.linspace(0, 1, model.nhfielddata)
    model.hfield_size[0, 2] = rng.uniform(0.1, 0.3)


CHANGES = [paint_wall, dot_the_wall, paint_the_sky, raise_the_ground, stretch_the_ground]


def fresh(model: mujoco.MjModel, data: mujoco.MjData, quality: str) -> Views:
    renderer = MultiViewRenderer(model, SIZE, SIZE, 2, quality)
    seen = renderer.render(data, *CAMERAS)
    renderer.close()
    return seen


def assert_same(one: Views, other: Views) -> None:
    for name in Views._fields:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.parametrize(
    ("change", "quality", "is_software"),
    [*((change, "fast", machine) for change in CHANGES for machine in (True, False)), (paint_wall, "full", True)],
)
def test_what_a_reset_writes_is_drawn_as_by_a_renderer_made_afterwards(
    change: Callable, quality: str, is_software: bool, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(renderer_module, "is_software", lambda _: is_software)
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    renderer = MultiViewRenderer(model, SIZE, SIZE, 2, quality)
    before = None
    for _ in range(2):
        mujoco.mj_resetData(model, data)
        change(model, rng)
        for _ in range(3):  # what stands still is kept from the third picture on
            mujoco.mj_step(model, data, 20)
            seen = renderer.render(data, *CAMERAS)
            np.testing.assert_array_equal(seen.rgb, renderer.render_rgb(data, *CAMERAS))
        assert_same(seen, fresh(model, data, quality))
        assert before is None or (before != seen.rgb).any()
        before = seen.rgb
    renderer.close()


@pytest.mark.parametrize("change", [paint_wall, paint_the_sky, raise_the_ground], ids=lambda change: change.__name__)
def test_what_is_written_in_the_midst_of_an_episode_is_drawn(change: Callable):
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    renderer = MultiViewRenderer(model, SIZE, SIZE, 2, "fast")
    for step in range(6):
        mujoco.mj_step(model, data, 20)
        if step % 3 == 2:
            change(model, rng)
        assert_same(renderer.render(data, *CAMERAS), fresh(model, data, "fast"))
    renderer.close()
