"""What stands still is drawn once, and no picture shows that: it is the same as if all were drawn each time."""

from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest
from test_renderer import BOXES, random_cameras

from nerf_rl.rendering import renderer as renderer_module
from nerf_rl.rendering.renderer import MultiViewRenderer, Views
from nerf_rl.scenes.base import Scene

BLOCK = '<geom type="box" size="0.1 0.06 0.05" rgba="0.9 0.9 0.1 1"/>'
MOVING = f'<body name="block" pos="0.3 0.1 0.3"><freejoint/>{BLOCK}</body>'
LAMP = '<body name="lamp" pos="0 0 1" mocap="true"><light pos="0 0 0" dir="0 0 -1"/></body>'
SIZE = 48


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many geoms were drawn into each view."""
    counts = []

    def render(tile: mujoco.MjrRect, scene: mujoco.MjvScene, context: mujoco.MjrContext) -> None:
        counts.append(scene.ngeom)
        original(tile, scene, context)

    original = mujoco.mjr_render
    monkeypatch.setattr(mujoco, "mjr_render", render)
    return counts


Both = Callable[[mujoco.MjModel, str], Callable[..., None]]


@pytest.fixture
def both(monkeypatch: pytest.MonkeyPatch) -> Iterator[Both]:
    """Makes a comparison of pictures of one renderer that keeps a background and one that never does."""
    renderers = []

    def make(model: mujoco.MjModel, quality: str) -> Callable[..., None]:
        for software in (True, False):  # what a machine decides
            monkeypatch.setattr(renderer_module, "is_software", lambda _, software=software: software)
            renderers.append(MultiViewRenderer(model, SIZE, SIZE, 4, quality))
        keeps, draws_all = renderers[-2:]

        def compare(data: mujoco.MjData, intrinsics: np.ndarray, poses: np.ndarray) -> None:
            seen, expected = (each.render(data, intrinsics, poses) for each in (keeps, draws_all))
            for name in Views._fields:
                np.testing.assert_array_equal(getattr(seen, name), getattr(expected, name), name)
            colours = (each.render_rgb(data, intrinsics[:2], poses[:2]) for each in (keeps, draws_all))
            np.testing.assert_array_equal(*colours)

        return compare

    yield make
    for renderer in renderers:
        renderer.close()


def scene(extra: str = "") -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return boxes on a plane, one of which falls."""
    model = mujoco.MjModel.from_xml_string(BOXES.format(extra=MOVING + extra))
    return model, mujoco.MjData(model)


