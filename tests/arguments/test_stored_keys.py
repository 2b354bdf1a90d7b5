"""What an earlier version began can be gone on with: a key that there was not yet counts as its default."""

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import optuna
import pytest
import yaml
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.arguments.stored_keys import require_same_keys, with_defaults
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS
from nerf_rl.errors import UserError
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import plain
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.tuning.config import TuneConfig
from nerf_rl.tuning.storage import open_storage

FIRST, SECOND = f"{SHARDS}/000000.h5", f"{SHARDS}/000001.h5"


def without(content: dict[str, Any], *path: str | int) -> dict[str, Any]:
    """Return a copy without a key, however deep."""
    copy = json.loads(json.dumps(content))
    inner = copy
    for key in path[:-1]:
        inner = inner[key]
    del inner[path[-1]]
    return copy


@pytest.mark.parametrize(
    "config, words, path",
    [
        (PretrainConfig, ["--data", "d", "--out", "o"], ("coarse_to_fine",)),
        (PretrainConfig, ["--data", "d", "--out", "o"], ("radiance_field", "free_frames")),
        (TrainRLConfig, ["--out", "o"], ("noise", "epsilon_z_kind")),
        (TrainRLConfig, ["--out", "o"], ("learning_starts",)),
        (TuneConfig, ["--out", "o", "--space", '{"envs": {"low": 1, "high": 2}}'], ("space", "envs", "step")),
        (GenDatasetConfig, ["--out", "o", "--rig.cameras", '[{"name": "top"}]'], ("rig", "cameras", 0, "follow")),
    ],
)  # fmt: skip
def test_a_key_that_is_absent_at_any_depth_is_its_default(config: type, words: list[str], path: tuple, tmp_path: Path):
    commands = {PretrainConfig: "pretrain", TrainRLConfig: "train-rl", TuneConfig: "tune"}
    whole = plain(cli.parse(commands.get(config, "gen-dataset"), words))
    assert with_defaults(without(whole, *path), config) == whole
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(without(whole, *path)))
    require_same_keys(tmp_path, whole, config)
    inner = whole
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = "other"
    with pytest.raises(UserError, match=f"was begun with another --{path[0]}"):
        require_same_keys(tmp_path, whole, config)


@pytest.mark.parametrize("content", ["", "- a", "{", "\x00", "a: " + "[" * 5000])
def test_a_damaged_configuration_is_told(tmp_path: Path, content: str):
    (tmp_path / "config.yaml").write_text(content)
    with pytest.raises(UserError, match=r"config\.yaml is damaged, so that nothing tells what the run was begun with"):
        require_same_keys(tmp_path, {"seed": 0}, TrainRLConfig)


