"""Recipes and numbers that somebody hands in: one sentence, before anything is allocated or waits for them."""

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.errors import UserError

BOMB = "l0: &l0 [x]\n" + "".join(f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]\n" for i in range(1, 40))


@pytest.mark.parametrize(
    "text, fault",
    [
        (BOMB, "is not a recipe: it has more than 100000 values"),
        ("rig: " + "[" * 20_000, "is not a recipe: it is nested more than 50 deep"),
        ("rig: &a {random: *a}", "is not a recipe: 'a' repeats itself"),
        ("classes: &a [*a]", "is not a recipe: 'a' repeats itself"),
        ("size: [", "is not a recipe: while parsing"),
        ("# " + "x" * (1 << 20), "is not a recipe: it is larger than 1048576 bytes"),
        ("size: 24\nconfig: {size: 32}", "is not a recipe: it has a key 'config', which is for arguments"),
        ("config: other.yaml", "is not a recipe: it has a key 'config', which is for arguments"),
    ],
)
@pytest.mark.parametrize("written", ["--config {}", "--config={}"])
def test_a_recipe_that_grows_or_nests_without_end_is_told(text: str, fault: str, written: str, tmp_path: Path):
    (tmp_path / "recipe.yaml").write_text(text)
    with pytest.raises(UserError) as refusal:
        cli.parse("gen-dataset", [*written.format(tmp_path / "recipe.yaml").split(), "--out", "o"])
    assert fault in str(refusal.value) and "recipe.yaml" in str(refusal.value)


@contextlib.contextmanager
def piped(text: str, folder: Path) -> Iterator[Path]:
    """A pipe that holds a text, which can be read only once."""
    path = folder / "pipe"
    os.mkfifo(path)

    def write() -> None:
        with open(path, "w") as file, contextlib.suppress(BrokenPipeError):  # whoever reads may have had enough
            file.write(text)
            file.flush()

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    yield path
    writer.join(timeout=60)


@pytest.mark.parametrize("written", ["--config {}", "--config={}"])
def test_a_recipe_may_come_through_a_pipe(written: str, tmp_path: Path):
    with piped("--- # a hyphen comes first\nsize: 24\nrig: {random: {count: 2}}", tmp_path) as pipe:
        config = cli.parse("gen-dataset", [*written.format(pipe).split(), "--seed", "3", "--out", "o"])
    assert (config.size, config.rig.random.count, config.seed) == (24, 2, 3)


