"""No command overwrites what it reads, whatever it is told to."""

import shutil
from pathlib import Path

import pytest

from nerf_rl import cli

INPUTS = {
    "export": "export {input} --out {out}",
    "gen-dataset": "gen-dataset --scene metaworld/drawer-open-v3 --out {out} --episode_steps 2 --frames_per_episode 1"
    " --behaviour.random 0 --behaviour.replay 1 --behaviour.states {input}",
    "merge": "merge {input} --out {out}",
    "pretrain": "pretrain --config pretrain/demo.yaml --data {input} --out {out}",
    "probe": "probe --encoder {encoder} --data {input} --out {out}",
    "probe-encoder": "probe --encoder {input} --data {dataset} --out {out}",
    "train-rl": "train-rl --encoder {input} --out {out}",
    "train-rl-seeds": "train-rl --encoder {input} --seeds 0..1 --out {out}",
    "tune": "tune --config rl/tune.yaml --overrides.scene metaworld/drawer-open-v3 --overrides.encoder {input}"
    " --out {out}",
    "evaluate": "evaluate --run {input} --out {out}",
    "evaluate-encoder": "evaluate --run {agent} --encoder {input} --out {out}",
}


@pytest.fixture
def folder_of(
    tmp_path: Path, tiny_dataset: Path, tiny_encoder: Path, tiny_agent: Path, request: pytest.FixtureRequest
) -> dict[str, Path]:
    """What commands read, and a copy of what the one under test would lose."""
    lost = tiny_dataset
    if "encoder" in request.param or request.param in ("train-rl", "train-rl-seeds", "tune"):
        lost = tiny_encoder
    elif request.param == "evaluate":
        lost = tiny_agent
    elif request.param == "merge":
        shutil.copytree(tiny_dataset, tmp_path / "results" / "input" / "parts" / "1-of-1")
    shutil.copytree(lost, tmp_path / "results" / "input", dirs_exist_ok=True)
    (tmp_path / "results" / "provenance.json").write_text("{}")  # a folder that we may overwrite
    return {
        "input": tmp_path / "results" / "input",
        "encoder": tiny_encoder,
        "dataset": tiny_dataset,
        "agent": tiny_agent,
    }


@pytest.mark.parametrize("above", [False, True])
@pytest.mark.parametrize("folder_of, words", INPUTS.items(), ids=INPUTS, indirect=["folder_of"])
def test_an_input_is_not_overwritten(
    folder_of: dict[str, Path],
    words: str,
    above: bool,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
):
    """Neither where it is the output folder itself, nor where it lies in it, however the path is written."""
    given = folder_of["input"]
    monkeypatch.chdir(given.parent)
    (given.parent / "pretrain").symlink_to(Path(cli.__file__).parents[1] / "pretrain")
    (given.parent / "rl").symlink_to(Path(cli.__file__).parents[1] / "rl")
    out = Path("../results") if above else Path("input")
    if above or "merge" not in words:  # parts may be put together where they lie
        before = sorted(given.rglob("*"))
        arguments = [word.format(out=out, **folder_of) for word in words.split()]
        assert cli.main([*arguments, "--overwrite", "true"]) == 2
        assert f"{given} lies in the output folder {out}; use another --out" in capsys.readouterr().err
        assert sorted(given.rglob("*")) == before
