"""What is fetched from the Hub, and what is said where it cannot be."""

import socket
from pathlib import Path

import pytest
from local_hub import LocalHub, Repository

from nerf_rl import cli
from nerf_rl.errors import UserError
from nerf_rl.hub.address import Address, is_address, parse_address
from nerf_rl.hub.fetch import ENCODER_IN_AGENT, FILES, lasting, resolve
from nerf_rl.pretrain.model import encoder_file, field_description
from nerf_rl.rl.agents import policy_file

NAME = "tests/encoder"


def put(hub: LocalHub, name: str = NAME, **files: bytes) -> str:
    """Put files, whose dots are written as two underscores, into a repository; return the commit."""
    kept = hub.repositories.setdefault(name, Repository())
    return kept.commit("main", {path.replace("__", "."): content for path, content in files.items()})


@pytest.mark.parametrize(
    "text, address",
    [
        ("hf://user/name", Address("user/name")),
        ("user/name", Address("user/name")),
        ("hf:/user/name", Address("user/name")),  # as pathlib writes it
        ("hf://user/name@v1.0", Address("user/name", "v1.0")),
        ("hf://a-b/c.d_e@pull/7", Address("a-b/c.d_e", "pull/7")),
    ],
)
def test_an_address_names_a_repository_and_perhaps_a_revision(text: str, address: Address):
    assert parse_address(text) == address
    assert parse_address(str(address)) == address


@pytest.mark.parametrize(
    "text", ["hf://", "hf://user", "hf://a/b/c", "hf://a/b@", "hf://../b", "hf://a/b@../../c", "hf://a/b@x/..", "a b/c"]
)
def test_what_is_no_address_is_told(text: str):
    with pytest.raises(UserError, match="expected hf://USER/NAME or hf://USER/NAME@REVISION"):
        parse_address(text)


def test_a_path_stays_a_path(tmp_path: Path):
    assert not is_address("runs/encoder") and not is_address(tmp_path)
    assert resolve(tmp_path / "x") == tmp_path / "x"
    assert lasting(tmp_path / "a" / ".." / "x") == str(tmp_path.resolve() / "x")


def test_what_may_be_fetched_is_what_artefacts_are_made_of():
    of_encoder = {
        *(encoder_file.DESCRIPTION, encoder_file.WEIGHTS),
        *(field_description.DESCRIPTION, field_description.WEIGHTS),
    }
    of_agent = {policy_file.POLICY_DESCRIPTION, policy_file.POLICY_WEIGHTS, "summary.json"}
    assert set(FILES) == of_encoder | of_agent | {f"{ENCODER_IN_AGENT}/{name}" for name in of_encoder}
    assert {Path(name).suffix for name in FILES} == {".json", ".safetensors"}


def test_only_named_files_are_fetched(hub: LocalHub):
    put(
        hub, encoder__json=b"{}", encoder__safetensors=b"w" * 1000, setup__py=b"1/0", model__pkl=b"\x80", last__ckpt=b""
    )
    folder = resolve(f"hf://{NAME}")
    assert {path.name for path in folder.iterdir()} == {"encoder.json", "encoder.safetensors"}
    assert (folder / "encoder.safetensors").read_bytes() == b"w" * 1000
    assert not [asked for asked in hub.requests if asked.endswith((".py", ".pkl", ".ckpt"))]


def test_a_revision_is_fetched_and_one_that_is_here_is_not_asked_for_again(hub: LocalHub):
    first = put(hub, encoder__json=b"[1]")
    second = put(hub, encoder__json=b"[2]")
    assert (resolve(f"hf://{NAME}") / "encoder.json").read_bytes() == b"[2]"
    assert (resolve(f"hf://{NAME}@{first}") / "encoder.json").read_bytes() == b"[1]"
    assert lasting(f"hf://{NAME}") == f"hf://{NAME}@{second}"
    hub.requests.clear()
    assert (resolve(f"hf://{NAME}@{first}") / "encoder.json").read_bytes() == b"[1]"
    assert hub.requests == []


def test_a_private_repository_is_fetched_with_the_users_token(hub: LocalHub, monkeypatch: pytest.MonkeyPatch):
    put(hub, encoder__json=b"{}")
    hub.repositories[NAME].private = True
    assert (resolve(f"hf://{NAME}") / "encoder.json").is_file()
    put(hub, "tests/other", encoder__json=b"{}")
    hub.repositories["tests/other"].private = True
    monkeypatch.delenv("HF_TOKEN")
    with pytest.raises(UserError, match="none that your token lets you see or make; log in with 'hf auth login'"):
        resolve("hf://tests/other")


def test_what_was_fetched_before_is_there_without_a_network(hub: LocalHub, monkeypatch: pytest.MonkeyPatch):
    put(hub, encoder__json=b"{}")
    folder = resolve(f"hf://{NAME}")
    cut_off(monkeypatch)
    assert resolve(f"hf://{NAME}") == folder
    with pytest.raises(UserError, match=r"cannot be reached .*; is there a network"):
        resolve("hf://tests/other")


def cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the Hub be where nothing listens."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nowhere = f"http://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setattr("huggingface_hub.constants.ENDPOINT", nowhere)
    monkeypatch.setenv("HF_ENDPOINT", nowhere)


@pytest.mark.parametrize(
    "address, message",
    [
        ("hf://tests/none", "has no such repository, or none that your token lets you see"),
        (f"hf://{NAME}@v9", "the repository has no revision v9"),
        (f"hf://{NAME}@{'0' * 40}", f"the repository has no revision {'0' * 40}"),
        ("hf://tests", "is no address on the Hugging Face Hub"),
        (f"hf://{NAME}", "is not an encoder: there is no encoder.json with its encoder.safetensors"),
    ],
)
def test_an_encoder_that_cannot_be_had_is_told_in_a_sentence(
    address: str, message: str, hub: LocalHub, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    put(hub, policy__json=b"{}")
    assert cli.main(["train-rl", "--encoder", address, "--out", str(tmp_path / "run")]) == 2
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_a_server_that_is_out_of_order_is_quoted(hub: LocalHub):
    hub.failing = 503
    with pytest.raises(UserError, match=r"hf://tests/encoder cannot be fetched: .* answers 503: out of order"):
        resolve(f"hf://{NAME}")


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "huggingface_hub", None)
    with pytest.raises(UserError, match="hf://user/name needs the extra 'hub'"):
        resolve("hf://user/name")
