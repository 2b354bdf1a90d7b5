"""The command line: what it prints, what it imports, how it exits."""

import dataclasses
import importlib
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nerf_rl import __version__, cli
from nerf_rl.arguments.explanations import RENAMED
from nerf_rl.errors import FailureError, UserError

HEAVY = {"torch", "torchrl", "lightning", "mujoco", "metaworld", "gymnasium", "jsonargparse", "h5py", "numpy"}


@dataclasses.dataclass
class ToyConfig:
    """Keys of the command below."""

    outcome: str = "success"
    """how the command ends"""


def toy_command(config: ToyConfig) -> None:
    """End as the configuration says."""
    errors = {
        "mistake": UserError("that is not a dataset"),
        "failure": FailureError("the disk is full"),
        "interrupt": KeyboardInterrupt(),
        "bug": RuntimeError("ouch"),
    }
    if config.outcome == "terminate":
        signal.raise_signal(signal.SIGTERM)
    if config.outcome in errors:
        raise errors[config.outcome]


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> str:
    """Add a command that ends as it is told to."""
    command = cli.Command(f"{__name__}:ToyConfig", f"{__name__}:toy_command", "end in a given way")
    monkeypatch.setitem(cli.COMMANDS, "toy", command)
    return "toy"


def modules_imported_by(*arguments: str) -> set[str]:
    """Return the top-level modules that a run of the command line imports."""
    program = f"import sys; from nerf_rl import cli; cli.main({list(arguments)!r}); print('#', *sys.modules)"
    output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    return {name.partition(".")[0] for name in output.rpartition("#")[2].split()}


def required_arguments(name: str) -> list[str]:
    """Return a value for each key of a command that has no default."""
    module, attribute = cli.COMMANDS[name].config.split(":")
    config = getattr(importlib.import_module(module), attribute)
    missing = dataclasses.MISSING
    required = [f for f in dataclasses.fields(config) if f.default is missing and f.default_factory is missing]
    # a page is asked for by the report, a folder by all others; either may be called so
    keys = [f"--{field.name}{'+' * (field.type == list[str])}" for field in required]
    return [word for key, field in zip(keys, required, strict=True) for word in (key, f"some/{field.name}.html")]


def test_help_lists_every_command_and_imports_nothing_heavy(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["--help"]) == 0
    shown = capsys.readouterr().out
    for name, command in cli.COMMANDS.items():
        assert name in shown and command.help in shown
    assert not HEAVY & modules_imported_by("--help")


def test_a_mistyped_command_is_answered_without_heavy_imports():
    assert not HEAVY & modules_imported_by("pretrian")


def test_a_mistyped_key_is_answered_without_importing_torch_or_mujoco():
    assert not {"torch", "lightning", "mujoco", "metaworld"} & modules_imported_by("gen-dataset", "--epsiodes", "3")


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"nerf-rl {__version__}\n"


def test_no_command_is_a_usage_error_that_shows_the_help(capsys: pytest.CaptureFixture[str]):
    assert cli.main([]) == 2
    assert "usage: nerf-rl" in capsys.readouterr().out


@pytest.mark.parametrize(
    "outcome, code",
    [("success", 0), ("bug", 1), ("failure", 1), ("mistake", 2), ("interrupt", 130), ("terminate", 143)],
)
def test_the_exit_code_tells_how_a_command_ended(toy: str, outcome: str, code: int):
    assert cli.main([toy, "--outcome", outcome]) == code


def test_a_mistake_or_failure_is_one_sentence_and_a_bug_is_a_traceback(toy: str, capsys: pytest.CaptureFixture[str]):
    for outcome, sentence in (("mistake", "that is not a dataset"), ("failure", "the disk is full")):
        cli.main([toy, "--outcome", outcome])
        assert capsys.readouterr().err == f"nerf-rl toy: {sentence}\n"
    cli.main([toy, "--outcome", "bug"])
    shown = capsys.readouterr().err
    assert "Traceback" in shown and "RuntimeError: ouch" in shown


