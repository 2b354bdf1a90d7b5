"""Things that begin anywhere: where they come to lie, what stays, and what a dataset then shows."""

from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.scenes.make import make_scene
from nerf_rl.scenes.scattering import Scattering

BLOCKS = str(Path(__file__).parents[2] / "datasets" / "scenes" / "blocks.xml")


def scattered(name: str, times: int) -> np.ndarray:
    """Return positions of all joints after so many resets, each scattered, [times, nq]."""
    scene, rng = make_scene(name), np.random.default_rng(0)
    scattering = Scattering(scene)
    found = []
    for seed in range(times):
        scene.env.reset(seed=seed)
        scattering.scatter(rng)
        found.append(scene.data.qpos.copy())
    return np.array(found)


@pytest.mark.parametrize("task", ["drawer-open", "door-open", "window-open"])
def test_what_slides_or_turns_begins_anywhere_in_its_range(task: str):
    scene = make_scene(f"metaworld/{task}-v3")
    model = scene.model
    thing = next(j for j in range(model.njnt) if int(model.body_rootid[model.jnt_bodyid[j]]) not in scene.parts.robot)
    low, high = model.jnt_range[thing]
    places = scattered(scene.name, 60)[:, model.jnt_qposadr[thing]]
    assert low <= places.min() and places.max() <= high
    assert np.ptp(places) > 0.8 * (high - low)


@pytest.mark.parametrize(
    ("name", "things"), [("metaworld/soccer-v3", ["soccer_ball"]), (BLOCKS, ["red_block", "blue_block"])]
)
def test_free_things_begin_anywhere_in_the_workspace_and_inside_nothing(name: str, things: list[str]):
    scene, rng = make_scene(name), np.random.default_rng(0)
    scattering, workspace = Scattering(scene), scene.workspace()
    ids = [scene.model.body(thing).id for thing in things]
    places = []
    for seed in range(60):
        scene.env.reset(seed=seed)
        scattering.scatter(rng)
        places.append(scene.data.xpos[ids].copy())
        for contact in scene.data.contact:
            if set(scene.model.geom_bodyid[contact.geom]) & set(ids):
                assert contact.dist > -2e-3
    away = np.array(places)[..., :2] - workspace.centre[:2]
    distance = np.linalg.norm(away, axis=-1)
    assert distance.max() < 0.9 * workspace.radius  # a block that a reset had put farther out is the exception
    assert np.ptp(away, axis=0).min() > workspace.radius


def test_what_a_reset_puts_far_away_stays_there():
    scene, rng = make_scene(BLOCKS), np.random.default_rng(0)
    scattering = Scattering(scene)
    unused, used = (scene.model.body(f"{colour}_block").id for colour in ("red", "blue"))
    scene.env.reset(seed=0)
    scene.data.joint(scene.model.body_jntadr[unused]).qpos[:3] = 9.0, -9.0, 0.5
    before = scene.data.qpos.copy()
    scattering.scatter(rng)
    np.testing.assert_array_equal(scene.data.xpos[unused], [9.0, -9.0, 0.5])
    place = scene.model.jnt_qposadr[scene.model.body_jntadr[used]]
    assert (scene.data.qpos[place : place + 2] != before[place : place + 2]).all()


def test_a_slide_whose_limits_are_far_away_stays_in_the_workspace():
    scene, rng = make_scene("gym/Pusher-v5"), np.random.default_rng(0)
    scattering, radius = Scattering(scene), scene.workspace().radius
    slide = scene.model.joint("obj_slidex")
    assert np.ptp(slide.range) > 10.0 * radius
    moved = []
    for seed in range(40):
        scene.env.reset(seed=seed)
        before = scene.data.qpos[slide.qposadr[0]]
        scattering.scatter(rng)
        moved.append(scene.data.qpos[slide.qposadr[0]] - before)
    assert 0.4 * radius < np.abs(moved).max() <= 0.8 * radius


def test_the_robot_stays_and_the_same_draws_give_the_same_places():
    scene = make_scene(BLOCKS)
    robot = [
        int(scene.model.jnt_qposadr[j])
        for j in range(scene.model.njnt)
        if int(scene.model.body_rootid[scene.model.jnt_bodyid[j]]) in scene.parts.robot
    ]
    as_reset = []
    for seed in range(5):
        scene.env.reset(seed=seed)
        as_reset.append(scene.data.qpos[robot].copy())
    first = scattered(BLOCKS, 5)
    np.testing.assert_array_equal(first[:, robot], as_reset)
    np.testing.assert_array_equal(first, scattered(BLOCKS, 5))


