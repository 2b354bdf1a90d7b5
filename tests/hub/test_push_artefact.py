"""What push looks at before it gives it away, and what it leaves as it is; encoders and agents that nobody trained."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.cameras import geometry as cameras
from nerf_rl.pretrain.config import EncoderConfig, FieldConfig
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import described_classes
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import FieldBounds, RadianceField
from nerf_rl.rl.agents.policy import Policy, make_actor
from nerf_rl.rl.agents.policy_file import encoder_digest
from nerf_rl.rl.config import NetworkConfig
from nerf_rl.rl.environments.make import EnvSpec

CAMERAS = ("/left", "~right", "top")
CLASSES = ["background", "//unnamed_body_0", "walker/torso"]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The run folder of an encoder with a radiance field, whose scene names its parts as MJCF and dm_control may."""
    poses = np.stack([cameras.look_at(np.array([0.0, 0.6, 0.1]), 0.9, 20.0 + 60 * i, -30.0) for i in range(3)])
    intrinsics = np.stack([cameras.intrinsics_from_fovy(45.0, 8, 8)] * 3)
    encoder = Encoder(EncoderConfig(latent=6, channels=[8], hidden=8), EncoderRig(CAMERAS, intrinsics, poses, 8, 8))
    encoder.scene = "/home/user/scenes/arm.xml"
    folder = tmp_path / "run"
    folder.mkdir()
    encoder.save(folder, {"classes": CLASSES, "palette": [[0, 0, 0]] * 3, "dataset": {"sha256": "0", "folder": "/d"}})
    sizes = FieldConfig(width=8, layers=1, frequencies=1, plane_size=4, object_plane_size=0, plane_features=2)
    RadianceField(sizes, FieldBounds(0.1, 3.0, (0.0, 0.0, 0.0), 1.0), 6, 3, 0).save(folder)
    return folder


def make_agent(folder: Path, encoder: Path) -> Path:
    """Write the run folder of an agent that sees by an encoder, and observes a column beside its latent."""
    network = NetworkConfig(hidden=[8, 8])
    spec = EnvSpec("/home/user/scenes/arm.xml", str(encoder), 1, 10, observe=("/left/x",))
    folder.mkdir()
    Policy(make_actor(7, 2, network), spec, network, 7, 2, ["/left/x"], encoder_digest(encoder), 10).save(folder)
    (folder / "summary.json").write_text('{"evaluations": []}')
    return folder


def push(run: Path, out: Path) -> int:
    return cli.main(["push", str(run), "--out", str(out)])


def cut_off(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


@pytest.mark.parametrize(
    "file, damage, message",
    [
        ("encoder.safetensors", cut_off, "encoder.safetensors is not a file of weights: it is damaged"),
        ("field.safetensors", cut_off, "field.safetensors is not a file of weights: it is damaged"),
        ("field.safetensors", Path.unlink, "field.safetensors is not a file of weights: it does not exist"),
        ("agent/policy.safetensors", cut_off, "policy.safetensors is not a file of weights: it is damaged"),
    ],
)
def test_damaged_weights_are_not_given_away(
    file: str,
    damage: Callable[[Path], None],
    message: str,
    run: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    pushed = make_agent(run / "agent", run) if file.startswith("agent") else run
    damage(run / file)
    assert push(pushed, tmp_path / "out") == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_names_that_look_like_paths_stay_and_paths_do_not(run: Path, tmp_path: Path):
    (run / "summary.json").write_text(json.dumps({"hardly_shown": CLASSES, "device": "/dev/cuda"}))
    agent, out = make_agent(tmp_path / "agent", run), tmp_path / "out"
    assert push(run, out) == push(agent, tmp_path / "pushed") == 0
    encoder = Encoder.load(out)
    encoder.rig.require_same(Encoder.load(run).rig)
    assert encoder.rig.names == CAMERAS and encoder.scene == "arm.xml"
    assert described_classes(out)[0] == CLASSES
    assert json.loads((out / "summary.json").read_text()) == {"hardly_shown": CLASSES, "device": "cuda"}
    policy = Policy.load(tmp_path / "pushed")
    assert policy.spec.observe == ("/left/x",) and policy.proprio_names == ["/left/x"]
    assert policy.spec.scene == "arm.xml" and "/home" not in (tmp_path / "pushed" / "policy.json").read_text()


@pytest.mark.parametrize(
    "file, change, message",
    [
        ("encoder.json", {"dataset": None}, "dataset is None instead of a mapping"),
        ("encoder.json", {"dataset": "sha256 x"}, "dataset is 'sha256 x' instead of a mapping"),
        ("encoder.json", {"dataset": {"sha256": 7}}, "dataset.sha256 is 7 instead of a text"),
        ("summary.json", {"validation": "y"}, "validation is 'y' instead of a mapping"),
        ("summary.json", {"class_iou": {"a": "b"}}, "class_iou.a is 'b' instead of a number"),
        ("summary.json", {"class_iou": {"a": 1}, "class_share": {"a": None}}, "class_share.a is None"),
        ("summary.json", {"probe": {"x": {}}}, "probe.x is a mapping instead of one with r2"),
        ("summary.json", {"joint_probe": {"x": {"r2": 1.0, "rmse_deg": "y"}}}, "joint_probe.x.rmse_deg is 'y'"),
        ("summary.json", {"probe_random_encoder": []}, "probe_random_encoder is a list of 0 instead of a mapping"),
    ],
)
def test_descriptions_that_no_card_can_tell_of_are_refused_in_a_sentence(
    file: str, change: dict, message: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = run / file
    path.write_text(json.dumps({**(json.loads(path.read_text()) if path.exists() else {}), **change}))
    assert push(run, tmp_path / "out") == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_figures_that_could_not_be_measured_are_unknown(run: Path, tmp_path: Path):
    summary = {"validation": {"psnr_db": 20.0, "miou": None}, "class_iou": {"robot": None}, "probe": {}}
    (run / "summary.json").write_text(json.dumps(summary))
    assert push(run, tmp_path / "out") == 0
    card = (tmp_path / "out" / "README.md").read_text()
    assert "| mean IoU of the classes | unknown |" in card and "| robot | unknown | unknown |" in card


def test_a_folder_that_cannot_be_made_is_told_in_a_sentence(run: Path, capsys: pytest.CaptureFixture[str]):
    assert push(run, Path("/proc/nobody/makes")) == 2
    told = capsys.readouterr().err
    assert "/proc/nobody/makes cannot be written (" in told and told.count("\n") == 1