@pytest.mark.parametrize("words", [["check"], ["view"], ["train-rl", "--out"]])
def test_a_name_longer_than_the_file_system_allows_is_a_sentence(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert cli.main([*words, str(tmp_path / ("x" * 300))]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "x" * 300 in said


@pytest.mark.parametrize("module", ["nerf_rl", "nerf_rl.cli"])
def test_the_process_exits_with_the_code_of_main(module: str):
    finished = subprocess.run([sys.executable, "-m", module, "fly"], capture_output=True, text=True)
    assert finished.returncode == 2
    assert finished.stderr.count("\n") == 1


def test_an_unknown_command_is_answered_with_the_close_one_and_the_list(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["pretrian"]) == 2
    message = capsys.readouterr().err
    assert "unknown command 'pretrian' (did you mean pretrain" in message
    assert all(name in message for name in cli.COMMANDS)


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_an_unknown_key_is_answered_with_the_keys_there_are(name: str, capsys: pytest.CaptureFixture[str]):
    assert cli.main([name, *required_arguments(name), "--flux_capacitor", "3"]) == 2
    message = capsys.readouterr().err
    assert "unknown key 'flux_capacitor'" in message and "available: " in message
    assert message.count("\n") == 1


@pytest.mark.parametrize("old", RENAMED)
def test_a_key_of_an_earlier_version_is_answered_with_its_new_name(
    old: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """On the command line and in a recipe, where the key may stand in a mapping."""
    command = "train-rl" if old.startswith("noise.") else "pretrain"
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(f"{old.replace('.', ': {')}: 1{'}' * old.count('.')}")
    for arguments in ([f"--{old}", "1"], ["--config", str(recipe)]):
        assert cli.main([command, *required_arguments(command), *arguments]) == 2
        assert f"key '{old}' is now '{RENAMED[old]}'" in capsys.readouterr().err


def test_an_unknown_key_in_a_recipe_is_answered_like_one_on_the_command_line(
    toy: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("outcmoe: success\n")
    assert cli.main([toy, "--config", str(recipe)]) == 2
    assert "unknown key 'outcmoe' (did you mean outcome?); available: outcome" in capsys.readouterr().err


def test_a_recipe_that_does_not_exist_is_named(toy: str, capsys: pytest.CaptureFixture[str]):
    assert cli.main([toy, "--config", "no/such/recipe.yaml"]) == 2
    message = capsys.readouterr().err
    assert "no/such/recipe.yaml" in message
    assert message.count("\n") == 1


def test_a_value_of_the_wrong_type_names_its_key(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["gen-dataset", "--out", "x", "--episodes", "many"]) == 2
    message = capsys.readouterr().err
    assert "episodes" in message and "many" in message
    assert message.count("\n") == 1


def test_a_value_out_of_range_is_answered_in_the_users_words(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["gen-dataset", "--out", "x", "--episodes", "0"]) == 2
    assert capsys.readouterr().err == "nerf-rl gen-dataset: --episodes must be at least 1, got 0\n"


@pytest.mark.parametrize("number", ["-3", "-.5", "-3e-05", "-1.5E1"])
@pytest.mark.parametrize("joined", [False, True])
def test_a_negative_number_is_the_value_of_the_key_before(number: str, joined: bool):
    words = [f"--ppo.log-std-init={number}"] if joined else ["--ppo.log-std-init", number]
    config = cli.parse("train-rl", ["--out", "x", *words, "--learner.gamma", "0.5"])
    assert (config.ppo.log_std_init, config.learner.gamma) == (float(number), 0.5)


def test_a_missing_key_is_named(capsys: pytest.CaptureFixture[str]):
    assert cli.main(["gen-dataset"]) == 2
    assert "missing --out" in capsys.readouterr().err


def test_an_override_wins_over_a_recipe_wherever_it_stands_and_a_later_recipe_over_an_earlier(toy: str, tmp_path: Path):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("outcome: mistake\n")
    assert cli.parse(toy, ["--config", str(recipe)]).outcome == "mistake"
    assert cli.parse(toy, ["--config", str(recipe), "--outcome", "bug"]).outcome == "bug"
    assert cli.parse(toy, ["--outcome", "bug", "--config", str(recipe)]).outcome == "bug"
    (tmp_path / "later.yaml").write_text("outcome: failure\n")
    recipes = ["--config", str(recipe), "--config", str(tmp_path / "later.yaml")]
    assert cli.parse(toy, recipes).outcome == "failure"


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_of_a_command_describes_each_of_its_keys(name: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as stop:
        cli.main([name, "--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    config = cli.parse(name, required_arguments(name))
    for field in dataclasses.fields(config):
        assert f"--{field.name}" in shown


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_a_printed_recipe_gives_the_same_configuration_back(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = required_arguments(name)
    with pytest.raises(SystemExit) as stop:
        cli.main([name, *arguments, "--print_config"])
    assert stop.value.code == 0
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text(capsys.readouterr().out)
    assert cli.parse(name, ["--config", str(recipe)]) == cli.parse(name, arguments)
