"""What nerf-rl view makes of a path, and of mistakes."""

import json
import shutil
import socket
from pathlib import Path

import pytest

from nerf_rl import cli
from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.viewer.config import ViewConfig
from nerf_rl.viewer.field.latents import EncodedDataset
from nerf_rl.viewer.pages.encoder_page import dataset_of_encoder
from nerf_rl.viewer.server import free_port, where_to_look
from nerf_rl.viewer.subject import Subject, find_subject


def test_a_folder_is_told_by_its_files(tiny_dataset: Path, tiny_encoder: Path, tiny_agent: Path) -> None:
    assert find_subject(tiny_dataset) is Subject.DATASET
    assert find_subject(tiny_encoder) is Subject.ENCODER
    assert find_subject(tiny_encoder / "encoder.safetensors") is Subject.ENCODER
    assert find_subject(tiny_encoder / "checkpoints" / "last.ckpt") is Subject.ENCODER
    assert find_subject(tiny_agent) is Subject.AGENT


def test_a_foreign_folder_gets_one_sentence_that_says_what_was_expected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["view", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert all(name in message for name in ("manifest.json", "encoder.json", "policy.json", str(tmp_path)))


def test_a_folder_of_several_names_them_and_an_empty_one_is_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="it is empty"):
        find_subject(tmp_path)
    (tmp_path / "report.html").touch()
    with pytest.raises(MissingFileError, match="its files are others"):
        find_subject(tmp_path)
    for name, mark in (("encoder", "encoder.json"), ("agent", "policy.json"), ("notes", "x.txt")):
        (tmp_path / name).mkdir()
        (tmp_path / name / mark).touch()
    with pytest.raises(MissingFileError, match=r"it holds agent, encoder; give the folder of one, such as .*/agent;"):
        find_subject(tmp_path)
    with pytest.raises(MissingFileError, match="its files are others"):
        find_subject(tmp_path / "report.html")


def test_a_missing_and_an_unfinished_folder_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="it does not exist"):
        find_subject(tmp_path / "nothing")
    (tmp_path / "plan.json").write_text("{}")
    with pytest.raises(MissingFileError, match="an unfinished dataset"):
        find_subject(tmp_path)


