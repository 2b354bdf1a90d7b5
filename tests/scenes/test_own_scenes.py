"""Scenes from MJCF files and from Gymnasium: found by name, described by their structure, drawn as they are."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from own_environments import ANOTHER_SLIDER, DM_CONTROL, with_dm_control

from nerf_rl import cli
from nerf_rl.cameras.geometry import project
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import JOINT_NUMBERS
from nerf_rl.errors import UserError
from nerf_rl.files.json_files import read_json
from nerf_rl.scenes.base import Scene, model_digest
from nerf_rl.scenes.body_parts import BodyParts
from nerf_rl.scenes.make import make_scene
from nerf_rl.scenes.state_columns import StateColumns, joints

BLOCKS = "datasets/scenes/blocks.xml"
SCENES = (BLOCKS, "gym/Ant-v5", "gym/Pusher-v5", "gym/InvertedPendulum-v5")
WITH_DM_CONTROL = (*SCENES, pytest.param(DM_CONTROL, marks=with_dm_control))


def states(scene: Scene, seed: int, steps: int = 8) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    scene.env.reset(seed=seed)
    shown = [scene.data.qpos.copy()]
    for _ in range(steps):
        scene.env.step(rng.uniform(-0.4, 0.4, scene.env.action_space.shape).astype(np.float32))
        shown += [scene.data.qpos.copy(), scene.data.qvel.copy()]
    return shown


@pytest.mark.parametrize("name", WITH_DM_CONTROL)
def test_a_seed_decides_an_episode_and_seeds_differ(name: str):
    scene = make_scene(name)
    first = states(scene, 3)
    other = states(scene, 4)
    for mine, theirs in zip(first, states(make_scene(name), 3), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert not np.array_equal(first[0], other[0])


@pytest.mark.parametrize("name", SCENES)
def test_looking_at_a_scene_does_not_change_what_happens_in_it(name: str):
    looked, alone = make_scene(name), make_scene(name)
    rng = np.random.default_rng(0)
    for scene in (looked, alone):
        scene.env.reset(seed=5)
    for _ in range(10):
        action = rng.uniform(-0.4, 0.4, looked.env.action_space.shape).astype(np.float32)
        looked.render_data()
        looked.privileged(None)
        seen = looked.env.step(action)
        unseen = alone.env.step(action)
        np.testing.assert_array_equal(seen[0], unseen[0])
        assert seen[1] == unseen[1]
        np.testing.assert_array_equal(looked.data.xpos, alone.data.xpos)


@pytest.mark.parametrize("name", (*WITH_DM_CONTROL, "metaworld/hammer-v3"))
def test_joints_are_told_apart_and_make_up_the_state(name: str):
    model = make_scene(name).model
    found = joints(model)
    assert sum(JOINT_NUMBERS[joint["kind"]] for joint in found) == model.nq
    assert len({joint["name"] for joint in found}) == model.njnt
    if name == BLOCKS:
        assert {"name": "green_block", "kind": "free"} in found and {"name": "left", "kind": "slide"} in found


@pytest.mark.parametrize("name", WITH_DM_CONTROL)
def test_what_is_shown_is_the_state_that_is_stored(name: str):
    scene = make_scene(name)
    states(scene, 1)
    exact = mujoco.MjData(scene.model)
    exact.qpos[:] = scene.data.qpos
    mujoco.mj_forward(scene.model, exact)
    np.testing.assert_allclose(scene.render_data().geom_xpos, exact.geom_xpos, atol=1e-12)
    np.testing.assert_allclose(scene.render_data().geom_xmat, exact.geom_xmat, atol=1e-12)


def test_columns_are_named_after_joints_and_bodies_and_hold_their_values():
    scene = make_scene(BLOCKS)
    scene.env.reset(seed=2)
    scene.env.step(np.full(6, 0.5, np.float32))
    proprio = dict(zip(scene.proprio_names, scene.proprio(None), strict=True))
    assert proprio["elbow"] == scene.data.joint("elbow").qpos[0]
    assert proprio["wrist_velocity"] == scene.data.joint("wrist").qvel[0]
    assert len(proprio) == 12  # the blocks' free joints are not the robot's
    privileged = dict(zip(scene.privileged_names, scene.privileged(None), strict=True))
    block = [privileged[f"green_block_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(block, scene.data.joint(7).qpos[:3], atol=1e-12)
    assert {"hand_x", "red_block_x", "blue_block_z"} <= set(privileged)
    assert not any(name.startswith(("table", "shelf", "arm")) for name in privileged)


def test_bodies_whose_names_differ_by_their_ends_alone_have_columns_of_their_own():
    names = ("cube", "cube_link", "cube_link_link", "lid_link", "")
    bodies = "".join(f'<body name="{name}"><freejoint/><geom size="0.1"/></body>' for name in names)
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    found = StateColumns(model, BodyParts()).privileged_names
    assert found[::3] == ("cube_x", "cube_link_x", "cube_link_link_x", "lid_x", "body_5_x")


def test_a_robot_that_travels_has_its_root_among_the_privileged_columns():
    assert make_scene("gym/Ant-v5").privileged_names == ("torso_x", "torso_y", "torso_z")


def test_resets_of_a_model_scatter_what_is_free_and_stay_within_limits():
    scene = make_scene(BLOCKS)
    start = scene.model.key("home").qpos
    places = []
    for seed in range(30):
        scene.env.reset(seed=seed)
        qpos = scene.data.qpos
        limits = scene.model.jnt_range[:6]
        assert (qpos[:6] >= limits[:, 0]).all() and (qpos[:6] <= limits[:, 1]).all()
        places.append(qpos - start)
    spread = np.abs(places).max(0)
    assert (spread[:6] > 0.07 * np.ptp(scene.model.jnt_range[:6], axis=1)).all() and (
        spread[[6, 7, 13, 14]] > 0.03
    ).all()
    np.testing.assert_allclose(spread[[8, 15, 22]], 0.0)  # heights
    quaternions = np.array(places)[:, 9:13] + start[9:13]
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0)


@pytest.mark.parametrize("size, least, most", [(1.0, 0.09, 0.1), (0.001, 0.0001, 0.001)])
def test_slides_without_limits_stay_near_where_all_is_small(size: float, least: float, most: float, tmp_path: Path):
    path = tmp_path / "slide.xml"
    path.write_text(
        f"""<mujoco><worldbody><body pos="{2 * size} 0 0"><freejoint/><geom size="{size}"/></body>
        <body><joint name="slide" type="slide"/><geom size="{size}"/></body></worldbody></mujoco>"""
    )
    scene = make_scene(str(path))
    places = []
    for seed in range(20):
        scene.env.reset(seed=seed)
        places.append(abs(scene.data.joint("slide").qpos[0]))
    assert least < max(places) <= most


def test_actions_span_the_control_ranges():
    scene = make_scene(BLOCKS)
    scene.env.reset(seed=0)
    for sign, column in ((-1.0, 0), (1.0, 1)):
        scene.env.step(np.full(6, sign, np.float32))
        np.testing.assert_allclose(scene.data.ctrl, scene.model.actuator_ctrlrange[:, column])


def test_provenance_names_the_compiled_model(tmp_path: Path):
    digest = make_scene(BLOCKS).provenance()["model_sha256"]
    assert digest == model_digest(mujoco.MjModel.from_xml_path(BLOCKS))
    changed = tmp_path / "blocks.xml"
    changed.write_text(Path(BLOCKS).read_text().replace('mass="0.05"', 'mass="0.06"'))
    assert make_scene(str(changed)).provenance()["model_sha256"] != digest


@pytest.mark.parametrize(
    "name, words",
    [
        ("gym/Antt-v5", r"unknown Gymnasium environment on MuJoCo 'Antt-v5' \(did you mean Ant-v5"),
        ("gym/CartPole-v1", "'CartPole-v1' is not on MuJoCo"),
        ("gym/no_such_module:Env-v0", "'no_such_module:Env-v0' cannot be made: .*No module"),
        (
            "gym/own_environments:RefusingSlider-v0",
            r"cannot be made: AssertionError in \S*own_environments.py, line \d+$",
        ),
        ("datasets/scenes/block.xml", "block.xml is not an MJCF file: no such file; .*MJCF files in .*blocks.xml"),
        ("nowhere/block.xml", "nowhere/block.xml is not an MJCF file: no such file; give the path of one as scene$"),
    ],
)
def test_names_that_lead_nowhere_are_answered_with_what_there_is(name: str, words: str):
    with pytest.raises(UserError, match=words):
        make_scene(name)


def test_a_file_that_is_no_model_is_answered_with_mujocos_reason(tmp_path: Path):
    path = tmp_path / "broken.xml"
    path.write_text("<mujoco><worldbody><geom type='cube' size='1'/></worldbody></mujoco>")
    with pytest.raises(UserError, match=r"broken\.xml is not a model that MuJoCo compiles: .*cube"):
        make_scene(str(path))


def test_a_name_that_is_not_in_utf8_is_told_with_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    body = '<body name="Tür"><joint type="slide"/><geom size="0.1"/></body>'
    text = f'<?xml version="1.0" encoding="ISO-8859-1"?><mujoco><worldbody>{body}</worldbody></mujoco>'
    (tmp_path / "door.xml").write_bytes(text.encode("latin-1"))
    words = ["gen-dataset", "--scene", str(tmp_path / "door.xml"), "--out", str(tmp_path / "out")]
    assert cli.main(words) == 2
    said = capsys.readouterr().err
    assert f"a name in {tmp_path / 'door.xml'}, 'Tür' perhaps, is not in UTF-8" in said and "as UTF-8" in said
    assert said.count("\n") == 1 and not (tmp_path / "out").exists()
    (tmp_path / "door.xml").write_text(text, encoding="utf-8")
    assert make_scene(str(tmp_path / "door.xml")).model.body(1).name == "Tür"


def test_a_model_without_actuators_or_joints_makes_a_dataset(tmp_path: Path):
    path = tmp_path / "still.xml"
    light = '<light pos="0 0 3"/>'
    path.write_text(f"<mujoco><worldbody>{light}<body name='vase'><geom size='0.1'/></body></worldbody></mujoco>")
    out = tmp_path / "data"
    arguments = ["--episodes", "2", "--frames_per_episode", "2", "--episode_steps", "3", "--size", "16"]
    assert cli.main(["gen-dataset", "--scene", str(path), "--out", str(out), "--workers", "1", *arguments]) == 0
    dataset = MultiViewDataset(out)
    assert len(dataset) == 4 and dataset.class_names == ("background", "vase")
    assert (dataset.read("semantic", [0]) == 1).mean() > 0.1


def test_a_scene_that_compiles_its_model_anew_makes_no_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """One renderer, and one list of bodies, would show all episodes as the first one was made."""
    arguments = ["--episodes", "2", "--frames_per_episode", "2", "--episode_steps", "3", "--size", "16"]
    words = ["gen-dataset", "--scene", ANOTHER_SLIDER, "--out", str(tmp_path / "data"), "--workers", "1", *arguments]
    assert cli.main(words) == 1
    assert "compiles a model of other parts in episode 0, and a dataset is of one" in capsys.readouterr().err
    assert not (tmp_path / "data" / "manifest.json").exists()


def test_a_simulation_that_diverges_is_told_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    path = tmp_path / "wild.xml"
    path.write_text(
        """<mujoco><option timestep="0.5"/><worldbody><light pos="0 0 3"/><body name="arm">
        <joint name="j" stiffness="100000"/><geom size="0.1" fromto="0 0 0 0 0 1" type="capsule"/></body></worldbody>
        <actuator><motor joint="j" gear="100000"/></actuator></mujoco>"""
    )
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "data"
    arguments = ["--episodes", "2", "--frames_per_episode", "2", "--size", "16", "--workers", "1"]
    assert cli.main(["gen-dataset", "--scene", str(path), "--out", str(out), *arguments]) != 0
    assert "diverges at step" in capsys.readouterr().err
    assert not (out / "manifest.json").exists() and not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_a_dataset_of_an_own_scene_has_all_kinds_of_cameras_and_matrices_that_agree(tmp_path: Path):
    out = tmp_path / "data"
    arguments = ["--episodes", "2", "--frames_per_episode", "2", "--episode_steps", "30", "--size", "64"]
    assert (
        cli.main(["gen-dataset", "--config", "datasets/blocks.yaml", *arguments, "--out", str(out), "--workers", "1"])
        == 0
    )
    dataset = MultiViewDataset(out)
    manifest = read_json(out / "manifest.json")
    assert [camera["role"] for camera in manifest["cameras"]].count("test") == 2
    assert dataset.class_names == ("background", "shelf", "robot", "gripper", "block")
    frames = np.arange(len(dataset))
    names = dataset.columns("privileged")
    privileged = dict(zip(names, dataset.read("state/privileged", frames).T, strict=True))
    semantic, depth = dataset.read("semantic", frames), dataset.read("depth", frames)
    projections = dataset.projections(frames)
    seen = 0
    for frame in frames:
        centres = np.array([[privileged[f"{c}_block_{a}"][frame] for a in "xyz"] for c in ("red", "green", "blue")])
        for view in range(semantic.shape[1]):
            pixels, distance = project(projections[frame, view], centres.astype(np.float64))
            for (x, y), z in zip(pixels, distance, strict=True):
                if z <= 0 or not (2 <= x < 62 and 2 <= y < 62):
                    continue
                near = depth[frame, view, int(y), int(x)]
                if near < z - 0.05:
                    continue  # something stands before it
                assert semantic[frame, view, int(y), int(x)] == 4
                assert z - 0.05 < near < z
                seen += 1
    assert seen > 40


def test_a_wrong_name_is_a_mistake_of_usage(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    assert cli.main(["gen-dataset", "--scene", "gym/Walkr2d-v5", "--out", str(tmp_path / "x")]) == 2
    assert "did you mean Walker2d-v5" in capsys.readouterr().err


def test_cameras_see_wherever_an_arm_and_its_target_come(tmp_path: Path):
    """After the first reset alone, Reacher's arm lies in a line, and the cameras missed most of what followed."""
    out = tmp_path / "data"
    arguments = ["--episodes", "12", "--episodes_per_shard", "12", "--workers", "1", "--size", "32"]
    assert cli.main(["gen-dataset", "--config", "datasets/gym.yaml", *arguments, "--out", str(out)]) == 0
    dataset = MultiViewDataset(out)
    views = dataset.views("encoder")
    projections = dataset.projections(np.arange(len(dataset)))[:, views]
    state = dataset.read("state/privileged")
    for first in (0, 3):  # fingertip, target
        points = np.concatenate([state[:, first : first + 3], np.ones((len(state), 1))], axis=1)
        seen = np.einsum("nvij,nj->nvi", projections, points)
        pixels = seen[..., :2] / seen[..., 2:]
        assert ((pixels > 0) & (pixels < 32)).all(-1).mean() > 0.97


