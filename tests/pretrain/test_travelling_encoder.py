"""An encoder of a robot that travels: however far it has come, it is where it was in the frame that goes with it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from tiny_recipes import travelling_recipe

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import MissingFileError
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatch, RayBatches
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.data.view_batches import ViewBatches
from nerf_rl.pretrain.measures.probe_targets import joint_targets, varying
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule

CONFIG = PretrainConfig("data", "out", scenes_per_step=6, rays_per_scene=200)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[MultiViewDataset, MultiViewDataset]:
    """The same poses of a robot, rendered at home and up to 20 m away."""
    folder = tmp_path_factory.mktemp("pair")
    rng = np.random.default_rng(0)
    qpos = np.zeros((4, 3, 9))
    qpos[..., 1:] = rng.uniform(-0.3, 0.3, (4, 3, 8))
    datasets = []
    for name, most in (("home", 0.0), ("away", 20.0)):
        qpos[..., 0] = np.linspace(0.0, most, 12).reshape(4, 3)
        np.savez(folder / f"{name}.npz", qpos=qpos)
        recipe = travelling_recipe().replace("steps: 30", "steps: 2").replace("random: {count: 1}", "random: {}")
        (folder / f"{name}.yaml").write_text(recipe)
        words = ["--config", str(folder / f"{name}.yaml"), "--out", str(folder / name)]
        replay = ["--behaviour.replay", "1", "--behaviour.random", "0", "--behaviour.states"]
        assert cli.main(["gen-dataset", *words, *replay, str(folder / f"{name}.npz")]) == 0
        datasets.append(MultiViewDataset(folder / name))
    return datasets[0], datasets[1]


def test_the_field_and_what_it_is_taught_do_not_depend_on_how_far_the_robot_has_come(
    pair: tuple[MultiViewDataset, MultiViewDataset],
):
    home, away = pair
    assert np.ptp(away.read("state/qpos")[:, 0]) == 20.0
    near, far = (measure(dataset, CONFIG) for dataset in pair)
    np.testing.assert_allclose(near.bounds.centre, far.bounds.centre, atol=0.2)  # the floor has another pattern there
    assert far.bounds.half_extent < 1.2 * near.bounds.half_extent
    np.testing.assert_allclose(far.anchors.mean, near.anchors.mean, atol=0.02)
    batches: list[RayBatch] = []
    for dataset, statistics in ((home, near), (away, far)):
        batches.append(RayBatches(dataset, CONFIG, statistics)[0])
        robot = batches[-1].semantic == dataset.class_names.index("robot")
        surface = batches[-1].origins + batches[-1].depth[..., None] * batches[-1].directions
        assert robot.any() and surface[robot][:, :2].abs().max() < 1.5
    torch.testing.assert_close(*(batch.projections for batch in batches), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(*(batch.middles for batch in batches), atol=0.02, rtol=0.0)
    views = [ViewBatches(dataset, CONFIG, statistics)[0] for dataset, statistics in ((home, near), (away, far))]
    torch.testing.assert_close(*(batch.state for batch in views), atol=1e-3, rtol=1e-3)
    assert views[1].state.shape[1] == 1  # its height; how far it has come is no part of what cameras can tell


def test_held_out_pictures_are_drawn_where_the_field_lives(pair: tuple[MultiViewDataset, MultiViewDataset]):
    """A field whose encoder knows nothing looks the same from cameras that have come 20 m and from those at home."""
    statistics, rig = measure(pair[0], CONFIG), EncoderRig.of_dataset(pair[0])
    drawn = []
    for dataset in pair:
        torch.manual_seed(0)
        module = SnerlModule(CONFIG, dataset, statistics, rig)
        for parameter in module.encoder.parameters():
            parameter.data.zero_()
        drawn.append([module.render_frame(frame) for frame in (0, 11)])
    for home, away in zip(*drawn, strict=True):
        np.testing.assert_allclose(away.depth, home.depth, atol=1e-3)
        np.testing.assert_allclose(away.rgb, home.rgb, atol=1e-3)
    assert np.ptp(drawn[0][0].depth) > 0.1


def test_how_far_a_robot_has_come_is_not_looked_for(pair: tuple[MultiViewDataset, MultiViewDataset]):
    away = pair[1]
    targets = joint_targets(away, np.arange(len(away)))
    found = {target.name: np.ptp(target.values) for target in targets}
    assert found["rootx"] == 0.0 and found["rootz"] > 0.05 and len(found) == 9
    assert "rootx" not in [targets[i].name for i in varying(targets)]


def test_where_cameras_see_nothing_of_the_state_it_cannot_be_learnt_from(
    tmp_path: Path, tiny_pretraining_recipe: Path, capsys: pytest.CaptureFixture[str]
):
    """A swimmer's columns are where its torso is, in a plane, which its cameras follow."""
    (tmp_path / "data.yaml").write_text(travelling_recipe().replace("HalfCheetah", "Swimmer"))
    data, encoder = str(tmp_path / "data"), str(tmp_path / "encoder")
    assert cli.main(["gen-dataset", "--config", str(tmp_path / "data.yaml"), "--out", data]) == 0
    words = ["pretrain", "--config", str(tiny_pretraining_recipe), "--data", data, "--out"]
    capsys.readouterr()
    assert cli.main([*words, str(tmp_path / "none"), "--objective", "supervised"]) == 2
    assert "(torso_x, torso_y, torso_z) varies as its encoder's cameras see it" in capsys.readouterr().err
    assert cli.main([*words, encoder, "--objective", "random"]) == 0
    assert cli.main(["probe", "--encoder", encoder, "--data", data, "--frames", "9", "--ceiling_steps", "2"]) == 0
    assert "no supervised encoder: no column of the true state varies" in capsys.readouterr().out


def test_an_encoder_says_which_body_its_cameras_follow_and_is_probed_and_shown(
    travelling_encoder: Path, travelling_dataset: Path, tmp_path: Path
):
    frame = Encoder.load(travelling_encoder).rig.tracking_frame
    assert frame is not None and (frame.body, frame.axes) == ("torso", "xy")
    words = ["--encoder", str(travelling_encoder), "--data", str(travelling_dataset)]
    assert cli.main(["probe", *words, "--out", str(tmp_path / "probe"), "--frames", "9"]) == 0
    assert set(json.loads((tmp_path / "probe" / "summary.json").read_text())["probe"]) == {"torso_z"}
    assert cli.main(["view", str(travelling_encoder), "--save", str(tmp_path / "view.html"), "--frames", "2"]) == 0
    assert (tmp_path / "view.html").stat().st_size > 1000


@pytest.mark.parametrize("frame", [None, {"body": ["torso"], "axes": "xy"}, {"body": "torso", "axes": "yz"}])
def test_a_strange_frame_in_an_artefact_is_damage(frame: object, travelling_encoder: Path, tmp_path: Path):
    folder = tmp_path / "encoder"
    shutil.copytree(travelling_encoder, folder)
    description = json.loads((folder / DESCRIPTION).read_text())
    description["rig"]["tracking_frame"] = frame
    (folder / DESCRIPTION).write_text(json.dumps(description))
    with pytest.raises(MissingFileError, match=r"is damaged .*tracking_frame"):
        Encoder.load(folder)
