"""push: what others get of an encoder or an agent, what its card says, and that it comes back as it was."""

import ast
import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from local_hub import LocalHub
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.push.artefact import without_paths
from nerf_rl.push.picture import LARGEST, write_picture

ENCODER_FILES = {"encoder.json", "encoder.safetensors", "field.json", "field.safetensors"}


def push(run: Path, *arguments: str) -> int:
    return cli.main(["push", str(run), *arguments])


def front(card: str) -> dict:
    return yaml.safe_load(card.split("---\n")[1])


def require_no_paths(files: dict[str, bytes], *folders: Path) -> None:
    """Fail if a file says where on this machine something is."""
    for name, content in files.items():
        for folder in (*folders, Path.home(), Path.cwd()):
            assert str(folder).encode() not in content, f"{name} tells of {folder}"


def test_an_encoder_comes_back_from_the_hub_as_it_was(
    tiny_encoder: Path, tiny_dataset: Path, tmp_path: Path, hub: LocalHub, capsys: pytest.CaptureFixture[str]
):
    assert push(tiny_encoder, "--to", "tests/encoder") == 0
    assert "pushed as hf://tests/encoder@" in capsys.readouterr().out
    files = hub.files("tests/encoder")
    assert set(files) == ENCODER_FILES | {".gitattributes", "README.md", "picture.png", "summary.json"}
    require_no_paths(files, tiny_encoder.parent, tiny_dataset.parent, tmp_path)
    here, there = Encoder.load(tiny_encoder), Encoder.load("hf://tests/encoder")
    images = torch.randint(0, 256, (3, 2, 24, 24, 3), dtype=torch.uint8)
    assert torch.equal(here.standardise(here.encode(images)), there.standardise(there.encode(images)))
    assert there.scene == here.scene and there.rig.names == here.rig.names

    out = tmp_path / "probe"
    assert cli.main(["probe", "--encoder", "hf://tests/encoder", "--data", str(tiny_dataset), "--out", str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["probe"]
    sheet = tmp_path / "sheet.png"
    keys = ["--data", str(tiny_dataset), "--png", str(sheet), "--frames", "1"]
    assert cli.main(["view", "hf://tests/encoder", *keys]) == 0
    assert sheet.stat().st_size > 0


def test_the_card_of_an_encoder_says_what_it_sees_and_knows(tiny_encoder: Path, tmp_path: Path):
    out = tmp_path / "folder"
    assert push(tiny_encoder, "--out", str(out), "--licence", "apache-2.0") == 0
    card, summary = (out / "README.md").read_text(), json.loads((tiny_encoder / "summary.json").read_text())
    head = front(card)
    assert head["license"] == "apache-2.0" and head["library_name"] == "nerf-rl" and "metaworld" in head["tags"]
    metrics = {metric["type"]: metric["value"] for metric in head["model-index"][0]["results"][0]["metrics"]}
    assert metrics["psnr"] == pytest.approx(summary["validation"]["psnr_db"], abs=1e-3)
    rig = Encoder.load(tiny_encoder).rig
    for name, pose in zip(rig.names, rig.camera_from_world, strict=True):
        position = np.linalg.inv(pose)[:3, 3]
        row = next(line for line in card.splitlines() if line.startswith(f"| {name} |"))
        assert ", ".join(f"{value:.3f}" for value in position) in row and "24 x 24" in row
    for name, figures in summary["probe"].items():
        assert any(line.startswith(f"| {name} | {figures['rmse_mm']:.1f} mm |") for line in card.splitlines())
    assert 'Encoder.load("folder")' in card and "![Held-out" in card
    assert (out / "picture.png").stat().st_size <= LARGEST
    assert (out / "encoder.safetensors").read_bytes() == (tiny_encoder / "encoder.safetensors").read_bytes()


def test_an_agent_is_evaluated_from_the_hub_with_the_encoder_that_it_brings(
    tiny_agent: Path, tiny_encoder: Path, tmp_path: Path, hub: LocalHub
):
    assert push(tiny_agent, "--to", "hf://tests/agent", "--private", "true") == 0
    assert hub.repositories["tests/agent"].private
    files = hub.files("tests/agent")
    own = {"policy.json", "policy.safetensors", "summary.json", "README.md", "picture.png", ".gitattributes"}
    assert set(files) == own | {f"encoder/{name}" for name in ENCODER_FILES}
    require_no_paths(files, tiny_agent.parent, tiny_encoder.parent, tmp_path)
    assert json.loads(files["policy.json"])["env"]["encoder"] == "encoder"
    results = []
    for name, run in (("here", str(tiny_agent)), ("there", "hf://tests/agent")):
        out = tmp_path / name
        assert cli.main(["evaluate", "--run", run, "--out", str(out), "--episodes", "2", "--envs", "1"]) == 0
        results.append(json.loads((out / "summary.json").read_text()))
    assert results[0] == results[1]
    sheet = tmp_path / "sheet.png"
    assert cli.main(["view", "hf://tests/agent", "--png", str(sheet), "--episodes", "1"]) == 0
    assert sheet.stat().st_size > 0


def test_the_card_of_an_agent_that_is_still_trained_does_not_call_it_unevaluated(tiny_agent: Path, tmp_path: Path):
    run = shutil.copytree(tiny_agent, tmp_path / "run")
    (run / "summary.json").unlink()
    assert push(run, "--out", str(tmp_path / "out")) == 0
    assert "It came without a summary of its run." in (tmp_path / "out" / "README.md").read_text()


def test_commands_and_lines_of_a_card_hold_any_name(tiny_agent: Path, tiny_encoder: Path, tmp_path: Path):
    for run in (tiny_agent, tiny_encoder):
        out = tmp_path / run.name / """my "agent's" #1"""
        assert push(run, "--out", str(out)) == 0
        blocks = re.findall("```(sh|python)\n(.*?)```", (out / "README.md").read_text(), re.DOTALL)
        assert sorted(language for language, _ in blocks) == ["python", "sh"]
        for language, block in blocks:
            if language == "sh":
                assert out.name in shlex.split(block)
            else:
                assert out.name in [node.value for node in ast.walk(ast.parse(block)) if isinstance(node, ast.Constant)]


@pytest.mark.parametrize(
    "scene, module",
    [("gym/my_tasks:Lift-v0", "my_tasks"), ("gym/shimmy:dm_control/walker-walk-v0", "shimmy"), ("gym/Ant-v5", "")],
)
def test_the_card_of_an_agent_says_what_module_its_environment_needs(
    scene: str, module: str, tiny_agent: Path, tmp_path: Path
):
    run, out = tmp_path / "agent", tmp_path / "folder"
    shutil.copytree(tiny_agent, run, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    policy = json.loads((run / "policy.json").read_text())
    (run / "policy.json").write_text(json.dumps({**policy, "env": {**policy["env"], "scene": scene}}))
    assert push(run, "--out", str(out)) == 0
    said = f"registered by the Python module `{module}`"
    assert (said in (out / "README.md").read_text()) == bool(module)


def test_the_card_of_an_agent_has_its_rate_its_interval_and_the_control_beside(
    tiny_agent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    blind = tmp_path / "blind"
    shutil.copytree(tiny_agent, blind, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    policy = json.loads((blind / "policy.json").read_text())
    (blind / "policy.json").write_text(json.dumps({**policy, "env": {**policy["env"], "control": "blind"}}))
    last = {"env_steps": 70, "episodes": 20, "mean_return": 1.0, "success_rate": 0.05, "ci_low": 0.01, "ci_high": 0.24}
    (blind / "summary.json").write_text(json.dumps({"evaluations": [last]}))
    out = tmp_path / "folder"
    assert push(tiny_agent, "--out", str(out), "--controls", f"[{blind}]") == 0
    card = (out / "README.md").read_text()
    own = json.loads((tiny_agent / "summary.json").read_text())["evaluations"][-1]
    rate = f"{own['success_rate']:.0%} [{own['ci_low']:.0%}, {own['ci_high']:.0%}]"
    assert f"| this agent | 80 | 2 | {rate} |" in card
    assert "| the same agent, trained with latents of zero | 70 | 20 | 5% [1%, 24%] | 1 |" in card
    metrics = front(card)["model-index"][0]["results"][0]["metrics"]
    assert {"type": "success_rate", "value": own["success_rate"]} in metrics
    assert "nerf-rl evaluate --run folder" in card and "`hand_x`" in card
    assert push(tiny_agent, "--out", str(tmp_path / "b"), "--controls", f"[{tiny_agent}]") == 2
    assert "is an agent with --control none" in capsys.readouterr().err
    (blind / "policy.json").write_text(
        json.dumps({**policy, "env": {**policy["env"], "control": "blind", "episode_steps": 7}})
    )
    assert push(tiny_agent, "--out", str(tmp_path / "c"), "--controls", f"[{blind}]") == 2
    assert "its scene, encoder or episodes are others" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["blind", "folder"]  # so that the next try finds it free
    assert push(blind, "--out", str(tmp_path / "own")) == 0
    for of_agent, told in ((card, "observes the latent"), ((tmp_path / "own/README.md").read_text(), "observes zeros")):
        assert f"It {told}" in of_agent


def test_training_on_an_encoder_of_the_hub_keeps_to_the_commit_it_began_with(
    tiny_encoder: Path, tmp_path: Path, hub: LocalHub, capsys: pytest.CaptureFixture[str]
):
    assert push(tiny_encoder, "--to", "tests/encoder@trial") == 0
    assert set(hub.files("tests/encoder", "main")) == {".gitattributes"}
    first, run = hub.repositories["tests/encoder"].branches["trial"], tmp_path / "run"
    keys = ["train-rl", "--encoder", "hf://tests/encoder@trial", "--out", str(run), *TINY_TRAINING, "--envs", "1"]
    assert cli.main(keys) == 0
    address = f"hf://tests/encoder@{first}"
    assert json.loads((run / "policy.json").read_text())["env"]["encoder"] == address
    assert yaml.safe_load((run / "config.yaml").read_text())["encoder"] == address
    assert push(run, "--out", str(tmp_path / "agent")) == 0  # takes the encoder along from there
    assert (tmp_path / "agent" / "encoder" / "encoder.safetensors").is_file()

    hub.repositories["tests/encoder"].commit("trial", {**hub.files("tests/encoder", "trial"), "summary.json": b"{}"})
    capsys.readouterr()
    assert cli.main([*keys, "--resume", "true"]) == 2
    assert "another --encoder" in capsys.readouterr().err
    assert cli.main([*keys[:1], "--encoder", address, *keys[3:], "--resume", "true"]) == 0


def test_pushing_again_takes_away_what_is_left_of_the_last_time(tiny_encoder: Path, tmp_path: Path, hub: LocalHub):
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("encoder.json", "encoder.safetensors"):
        shutil.copyfile(tiny_encoder / name, bare / name)
    assert push(tiny_encoder, "--to", "tests/encoder") == 0
    hub.repositories["tests/encoder"].commit("main", {**hub.files("tests/encoder"), "notes.md": b"the owner's"})
    assert push(bare, "--to", "tests/encoder") == 0
    left = set(hub.files("tests/encoder"))
    assert not left & {"field.json", "field.safetensors", "summary.json"}
    assert "notes.md" in left
    assert b"It came without a summary of its run." in hub.files("tests/encoder")["README.md"]


@pytest.mark.parametrize(
    "change, message",
    [
        ({"scene": "gym/antigravity:Flight-v0"}, "for which the module antigravity would be imported"),
        ({"encoder": "/etc"}, "wants an encoder from elsewhere: /etc"),
        ({"encoder": "hf://others/encoder"}, "wants an encoder from elsewhere"),
    ],
)
@pytest.mark.parametrize("command", ["evaluate", "view"])
def test_an_agent_of_somebody_else_imports_nothing_and_opens_nothing(
    command: str,
    change: dict,
    message: str,
    tiny_agent: Path,
    tmp_path: Path,
    hub: LocalHub,
    capsys: pytest.CaptureFixture[str],
):
    assert push(tiny_agent, "--to", "tests/agent") == 0
    files = hub.files("tests/agent")
    policy = json.loads(files["policy.json"])
    policy["env"] |= change
    hub.repositories["tests/agent"].commit("main", {**files, "policy.json": json.dumps(policy).encode()})
    out = ["--run", "hf://tests/agent", "--out", str(tmp_path / "e")]
    keys = out if command == "evaluate" else ["hf://tests/agent", "--png", str(tmp_path / "view.png")]
    capsys.readouterr()
    assert cli.main([command, *keys]) == 2
    assert message in capsys.readouterr().err
    assert "antigravity" not in sys.modules and not (tmp_path / "e").exists()


def test_the_hub_is_told_when_it_refuses(
    tiny_encoder: Path,
    tiny_agent: Path,
    hub: LocalHub,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    assert push(tiny_encoder, "--to", "others/encoder") == 2
    assert "does not permit it (403: you may not create repositories of others" in capsys.readouterr().err
    assert push(tiny_encoder, "--to", "tests/encoder") == 0
    assert push(tiny_agent, "--to", "tests/encoder") == 2
    assert "holds another kind of artefact (encoder.json)" in capsys.readouterr().err
    monkeypatch.delenv("HF_TOKEN")
    assert push(tiny_encoder, "--to", "tests/encoder") == 2
    told = capsys.readouterr().err
    assert "does not permit it (401" in told and "log in with 'hf auth login', or set HF_TOKEN" in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    "run, arguments, message",
    [
        ("encoder", [], "say where: --to USER/NAME pushes to the Hub, --out FOLDER writes"),
        ("encoder", ["--to", "name"], "'name' is no address on the Hugging Face Hub"),
        ("encoder", ["--out", "free", "--licence", "MIT or so"], "--licence is a name such as mit"),
        ("encoder", ["--out", "used"], "output folder used already exists"),
        ("encoder", ["--out", "used/file/new"], "used/file is a file and no folder"),
        ("encoder", ["--out", "free", "--controls", "[x]"], "an encoder has none"),
        ("encoder/checkpoints", ["--out", "free"], "is not an encoder or an agent: it holds no encoder.json"),
        ("nowhere", ["--out", "free"], "is not an encoder or an agent"),
    ],
)
def test_what_cannot_be_pushed_is_told_before_anything_is_written(
    run: str,
    arguments: list[str],
    message: str,
    tiny_encoder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "file").touch()
    source = Path(str(tiny_encoder) + run.removeprefix("encoder")) if run != "nowhere" else Path(run)
    assert push(source, *arguments) == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["used"]


def test_a_folder_that_is_there_and_empty_is_filled(tiny_encoder: Path, tmp_path: Path):
    out = tmp_path / "out"
    out.mkdir()
    run = tmp_path / "run"
    run.mkdir()
    for name in ("encoder.json", "encoder.safetensors", "summary.json"):
        shutil.copyfile(tiny_encoder / name, run / name)
    summary = (run / "summary.json").read_bytes()
    (run / "summary.json").write_bytes(b"{")
    assert push(run, "--out", str(out)) == 2
    assert not any(out.iterdir())
    (run / "summary.json").write_bytes(summary)
    assert push(run, "--out", str(out)) == 0
    names = {"README.md", "encoder.json", "encoder.safetensors", "summary.json"}
    assert {path.name for path in out.iterdir()} == names


def test_a_large_picture_is_made_smaller(tmp_path: Path):
    run, out = tmp_path / "run", tmp_path / "out"
    (run / "reconstructions").mkdir(parents=True)
    out.mkdir()
    noise = np.random.default_rng(0).integers(0, 256, (700, 900, 3), dtype=np.uint8)
    cv2.imwrite(str(run / "reconstructions" / "step_000100.png"), noise)
    cv2.imwrite(str(run / "reconstructions" / "step_000050.png"), noise[:10])
    assert write_picture(run, out)
    height, width = cv2.imread(str(out / "picture.png")).shape[:2]
    assert (out / "picture.png").stat().st_size <= LARGEST and abs(width / height - 9 / 7) < 0.02
    assert not write_picture(tmp_path / "nothing", out)


def test_absolute_paths_lose_their_folders_wherever_they_stand():
    content = {
        "scene": {"name": "/home/user/scenes/arm.xml"},
        "list": ["C:\\Users\\me\\x.h5", "~/y", "metaworld/drawer-open-v3", "gym/module:Id", 3, None],
    }
    kept = {"scene": {"name": "arm.xml"}, "list": ["x.h5", "y", "metaworld/drawer-open-v3", "gym/module:Id", 3, None]}
    assert without_paths(content) == kept