@pytest.mark.parametrize(
    "scene, classes",
    [
        ("gym/HalfCheetah-v5", ("torso", "bthigh", "bshin", "bfoot", "fthigh", "fshin", "ffoot")),
        ("gym/Reacher-v5", ("robot", "gripper", "target")),
    ],
)
def test_the_recipe_tells_links_apart_of_a_robot_that_is_alone(scene: str, classes: tuple[str, ...], tmp_path: Path):
    out = tmp_path / "data"
    arguments = ["--episodes", "2", "--episodes_per_shard", "1", "--workers", "1", "--size", "48", "--scene", scene]
    assert cli.main(["gen-dataset", "--config", "datasets/gym.yaml", *arguments, "--out", str(out)]) == 0
    dataset = MultiViewDataset(out)
    assert dataset.class_names == ("background", *classes)
    assert set(np.unique(dataset.read("semantic"))) == set(range(len(dataset.class_names)))  # each is seen


def _arm_and_block(folder: Path, falls: bool) -> Path:
    """Write a model of an arm and a block beside it that hangs in the air or falls out of the world."""
    path = folder / f"{falls}.xml"
    path.write_text(
        f"""<mujoco><worldbody><body name="arm"><joint name="hinge" type="hinge" axis="0 1 0" range="-60 60"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="1"/></body>
        <body name="block" pos="0.3 0.2 0.1" gravcomp="{0 if falls else 1}"><freejoint/>
        <geom type="box" size="0.03 0.03 0.03"/></body></worldbody>
        <actuator><position joint="hinge" kp="20" ctrlrange="-1 1"/></actuator></mujoco>"""
    )
    return path