def steps(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> Iterator[int]:
    """Let time go on."""
    for step in range(count):
        mujoco.mj_step(model, data, 5)
        mujoco.mj_forward(model, data)
        yield step


@pytest.mark.parametrize("quality", ["fast", "smooth", "full"])
def test_pictures_are_the_same_to_the_last_bit_as_things_move_and_a_camera_of_several_does(
    both: Both, quality: str, drawn: list[int]
):
    model, data = scene()
    compare, rng = both(model, quality), np.random.default_rng(0)
    cameras = random_cameras(rng, 4, SIZE, (0.0, 0.0, 0.1))
    for step in steps(model, data, 5):
        cameras[1][3] = random_cameras(rng, 1, SIZE, (0.0, 0.0, 0.1))[1][0]
        if step == 3:
            cameras[1][0] = random_cameras(rng, 1, SIZE, (0.0, 0.0, 0.1))[1][0]
        compare(data, *cameras)
    assert 1 in drawn  # the block alone


def test_pictures_of_a_robot_and_of_things_that_a_reset_moves_are_the_same(
    both: Both, drawer_open: Scene, drawn: list[int]
):
    compare, rng = both(drawer_open.model, "smooth"), np.random.default_rng(1)
    cameras = random_cameras(rng, 3, SIZE, (0.0, 0.6, 0.1))
    for seed in range(3):
        drawer_open.env.reset(seed=seed)
        for _ in range(3):
            drawer_open.env.step(rng.uniform(-1, 1, 4).astype(np.float32))
            compare(drawer_open.render_data(), *cameras)
    assert min(drawn) < max(drawn) - 3


@pytest.mark.parametrize("change", ["colour", "size", "lamp", "dimmer", "place", "headlight"])
def test_what_looks_otherwise_or_was_put_elsewhere_is_drawn_anew(both: Both, change: str):
    model, data = scene(LAMP)
    compare = both(model, "smooth")
    cameras = random_cameras(np.random.default_rng(2), 3, SIZE, (0.0, 0.0, 0.1))
    for step in steps(model, data, 6):
        if step == 3:
            if change == "colour":
                model.geom_rgba[1] = 0.1, 0.9, 0.9, 1
            elif change == "size":
                model.geom_size[1] *= 1.5
            elif change == "lamp":
                data.mocap_pos[0] = 0.5, 0.5, 0.6
            elif change == "dimmer":
                model.light_diffuse[:] = 0.1
            elif change == "place":
                model.geom_pos[2] += 0.2
            else:
                model.vis.headlight.diffuse[:] = 0.9
            mujoco.mj_forward(model, data)
        compare(data, *cameras)


@pytest.mark.parametrize(
    "extra",
    [
        '<geom type="box" pos="0.3 0.1 0.45" size="0.25 0.25 0.02" rgba="0.2 0.4 0.9 0.4"/>',
        '<site name="above" pos="-0.4 0 0.6"/>',
    ],
    ids=["glass", "a tendon"],
)
def test_what_is_seen_through_and_what_is_no_geom_is_drawn_each_time(both: Both, extra: str):
    xml = BOXES.format(extra=MOVING + extra)
    if "site" in extra:
        ends = '<site site="above"/><site site="block"/>'
        tendon = f'<tendon><spatial width="0.02" rgba="1 0 1 1">{ends}</spatial></tendon>'
        xml = xml.replace("<freejoint/>", '<freejoint/><site name="block"/>').replace("</mujoco>", tendon + "</mujoco>")
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    compare = both(model, "smooth")
    cameras = random_cameras(np.random.default_rng(3), 3, SIZE, (0.0, 0.0, 0.2))
    for _ in steps(model, data, 4):
        compare(data, *cameras)


def test_where_what_moves_and_what_stands_still_are_equally_far_the_later_one_is_seen(both: Both):
    slab = '<body name="slab" mocap="true"><geom type="box" pos="0.1 0 0.2" size="0.1 0.2 0.2" rgba="0 0 1 1"/></body>'
    for first, second in ((slab, ""), ("", slab)):
        xml = BOXES.replace(
            '<geom type="box" pos="0.1 0 0.2" size="0.1 0.2 0.2" euler="10 20 30" rgba="0.8 0.2 0.2 1"/>', "{box}"
        )
        box = '<geom type="box" pos="0.1 0 0.2" size="0.1 0.2 0.2" rgba="0.8 0.2 0.2 1"/>'
        model = mujoco.MjModel.from_xml_string(xml.format(box=first + box + second, extra=""))
        data = mujoco.MjData(model)
        compare = both(model, "smooth")
        cameras = random_cameras(np.random.default_rng(4), 3, SIZE, (0.0, 0.0, 0.2))
        for height in (0.3, 0.2, 0.1, 0.0, 0.0, 0.1):  # the slab comes to be where the box is
            data.mocap_pos[0] = 0, 0, height
            mujoco.mj_forward(model, data)
            compare(data, *cameras)


@pytest.mark.parametrize("software", [True, False])
def test_only_software_opengl_draws_what_stands_still_once(
    software: bool, monkeypatch: pytest.MonkeyPatch, drawn: list[int]
):
    monkeypatch.setattr(renderer_module, "is_software", lambda _: software)
    model, data = scene()
    renderer = MultiViewRenderer(model, SIZE, SIZE, 2, "smooth")
    cameras = random_cameras(np.random.default_rng(5), 2, SIZE, (0.0, 0.0, 0.1))
    for _ in steps(model, data, 4):
        drawn.clear()
        renderer.render(data, *cameras)
    renderer.close()
    assert max(drawn) <= (1 if software else 4) and (software or min(drawn) > 1)


def test_a_scene_that_looks_otherwise_each_time_is_drawn_no_more_often(
    monkeypatch: pytest.MonkeyPatch, drawn: list[int]
):
    monkeypatch.setattr(renderer_module, "is_software", lambda _: True)
    model, data = scene(LAMP)
    renderer = MultiViewRenderer(model, SIZE, SIZE, 2, "smooth")
    cameras = random_cameras(np.random.default_rng(6), 2, SIZE, (0.0, 0.0, 0.1))
    for step in steps(model, data, 4):
        data.mocap_pos[0, 0] = 0.01 * step
        mujoco.mj_forward(model, data)
        renderer.render(data, *cameras)
    renderer.close()
    assert len(drawn) == 4 * 2 * 2  # steps, views, and passes