@pytest.fixture(scope="module")
def unchanged(tiny_dataset: Path, tiny_recipe: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset as it is where two of the keys were not known yet when it was begun; tests change copies."""
    folder = tmp_path_factory.mktemp("older")
    shutil.copy(tiny_dataset / "provenance.json", folder)
    plan = without(without(read_json(tiny_dataset / "plan.json"), "behaviour", "replay"), "classes")
    write_json(folder / "plan.json", plan)
    assert cli.main(["gen-dataset", "--config", str(tiny_recipe), "--out", str(folder), "--resume", "true"]) == 0
    digest = hashlib.sha256(json.dumps(plan).encode()).hexdigest()
    for shard in (FIRST, SECOND):
        with h5py.File(folder / shard) as file:
            assert file.attrs["plan"] == digest
    return folder


@pytest.fixture
def older(unchanged: Path, tmp_path: Path) -> Path:
    """That dataset, to be changed."""
    return shutil.copytree(unchanged, tmp_path / "older")


def test_a_dataset_of_an_earlier_version_is_resumed_and_keeps_its_plan(older: Path, tiny_recipe: Path):
    kept, plan = (older / FIRST).read_bytes(), (older / "plan.json").read_bytes()
    time = (older / FIRST).stat().st_mtime_ns
    for name in (SECOND, MANIFEST, "summary.json"):
        (older / name).unlink()
    arguments = ["--config", str(tiny_recipe), "--out", str(older), "--resume", "true"]
    assert cli.main(["gen-dataset", *arguments]) == 0
    assert (older / FIRST).read_bytes() == kept and (older / FIRST).stat().st_mtime_ns == time
    assert (older / "plan.json").read_bytes() == plan
    assert read_json(older / MANIFEST)["config"] == json.loads(plan)
    assert cli.main(["gen-dataset", *arguments, "--seed", "4"]) == 2
    assert cli.main(["check", str(older)]) == 0


@pytest.mark.parametrize("damaged", [SECOND, MANIFEST])
def test_a_dataset_of_an_earlier_version_is_repaired_to_the_same_bytes(older: Path, damaged: str):
    before = (older / damaged).read_bytes()
    content = bytearray(before)
    content[len(content) // 2] ^= 1
    (older / damaged).write_bytes(content)
    assert cli.main(["check", str(older)]) == 1
    assert cli.main(["check", str(older), "--repair", "true", "--workers", "1"]) == 0
    assert (older / damaged).read_bytes() == before


def test_an_agent_of_an_earlier_version_is_resumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "agent"
    arguments = ["train-rl", "--out", str(out), *TINY_TRAINING]
    assert cli.main(arguments) == 0
    config = yaml.safe_load((out / "config.yaml").read_text())
    older = without(without(config, "noise", "epsilon_z_kind"), "learning_starts")
    (out / "config.yaml").write_text(yaml.safe_dump(older))
    assert cli.main([*arguments, "--resume", "true", "--noise.epsilon_z_kind", "anywhere"]) == 2
    assert "was begun with another --noise; " in capsys.readouterr().err
    assert cli.main([*arguments, "--resume", "true"]) == 0


def test_an_encoder_of_an_earlier_version_is_resumed(
    tiny_encoder: Path, tiny_dataset: Path, tiny_pretraining_recipe: Path, tmp_path: Path, capsys: Any
):
    out = shutil.copytree(tiny_encoder, tmp_path / "run")
    config = yaml.safe_load((out / "config.yaml").read_text())
    (out / "config.yaml").write_text(yaml.safe_dump(without(without(config, "losses", "depth"), "change_boost")))
    arguments = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(out)]
    assert cli.main(["pretrain", *arguments, "--resume", "true", "--change_boost", "1"]) == 2
    assert "was begun with another --change_boost" in capsys.readouterr().err
    assert cli.main(["pretrain", *arguments, "--resume", "true"]) == 0


@pytest.fixture
def study(tmp_path: Path) -> Callable[..., int]:
    """Run a tiny search; returns its exit code."""
    space = {"learner.tau": {"low": 0.01, "high": 0.02}}
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(yaml.safe_dump({"space": space, "overrides": {"scene": "metaworld/drawer-open-v3"}}))
    arguments = ["--config", str(recipe), "--out", str(tmp_path / "search"), "--trials", "1", "--workers", "1"]
    words = " ".join(TINY_TRAINING).replace("[16, 16]", "[16,16]").split()
    keys = dict(zip((word.removeprefix("--") for word in words[::2]), words[1::2], strict=True))
    overrides = {key: json.loads(value) for key, value in keys.items()}

    def run(*more: str) -> int:
        return cli.main(["tune", *arguments, "--overrides", json.dumps(overrides), *more])

    return run


def test_a_search_of_an_earlier_version_is_resumed(study: Callable[..., int], tmp_path: Path, capsys: Any):
    assert study() == 0
    out = tmp_path / "search"
    config = yaml.safe_load((out / "config.yaml").read_text())
    (out / "config.yaml").write_text(yaml.safe_dump(without(without(config, "prune_after"), "whale", "mode")))
    begun = optuna.load_study(study_name="tune", storage=open_storage("", out))
    content = without(without(begun.user_attrs["content"], "prune_after"), "train-rl's noise", "epsilon_z_kind")
    begun.set_user_attr("content", content)
    assert study("--resume", "true", "--prune_after", "0.5") == 2
    assert "was begun with another --prune_after" in capsys.readouterr().err
    assert study("--resume", "true") == 0