def test_cameras_stay_with_a_hand_when_what_it_held_falls_out_of_the_world(tmp_path: Path):
    stays, falls = (make_scene(str(_arm_and_block(tmp_path, each))) for each in (False, True))
    ball, same = stays.workspace(), falls.workspace()
    np.testing.assert_allclose(same.centre, ball.centre, atol=0.05)
    assert same.radius == pytest.approx(ball.radius, rel=0.15) and ball.radius < 0.5
    for _ in range(40):
        falls.env.step(np.zeros(1, np.float32))
    assert falls.data.body("block").xpos[2] < -4 * same.radius


def test_cameras_see_where_dice_fall_to(tmp_path: Path):
    path = tmp_path / "dice.xml"
    die = '<body pos="{} 0 1"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>'
    floor = '<geom type="plane" size="1 1 0.1"/>'
    path.write_text(f"<mujoco><worldbody>{floor}{die.format(-0.1)}{die.format(0.1)}</worldbody></mujoco>")
    scene = make_scene(str(path))
    ball = scene.workspace()
    for _ in range(40):
        scene.env.step(np.zeros(0, np.float32))
    fallen = scene.data.geom_xpos[1:]
    assert fallen[:, 2].max() < 0.1
    assert np.linalg.norm(fallen - ball.centre, axis=-1).max() < ball.radius
