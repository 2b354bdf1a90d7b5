"""Where things are computed: nothing mixes devices, and a device that is not there is told in a sentence."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.machine.devices import check_device, check_device_name, resolve_device
from nerf_rl.rl.environments.make import spec_from_json

GPU = torch.cuda.is_available()
COMMANDS = {
    "train-rl": ["--out"],
    "evaluate": ["--run", "nothing", "--out"],
    "probe": ["--encoder", "nothing", "--data", "nothing", "--out"],
    "view": ["nothing", "--png"],
}


@pytest.fixture(scope="module")
def passed(tiny_encoder: Path, tiny_dataset: Path) -> tuple[list[str], str]:
    """The checks that passed on a fake GPU, and what went wrong in the first that did not."""
    program = [sys.executable, str(Path(__file__).parents[1] / "fake_gpu.py"), str(tiny_encoder), str(tiny_dataset)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=300)
    return done.stdout.split(), done.stderr[-2000:]


@pytest.mark.parametrize("part", ["policy", "values", "rays", "frames", "observation", "learner"])
def test_everything_is_computed_where_its_weights_are_and_comes_back(part: str, passed: tuple[list[str], str]) -> None:
    assert part in passed[0], passed[1]


def test_a_policy_does_not_remember_where_it_was_trained(tiny_agent: Path) -> None:
    spec = json.loads((tiny_agent / "policy.json").read_text())["env"]
    assert "device" not in spec and spec_from_json(spec).scene == "metaworld/drawer-open-v3"


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", ["gpu", "cuda:x", "CUDA", "", "cuda:-1", "meta"])
def test_an_unknown_device_is_told_in_a_sentence(
    command: str, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out.png")
    assert cli.main([command, *COMMANDS[command], out, f"--device={name}"]) == 2
    message = capsys.readouterr().err
    assert f"unknown device '{name}'" in message and "auto, cpu, cuda" in message and message.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["train-rl", "evaluate", "probe", "view"])
def test_an_absent_device_is_told_with_what_there_is_before_anything_is_written(
    command: str,
    tiny_dataset: Path,
    tiny_encoder: Path,
    tiny_agent: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = {
        "train-rl": ["--out"],
        "evaluate": ["--run", str(tiny_agent), "--out"],
        "probe": ["--encoder", str(tiny_encoder), "--data", str(tiny_dataset), "--out"],
        "view": [str(tiny_encoder), "--png"],
    }[command]
    absent = "cuda:99" if GPU else "cuda"
    assert cli.main([command, *words, str(tmp_path / "out.png"), "--device", absent]) == 2
    message = capsys.readouterr().err
    assert f"device '{absent}' is not on this machine" in message and "available: cpu" in message
    assert message.count("\n") == 1 and not list(tmp_path.iterdir())


@pytest.mark.parametrize("there", [False, True])
def test_auto_is_a_gpu_only_where_there_is_one(there: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: int(there))
    assert resolve_device("auto").type == ("cuda" if there else "cpu")
    assert resolve_device("cpu") == torch.device("cpu")
    for name in ("auto", "cpu"):
        check_device(name)
    check_device_name("cuda:3")
    with pytest.raises(UserError, match="is not on this machine"):
        check_device("cuda:99")


@pytest.mark.skipif(not GPU, reason="needs a GPU")
def test_commands_run_on_a_gpu(tiny_dataset: Path, tiny_encoder: Path, tiny_agent: Path, tmp_path: Path) -> None:
    from tiny_recipes import TINY_TRAINING

    device, run = ["--device", "cuda"], tmp_path / "run"
    assert cli.main(["train-rl", "--encoder", str(tiny_encoder), "--out", str(run), *TINY_TRAINING, *device]) == 0
    assert cli.main(["evaluate", "--run", str(run), "--out", str(tmp_path / "e"), "--episodes", "2", *device]) == 0
    probe = ["probe", "--encoder", str(tiny_encoder), "--data", str(tiny_dataset)]
    assert cli.main([*probe, *device]) == 0
    for folder in (tiny_encoder, run):
        picture = tmp_path / f"{folder.name}.png"
        assert cli.main(["view", str(folder), "--png", str(picture), "--frames", "2", "--episodes", "1", *device]) == 0