@pytest.mark.parametrize(
    "text, fault",
    [
        (BOMB, "is not a recipe: it has more than 100000 values"),
        ("# " + "x" * (1 << 20), "is not a recipe: it is larger than 1048576 bytes"),
        ("rig: turtledemo.Rig", "is not a recipe: rig must be keys"),
        ("rig: {class_path: turtledemo.Rig}", "unknown key 'rig.class_path'"),
        ("turtledemo.Rig", "is not a recipe: there are no keys in it"),
    ],
)
def test_what_comes_through_a_pipe_is_looked_at_as_a_file_is(
    text: str, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delitem(sys.modules, "turtledemo", raising=False)
    with piped(text, tmp_path) as pipe, pytest.raises(UserError) as refusal:
        cli.parse("gen-dataset", ["--config", str(pipe), "--out", "o"])
    assert fault in str(refusal.value)
    assert "turtledemo" not in sys.modules, "a module that a recipe names is not imported"


@pytest.mark.parametrize(
    "key, text, fault",
    [
        ("rig", "turtledemo.Rig", "--rig: expected keys, or a file of them, got turtledemo.Rig"),
        ("rig", "class_path: turtledemo.Rig", "unknown key 'rig.class_path'"),
        ("rig", "random: turtledemo.Rig", "--rig.random: expected keys, got turtledemo.Rig"),
        ("rig.random", "turtledemo.Rig", "--rig.random: expected keys, or a file of them, got turtledemo.Rig"),
        ("rig.random", "{class_path: turtledemo.Rig}", "unknown key 'rig.random.class_path'"),
        ("rig.rings", "[turtledemo.Rig]", "--rig.rings: expected keys, or a file of them, got turtledemo.Rig"),
        ("rig", "config: other.yaml", "unknown key 'rig.config'"),
        ("rig", BOMB, "has more than 100000 values"),
    ],
)
@pytest.mark.parametrize("written", ["apart", "joined"])
@pytest.mark.parametrize("source", ["file", "pipe", "words"])
def test_parts_on_the_command_line_are_looked_at_as_recipes_are(
    key: str, text: str, fault: str, written: str, source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delitem(sys.modules, "turtledemo", raising=False)
    with contextlib.ExitStack() as stack:
        given = text
        if source == "pipe":
            given = str(stack.enter_context(piped(text, tmp_path)))
        elif source == "file":
            given = str(tmp_path / "part.yaml")
            Path(given).write_text(text)
        words = [f"--{key}", given] if written == "apart" else [f"--{key}={given}"]
        refusal = stack.enter_context(pytest.raises(UserError))
        cli.parse("gen-dataset", [*words, "--out", "o"])
    assert fault in str(refusal.value) and "\n" not in str(refusal.value)
    assert "turtledemo" not in sys.modules, "a module that a part names is not imported"


def test_a_part_may_be_a_file_or_keys_of_its_own(tmp_path: Path):
    (tmp_path / "rig.yaml").write_text("random: {count: 2}")
    with piped("random: {count: 2}", tmp_path) as pipe:
        for given in (str(tmp_path / "rig.yaml"), "{random: {count: 2}}", str(pipe)):
            assert cli.parse("gen-dataset", ["--rig", given, "--out", "o"]).rig.random.count == 2
    assert cli.parse("gen-dataset", ["--rig.random", "{count: 2}", "--out", "o"]).rig.random.count == 2


@pytest.mark.parametrize(
    "words", [["--conf", "r.yaml"], ["--conf=r.yaml"], ["--see", "3"], ["--rig.ran", "{count: 2}"]]
)
def test_keys_are_not_cut_short(words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """So a recipe is found by its key, and what looks like a mistake is told as one."""
    monkeypatch.chdir(tmp_path)
    Path("r.yaml").write_text("size: 24")
    with pytest.raises(UserError, match="unknown key"):
        cli.parse("gen-dataset", [*words, "--out", "o"])


@pytest.mark.parametrize("command", ["check", "view", "export", "import", "push"])
def test_one_path_is_taken_where_there_is_one(command: str):
    with pytest.raises(UserError, match=r"one \w+ is taken, got a and b"):
        cli.parse(command, ["a", "b", *(["--out", "o"] if command in ("export", "import") else [])])


def test_what_is_no_text_is_no_recipe(tmp_path: Path):
    (tmp_path / "recipe.yaml").write_bytes(b"\xff\xfesize: 24")
    with pytest.raises(UserError, match=r"recipe\.yaml is not a recipe: 'utf-8' codec can't decode"):
        cli.parse("gen-dataset", ["--config", str(tmp_path / "recipe.yaml"), "--out", "o"])


def test_tags_are_not_executed(tmp_path: Path):
    tag = f"!!python/object/apply:os.system ['touch {tmp_path / 'marker'}']"
    (tmp_path / "recipe.yaml").write_text(f"scene: {tag}\n")
    with pytest.raises(UserError, match="could not determine a constructor for the tag"):
        cli.parse("gen-dataset", ["--config", str(tmp_path / "recipe.yaml"), "--out", "o"])
    assert not (tmp_path / "marker").exists()


def test_parts_may_still_be_repeated_by_name(tmp_path: Path):
    cameras = "rig: {cameras: [&a {name: a, fovy: 40}, {<<: *a, name: b}]}"
    (tmp_path / "recipe.yaml").write_text(cameras)
    config = cli.parse("gen-dataset", ["--config", str(tmp_path / "recipe.yaml"), "--out", "o"])
    assert [(camera.name, camera.fovy) for camera in config.rig.cameras] == [("a", 40.0), ("b", 40.0)]


DATASET, AGENT = ["gen-dataset", "--out", "o"], ["train-rl", "--out", "o"]
ENCODER = ["pretrain", "--data", "d", "--out", "o"]
EVALUATION = ["evaluate", "--run", "r", "--out", "o"]


@pytest.mark.parametrize(
    "words, fault",
    [
        ([*DATASET, "--seed", "-1"], "--seed must be at least 0, got -1"),
        ([*ENCODER, "--seed", str(2**63)], f"--seed must be at most 4294967295, got {2**63}"),
        ([*AGENT, "--seed", "-3"], "--seed must be at least 0, got -3"),
        ([*EVALUATION, "--seed", "-3"], "--seed must be at least 0, got -3"),
        ([*DATASET, "--size", str(10**9)], "--size must be at most 4096, got 1000000000"),
        ([*DATASET, "--workers", str(10**9)], "--workers must be at most 1024"),
        ([*DATASET, "--worker_timeout", "1e308"], "--worker_timeout must be in (0, 10000000], got 1e+308"),
        ([*DATASET, "--episode_steps", str(2**63)], "--episode_steps must be at most 1000000"),
        ([*DATASET, "--episodes", str(2**63)], "a dataset has at most 1000000 shards"),
        ([*DATASET, "--behaviour.noise", "-1"], "--behaviour.noise must be in [0, 1000000], got -1.0"),
        ([*DATASET, "--behaviour.random", "1e308"], "--behaviour.random must be in [0, 1000000]"),
        ([*DATASET, "--behaviour.noise", ".nan"], "--behaviour.noise must be a finite number, got nan"),
        ([*DATASET, "--rig.random.count", str(10**9)], "a dataset has at most 256 cameras"),
        ([*DATASET, "--rig.domes", '[{"count": 1000000000}]'], "a dataset has at most 256 cameras"),
        ([*DATASET, "--rig.rings", '[{"count": 1000000000}]'], "a dataset has at most 256 cameras"),
        ([*DATASET, "--rig.random.azimuth", "[-1e308, 1e308]"], "numbers must be from -1000000.0 to 1000000.0"),
        ([*DATASET, "--rig.random.lookat_spread", "-1"], "random cameras: lookat_spread must be 0 or more, got -1.0"),
        ([*DATASET, "--rig.cameras", '[{"name": "a", "azimuth": .inf}]'], "got inf"),
        ([*ENCODER, "--encoder.hidden", str(10**9)], "--encoder.hidden must be at most 16384"),
        ([*ENCODER, "--encoder.channels", f"[8, {10**9}]"], "--encoder.channels must be at most 4096, got 1000000000"),
        ([*ENCODER, "--radiance_field.layers", str(10**9)], "--radiance_field.layers must be at most 64"),
        ([*ENCODER, "--radiance_field.plane_features", "999", "--radiance_field.plane_size", "999"], "planes have"),
        ([*ENCODER, "--losses.rgb", ".nan"], "--losses.rgb must be a finite number, got nan"),
        ([*AGENT, "--network.hidden", f"[16, {10**9}]"], "--network.hidden must be at most 16384, got 1000000000"),
        ([*AGENT, "--learner.batch_size", str(10**9)], "--learner.batch_size must be at most 1048576"),
        ([*AGENT, "--envs", str(10**9)], "--envs must be at most 1024"),
        ([*AGENT, "--learner.max_grad_norm", ".inf"], "--learner.max_grad_norm must be a finite number, got inf"),
    ],
)  # fmt: skip
def test_numbers_that_nobody_means_are_refused_by_name(words: list[str], fault: str):
    with pytest.raises(UserError) as refusal:
        cli.parse(words[0], words[1:])
    assert fault in str(refusal.value) and "\n" not in str(refusal.value)


def test_what_a_tiny_or_a_large_run_needs_is_left_alone():
    config = cli.parse("gen-dataset", [*DATASET[1:], "--episodes", str(10**10), "--episodes_per_shard", str(10**10)])
    assert config.episodes == 10**10
    assert cli.parse("train-rl", [*AGENT[1:], "--env_steps", str(10**9), "--seed", str(2**32 - 1)]).seed == 2**32 - 1
