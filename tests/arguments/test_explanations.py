"""Wrong keys and values: each told in a sentence that names the key, what it takes and what was given."""

import sys
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.arguments.parsing import config_of
from nerf_rl.datasets.config import GenDatasetConfig
from nerf_rl.errors import UserError

DATASET = ["gen-dataset", "--scene", "s", "--out", "o"]
ENCODER = ["pretrain", "--data", "d", "--out", "o"]
AGENT, SEARCH = ["train-rl", "--out", "o"], ["tune", "--out", "o"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([*AGENT, "--envs", "x"], "--envs: expected int, got x"),
        ([*AGENT, "--steps_after_success", "0.5"], "--steps_after_success: expected int or null, got 0.5"),
        ([*ENCODER, "--max_minutes", "[1]"], "--max_minutes: expected float or null, got [1]"),
        ([*AGENT, "--network.hidden", "3"], "--network.hidden: expected list, got 3"),
        ([*DATASET, "--rig", "z"], "--rig: expected keys, or a file of them, got z"),
        ([*DATASET, "--rig", "no.module"], "--rig: expected keys, or a file of them, got no.module"),
        (
            [*DATASET, "--rig", '{"random": {"lookat_spread": "z"}}'],
            "--rig.random.lookat_spread: expected float or null, got z",
        ),
        ([*DATASET, "--rig.rings", '[{"name": 1}]'], "--rig.rings: name: expected str, got 1"),
        ([*SEARCH, "--space", '{"a": {"low": "x"}}'], "--space: low: expected float or null, got x"),
        ([*SEARCH, "--space", '{"a": {"choices": 3}}'], "--space: choices: expected list or null, got 3"),
        ([*SEARCH, "--space", '{"a": 3}'], "--space: expected keys, got 3"),
    ],
)
def test_a_value_of_the_wrong_kind_is_told_with_what_its_key_takes(words: list[str], told: str):
    with pytest.raises(UserError) as refusal:
        cli.parse(words[0], words[1:])
    assert str(refusal.value) == told


@pytest.mark.parametrize("word", ["--stop_when.miou", "--encoder.nope"])
def test_a_key_within_one_that_has_none_is_unknown(word: str):
    with pytest.raises(UserError, match=f"^unknown key '{word[2:]}' "):
        cli.parse("pretrain", [*ENCODER[1:], word, "3"])


@pytest.mark.parametrize(
    ("command", "recipe", "told"),
    [
        ("gen-dataset", "rig: a_module.Rig", "rig must be keys (cameras.name, "),
        ("gen-dataset", "rig: {class_path: a_module.Rig}", "unknown key 'rig.class_path'"),
        ("gen-dataset", "rig.class_path: a_module.Rig", "unknown key 'rig.class_path'"),
        ("gen-dataset", "class_path: a_module.Rig", "unknown key 'class_path'"),
        ("gen-dataset", "rig: {rings: [a_module.Rig]}", "rig.rings must be keys (name, "),
        ("gen-dataset", "rig.rings: [{class_path: a_module.Rig}]", "unknown key 'rig.rings.class_path'"),
        ("gen-dataset", "rig.rings+: a_module.Rig", "rig.rings must be keys (name, "),
        ("gen-dataset", "classes: [a_module.Rig]", "classes must be keys (name, pattern), got 'a_module.Rig'"),
        ("train-rl", "learner: a_module.Rig", "learner must be keys (gamma, "),
        ("train-rl", "learner: {class_path: a_module.Rig, init_args: {}}", "unknown key 'learner.class_path'"),
        ("tune", "space: {a: a_module.Rig}", "space must be keys (low, high, "),
        ("tune", "space: {a: {class_path: a_module.Rig}}", "unknown key 'space.class_path'"),
        ("tune", "space.a: {class_path: a_module.Rig}", "unknown key 'space.class_path'"),
    ],
)
def test_a_recipe_cannot_have_a_module_imported_in_place_of_keys(
    command: str, recipe: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "a_module.py").write_text("class Rig: pass")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "recipe.yaml").write_text(f"{recipe}\n")
    with pytest.raises(UserError) as refusal:
        cli.parse(command, ["--config", str(tmp_path / "recipe.yaml"), "--out", "o"])
    assert told in str(refusal.value) and "\n" not in str(refusal.value)
    assert "a_module" not in sys.modules


@pytest.mark.parametrize("rig", ["a_module.Rig", {"class_path": "a_module.Rig"}, {"rings": ["a_module.Rig"]}])
def test_stored_keys_cannot_either(rig: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a_module.py").write_text("class Rig: pass")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UserError, match=r"must be keys|unknown key"):
        config_of(GenDatasetConfig, {"scene": "s", "out": "o", "rig": rig})
    assert "a_module" not in sys.modules


def test_a_recipe_in_a_recipe_is_refused_and_one_for_a_part_is_looked_at(tmp_path: Path):
    grown = "l0: &l0 [x]\n" + "".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]\n" for i in range(1, 40))
    (tmp_path / "learner.yaml").write_text(grown)
    (tmp_path / "recipe.yaml").write_text(f"learner: {tmp_path / 'learner.yaml'}")
    with pytest.raises(UserError, match="learner must be keys"):
        cli.parse("train-rl", [*AGENT[1:], "--config", str(tmp_path / "recipe.yaml")])
    with pytest.raises(UserError, match=r"learner\.yaml cannot be read: it has more than 100000 values"):
        cli.parse("train-rl", [*AGENT[1:], "--learner", str(tmp_path / "learner.yaml")])
    (tmp_path / "learner.yaml").write_text("gamma: 0.5")
    assert cli.parse("train-rl", [*AGENT[1:], "--learner", str(tmp_path / "learner.yaml")]).learner.gamma == 0.5


def test_parts_may_be_dotted_and_in_lists(tmp_path: Path):
    (tmp_path / "recipe.yaml").write_text("rig.random.count: 3\nrig.rings: [{name: a, count: 2}]\nscene: s\n")
    config = cli.parse("gen-dataset", ["--config", str(tmp_path / "recipe.yaml"), "--out", "o"])
    assert (config.rig.random.count, config.rig.rings[0].count) == (3, 2)