def test_things_whose_every_place_is_taken_stay_where_the_reset_put_them(tmp_path: Path):
    pinned = tmp_path / "pinned.xml"
    pinned.write_text(
        """<mujoco><worldbody>
        <body name="pusher"><joint name="push" type="slide" axis="1 0 0" range="-1 1"/><geom size="0.02"/></body>
        <geom name="everywhere" type="box" size="9 9 9" pos="0 0 -9.1"/>
        <body name="thing" pos="0.3 0 -0.09"><freejoint/><geom size="0.01"/></body>
        <geom name="lid" type="box" size="9 9 9" pos="0 0 8.915"/>
        </worldbody><actuator><motor joint="push"/></actuator></mujoco>"""
    )
    scene = make_scene(str(pinned))
    scattering = Scattering(scene)
    scene.env.reset(seed=0)
    before = scene.data.qpos.copy()
    scattering.scatter(np.random.default_rng(0))
    np.testing.assert_array_equal(scene.data.qpos, before)
    assert scene.data.body("thing").xpos == pytest.approx(before[1:4])


@pytest.mark.parametrize("name", ["metaworld/reach-wall-v3", "gym/Reacher-v5", "gym/Hopper-v5"])
def test_scenes_with_other_things_or_none_can_be_scattered(name: str):
    places = scattered(name, 3)
    assert np.isfinite(places).all()


def test_a_dataset_shows_and_tells_where_scattered_things_are(tiny_recipe: Path, tmp_path: Path):
    command = ["gen-dataset", "--config", str(tiny_recipe), "--episodes", "12", "--frames_per_episode", "1"]
    handles = {}
    for share in ("0", "0.5", "1"):
        out = tmp_path / share
        assert cli.main([*command, "--behaviour.scattered", share, "--out", str(out)]) == 0
        dataset = MultiViewDataset(out)
        drawer = dataset.read("state/qpos")[:, -1]  # how far it is pulled out
        handles[share] = dataset.read("state/privileged")[:, dataset.columns("privileged").index("handle_y")]
        case = handles[share] - drawer
        assert np.ptp(case) < 0.1  # where a reset puts the case; the handle goes with the drawer
    assert np.ptp(handles["1"]) > np.ptp(handles["0"]) + 0.1
    assert (handles["0"] != handles["1"]).sum() > (handles["0"] != handles["0.5"]).sum() > 0


TIED = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="1 1 .1"/>
  <body pos="-.6 0 .1"><joint name="push" type="slide" axis="1 0 0" range="-1 1"/><geom size=".02"/></body>
  <body name="left" pos="0 .2 .03"><freejoint/><geom type="box" size=".03 .03 .03"/></body>
  <body name="right" pos=".06 .2 .03"><freejoint/><geom type="box" size=".03 .03 .03"/></body>
  <body name="loose" pos=".3 -.3 .03"><freejoint/><geom type="box" size=".03 .03 .03"/></body>
  <body name="knob" pos="-.3 -.3 .1"><joint name="knob" axis="0 0 1" range="0 60"/><geom size=".03"/></body>
  <body name="lid" pos="-.3 .3 .1"><joint name="lid" type="slide" axis="0 0 1" range="0 1"/><geom size=".03"/></body>
  <body pos="0 -.3 .1"><joint name="lamp" type="slide" axis="0 0 1"/><geom size=".02"/></body>
  <body pos="0 -.5 .1"><joint name="stop" type="slide" axis="0 0 1"/><geom size=".02"/></body>
</worldbody><equality>
  <weld body1="left" body2="right"/><joint joint1="lamp" joint2="lid" polycoef="0 2 0 0 0"/>
  <joint joint1="lid" joint2="knob" polycoef=".01 .5 0 0 0"/><joint joint1="stop"/>
</equality><actuator><motor joint="push"/></actuator></mujoco>"""


@pytest.mark.parametrize("anywhere", [False, True])
def test_what_constraints_hold_together_begins_together(anywhere: bool, tmp_path: Path):
    (tmp_path / "tied.xml").write_text(TIED)
    scene = make_scene(str(tmp_path / "tied.xml"))
    scattering, loose, knobs = Scattering(scene), [], []
    for seed in range(6):
        scene.env.reset(seed=seed)
        if anywhere:
            scattering.scatter(np.random.default_rng(seed))
        apart = scene.data.body("right").xpos - scene.data.body("left").xpos
        np.testing.assert_allclose(apart, [0.06, 0, 0], atol=1e-9)
        knob, lid, lamp, stop = (scene.data.joint(name).qpos[0] for name in ("knob", "lid", "lamp", "stop"))
        assert lid == pytest.approx(0.01 + 0.5 * knob) and lamp == pytest.approx(2 * lid) and stop == 0
        loose.append(scene.data.body("loose").xpos[0])
        knobs.append(knob)
    assert np.ptp(loose) > 0.05 and np.ptp(knobs) > 0.05