@pytest.mark.parametrize(
    "command, files, told",
    [
        ("pretrain", [], "it is an unfinished run of pretrain (finish it with --resume true)"),
        ("evaluate", [], "it is an unfinished run of evaluate; expected"),
        ("evaluate", ["summary.json"], "it is a finished run of evaluate; expected"),
        ("tune", ["summary.json"], "it is a finished run of tune; expected"),
        ("train-rl", ["summary.json", "seed-3/policy.json", "seed-7/policy.json"], "give the folder of one, such as "),
    ],
)
def test_a_run_with_nothing_to_view_is_told_by_its_command(
    command: str, files: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "provenance.json").write_text(json.dumps({"command": command}))
    for file in map(tmp_path.joinpath, files):
        file.parent.mkdir(exist_ok=True)
        file.write_text("{}")
    assert cli.main(["view", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert told in message and message.count("\n") == 1
    assert ("seed-" in message) == ("seed-3/policy.json" in files)
    (tmp_path / "provenance.json").write_text("[]")
    assert cli.main(["view", str(tmp_path)]) == 2


@pytest.mark.parametrize("kind, file", [("agent", "policy.json"), ("dataset", "manifest.json")])
def test_a_file_of_a_run_stands_for_it(
    kind: str, file: str, tiny_agent: Path, tiny_dataset: Path, tmp_path: Path
) -> None:
    path, picture = {"agent": tiny_agent, "dataset": tiny_dataset}[kind] / file, tmp_path / "x.png"
    assert cli.main(["view", str(path), "--png", str(picture), "--frames", "1", "--episodes", "1"]) == 0
    assert picture.stat().st_size > 0


@pytest.mark.parametrize("name", ["manifest.json", "encoder.json", "policy.json"])
def test_a_broken_folder_gets_one_sentence(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_text("{")
    assert cli.main(["view", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_the_path_needs_no_key_wherever_it_stands() -> None:
    for words in (["data/x", "--port", "80"], ["--port", "80", "data/x"], ["--port=80", "data/x"]):
        config = cli.parse("view", words)
        assert (config.path, config.port) == ("data/x", 80)
    with pytest.raises(UserError, match="unknown key"):
        cli.parse("report", ["data/x"])


@pytest.mark.parametrize(
    "keys, message",
    [
        ({"save": "x.png"}, "--save must end in .html"),
        ({"port": 70000}, "--port must be at most 65535, got 70000"),
        ({"frames": 0}, "--frames must be at least 1"),
        ({"seed": -1}, "--seed must be at least 0"),
    ],
)
def test_contradictions_are_rejected(keys: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        ViewConfig("data/x", **keys)


def test_a_taken_port_is_a_mistake_and_zero_is_a_free_one() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(UserError, match="--port 0 takes a free port"):
            free_port("127.0.0.1", taken.getsockname()[1])
        assert free_port("127.0.0.1", 0) != taken.getsockname()[1]


def test_over_ssh_the_forwarding_command_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    assert "ssh" not in where_to_look("127.0.0.1", 4321)
    monkeypatch.setenv("SSH_CONNECTION", "1.2.3.4 5 6.7.8.9 22")
    assert "ssh -L 4321:localhost:4321" in where_to_look("127.0.0.1", 4321)
    assert "http://localhost:4321" in where_to_look("0.0.0.0", 4321)
    assert "whoever reaches this machine" in where_to_look("0.0.0.0", 4321)


@pytest.mark.parametrize(
    "host, address",
    [
        ("192.168.1.5", "http://192.168.1.5:4321"),
        ("fd00::5", "http://[fd00::5]:4321"),
        ("workstation", "http://workstation:4321"),
        *((host, "http://localhost:4321") for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "::", "")),
    ],
)
def test_the_address_to_open_is_one_that_is_listened_on(host: str, address: str) -> None:
    assert where_to_look(host, 4321).splitlines()[0] == f"open {address}"


def test_an_existing_file_is_not_overwritten_unasked(
    tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.png").write_text("mine")
    assert cli.main(["view", str(tiny_dataset), "--png", str(tmp_path / "x.png")]) == 2
    assert "--overwrite true" in capsys.readouterr().err and (tmp_path / "x.png").read_text() == "mine"


def test_a_place_that_no_picture_can_have_is_told_before_anything_is_drawn(
    tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nerf_rl.viewer.view.save_dataset", lambda *given: pytest.fail("something was drawn"))
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    for place, told in (("file/x.png", "file is a file and no folder"), ("folder.png", "it is a folder and no file")):
        assert cli.main(["view", str(tiny_dataset), "--overwrite", "true", "--png", str(tmp_path / place)]) == 2
        message = capsys.readouterr().err
        assert told in message and message.count("\n") == 1


@pytest.mark.parametrize("content", ["data: [", "- a list\n", "steps: 3\n", "data: 5\n"])
def test_an_encoder_whose_configuration_names_no_dataset_asks_for_one(
    content: str, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("encoder.json", "encoder.safetensors", "field.json"):
        (tmp_path / name).write_bytes((tiny_encoder / name).read_bytes())
    (tmp_path / "config.yaml").write_text(content)
    assert cli.main(["view", str(tmp_path)]) == 2
    message = capsys.readouterr().err
    assert "config.yaml" in message and "--data FOLDER" in message and message.count("\n") == 1


def test_an_encoder_whose_dataset_has_gone_asks_for_one(
    tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("encoder.json", "encoder.safetensors", "field.json"):
        (tmp_path / name).write_bytes((tiny_encoder / name).read_bytes())
    assert cli.main(["view", str(tmp_path)]) == 2
    assert "--data FOLDER" in capsys.readouterr().err


def of_another(dataset: Path, folder: Path, **changed: object) -> Path:
    """Return a copy of a dataset whose manifest says something else."""
    shutil.copytree(dataset, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    write_checksummed(folder / "manifest.json", manifest | changed)
    return folder


def test_a_dataset_of_another_scene_or_of_other_classes_is_not_shown_through_an_encoder(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    classes = json.loads((tiny_dataset / "manifest.json").read_text())["classes"]
    door = of_another(tiny_dataset, tmp_path / "door", scene={"name": "metaworld/door-open-v3"})
    swapped = of_another(tiny_dataset, tmp_path / "swapped", classes=classes[::-1])
    recorded = tmp_path / "encoder"
    shutil.copytree(tiny_encoder, recorded, ignore=shutil.ignore_patterns("checkpoints"))
    (recorded / "config.yaml").write_text(f"data: {door}\n")
    for words, told in (
        ([str(tiny_encoder), "--data", str(door)], ("metaworld/door-open-v3", "metaworld/drawer-open-v3")),
        ([str(tiny_encoder), "--data", str(swapped)], (classes[0]["name"], classes[-1]["name"])),
        ([str(recorded)], ("metaworld/door-open-v3", "metaworld/drawer-open-v3")),
    ):
        assert cli.main(["view", *words, "--png", str(tmp_path / "x.png")]) == 2
        message = capsys.readouterr().err
        assert all(name in message for name in told) and "--data FOLDER" in message and message.count("\n") == 1
        assert not (tmp_path / "x.png").exists()


def test_pictures_that_were_imported_are_shown_through_an_encoder_with_their_cameras(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path
) -> None:
    """Their name tells one recording from another; without labels, only the encoder knows classes."""
    unlabelled = [{"name": "background", "colour": [128, 128, 128]}]
    imported = of_another(
        tiny_dataset, tmp_path / "x", scene={"name": "imported/lerobot-1a2b"}, absent=["labels"], classes=unlabelled
    )
    dataset, folder = dataset_of_encoder(ViewConfig(str(tiny_encoder), data=str(imported)))
    known = json.loads((tiny_encoder / "encoder.json").read_text())["palette"]
    assert EncodedDataset(str(tiny_encoder), folder, dataset).palette.tolist() == known


def test_a_scene_of_a_file_is_known_by_its_last_name_wherever_the_file_is(
    tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path
) -> None:
    shutil.copytree(tiny_encoder, tmp_path / "encoder", ignore=shutil.ignore_patterns("checkpoints"))
    description = json.loads((tmp_path / "encoder" / "encoder.json").read_text())
    description["scene"]["name"] = "arm.xml"
    (tmp_path / "encoder" / "encoder.json").write_text(json.dumps(description))
    arm = of_another(tiny_dataset, tmp_path / "arm", scene={"name": "/scenes/arm.xml"})
    dataset_of_encoder(ViewConfig(str(tmp_path / "encoder"), data=str(arm)))
    leg = of_another(tiny_dataset, tmp_path / "leg", scene={"name": "/scenes/leg.xml"})
    with pytest.raises(UserError, match="is of scene /scenes/leg"):
        dataset_of_encoder(ViewConfig(str(tmp_path / "encoder"), data=str(leg)))
