"""Reports on agents of every kind, from what there is of encoder and dataset."""

import base64
import json
import re
import shutil
from pathlib import Path

import cv2
import pytest
from tiny_recipes import TINY_TRAINING

from nerf_rl import cli
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.rl.training.episodes import evaluation_seeds

MODULES = {"ppo": "stable_baselines3", "panda": "panda_gym"}
KEYS = {
    "state": [],
    "ppo": ["--algo", "ppo", "--ppo.n_steps", "16", "--ppo.batch_size", "16", "--ppo.hidden", "[8]", "--envs", "1"],
    "panda": ["--scene", "panda/reach"],
}


@pytest.fixture(scope="module", params=KEYS)
def stateful(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An agent that observes the true state."""
    if request.param in MODULES:
        pytest.importorskip(MODULES[request.param])
    out = tmp_path_factory.mktemp("agents") / request.param
    assert cli.main(["train-rl", "--out", str(out), *TINY_TRAINING, *KEYS[request.param]]) == 0
    return out


def sections(page: Path) -> list[str]:
    return re.findall("<h2>(.*?)</h2>", page.read_text())


def frames_of_clip(page: Path) -> tuple[int, int, int]:
    """Return how many frames the clip of a page has, their height and width."""
    (content,) = re.findall(r'src="data:video/mp4;base64,([^"]+)"', page.read_text())
    page.with_suffix(".mp4").write_bytes(base64.b64decode(content))
    clip = cv2.VideoCapture(str(page.with_suffix(".mp4")))
    read, frame = clip.read()
    assert read and frame.std() > 5
    return int(clip.get(cv2.CAP_PROP_FRAME_COUNT)), *frame.shape[:2]


def test_an_agent_on_the_true_state_has_a_page_of_its_own(stateful: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert cli.main(["report", "--agent", str(stateful), "--out", str(page), "--episodes", "1"]) == 0
    assert sections(page) == ["Policy", "How it was made"]
    last = json.loads((stateful / "summary.json").read_text())["evaluations"][-1]
    assert f"success {last['success_rate']:.0%}" in page.read_text() and "true state" in page.read_text()
    assert f"Episode of seed {evaluation_seeds(1, 1)[0]} (" in page.read_text()  # as view and evaluate draw theirs
    assert frames_of_clip(page)[1:] == (256, 256)


def test_an_agent_on_the_true_state_can_be_viewed(stateful: Path, tmp_path: Path) -> None:
    files = ["--save", str(tmp_path / "x.html"), "--png", str(tmp_path / "x.png")]
    assert cli.main(["view", str(stateful), "--episodes", "1", *files]) == 0
    assert cv2.imread(str(tmp_path / "x.png")).std() > 5


def test_encoder_and_dataset_stand_beside_an_agent_of_their_scene_only(
    stateful: Path, tiny_dataset: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    for keys in (["--data", str(tiny_dataset)], ["--encoder", str(tiny_encoder)]):
        words = ["--agent", str(stateful), "--out", str(page), "--overwrite", "true", "--episodes", "1"]
        given = cli.main(["report", *words, *keys])
        if stateful.name == "panda":
            assert given == 2 and not page.exists()
            message = capsys.readouterr().err
            assert "metaworld/drawer-open-v3" in message and "panda/reach" in message and message.count("\n") == 1
            continue
        assert given == 0
        expected = ["Dataset", "Encoder"] if "--encoder" in keys else ["Dataset"]
        assert sections(page) == [*expected, "Policy", "How it was made"]
        assert frames_of_clip(page)[1:] == (256, 256)  # nothing is decoded from a state


def test_an_agent_knows_its_encoder_and_that_its_dataset(tiny_agent: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert cli.main(["report", "--agent", str(tiny_agent), "--out", str(page), "--episodes", "1"]) == 0
    assert sections(page) == ["Dataset", "Encoder", "Policy", "How it was made"]
    assert frames_of_clip(page)[1:] == (256, 512)


def test_an_encoder_of_before_there_were_network_probes_has_its_section(
    tiny_encoder: Path, tiny_agent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    older, page = tmp_path / "older", tmp_path / "page.html"
    shutil.copytree(tiny_encoder, older, ignore=shutil.ignore_patterns("checkpoints"))
    for file in ("summary.json", "encoder.json"):
        content = json.loads((older / file).read_text())
        added = ("joint_probe", "joint_probe_random_encoder", "validation_other_cameras")
        content = {key: value for key, value in content.items() if key not in added}
        del content["validation"]["ssim"]
        for figures in (figures for kind in content if kind.startswith("probe") for figures in content[kind].values()):
            del figures["network_rmse_mm"], figures["network_r2"]
        (older / file).write_text(json.dumps(content))
    words = ["--agent", str(tiny_agent), "--encoder", str(older), "--out", str(page), "--episodes", "1"]
    assert cli.main(["report", *words]) == 0
    probe = json.loads((older / "summary.json").read_text())["probe"]["hand_x"]
    row = f"<tr><td>hand_x</td><td>{probe['r2']:.3f}</td><td>{probe['rmse_mm']:.1f} mm</td><td>unknown</td>"
    assert row in page.read_text() and "SSIM" not in page.read_text()
    told = capsys.readouterr().out
    assert f"hand_x {probe['rmse_mm']:.1f} mm" in told and "right_j0" not in told


def test_an_exported_encoder_without_its_field_leaves_out_what_it_cannot_show(
    tiny_encoder: Path, tiny_agent: Path, tmp_path: Path
) -> None:
    exported, agent, page = tmp_path / "exported", tmp_path / "agent", tmp_path / "page.html"
    exported.mkdir()
    for name in ("encoder.json", "encoder.safetensors"):
        shutil.copy(tiny_encoder / name, exported)
    shutil.copytree(tiny_agent, agent, ignore=shutil.ignore_patterns("checkpoints"))
    policy = json.loads((agent / "policy.json").read_text())
    policy["env"]["encoder"] = str(exported)
    (agent / "policy.json").write_text(json.dumps(policy))
    assert cli.main(["report", "--agent", str(agent), "--out", str(page), "--episodes", "1"]) == 0
    assert sections(page) == ["Dataset", "Policy", "How it was made"]
    assert frames_of_clip(page)[1] == 256


def test_a_dataset_of_another_scene_is_refused_in_a_sentence(
    tiny_dataset: Path, tiny_agent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other"
    shutil.copytree(tiny_dataset, other)
    manifest = json.loads((other / "manifest.json").read_text())
    manifest["scene"]["name"] = "metaworld/door-open-v3"
    write_checksummed(other / "manifest.json", manifest)
    page = tmp_path / "page.html"
    assert cli.main(["report", "--agent", str(tiny_agent), "--data", str(other), "--out", str(page)]) == 2
    message = capsys.readouterr().err
    assert "metaworld/door-open-v3" in message and message.count("\n") == 1 and not page.exists()


@pytest.mark.parametrize("kind, words", [("blind", "latents of zero"), ("random", "an encoder that nobody trained")])
def test_a_control_is_called_one_wherever_its_figures_and_pictures_are(
    kind: str, words: str, tiny_agent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, page, view = tmp_path / "agent", tmp_path / "page.html", tmp_path / "view.html"
    shutil.copytree(tiny_agent, run, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    policy = json.loads((run / "policy.json").read_text())
    policy["env"]["control"] = kind
    (run / "policy.json").write_text(json.dumps(policy))
    assert cli.main(["report", "--agent", str(run), "--out", str(page), "--episodes", "1"]) == 0
    assert f"control  {kind}: the same agent, trained with {words}" in capsys.readouterr().out
    (title,) = re.findall("<h1>(.*?)</h1>", page.read_text())
    (caption,) = re.findall("controls autoplay.*?<figcaption>(.*?)</figcaption>", page.read_text())
    assert title.endswith(f"(control: {kind})") and f"is a control, the same agent, trained with {words}" in caption
    assert ("decodes" in caption) == (kind == "blind")  # no field is of an untrained encoder's latents
    assert cli.main(["view", str(run), "--save", str(view), "--episodes", "1"]) == 0
    assert f"agent (control: {kind})</h1>" in view.read_text() and words in view.read_text()


STEPS, PROBED, SHOWN = '"steps": 6, "seconds": 1', '"probe": {}, "class_iou": {}', '"validation": {"miou": 1}'


@pytest.mark.parametrize(
    "part, summary, told",
    [
        ("agent", "{", "its summary.json is damaged"),
        ("agent", '{"evaluations": []}', "damaged (the whole is a mapping instead of one with seconds"),
        ("agent", '{"evaluations": [], "seconds": 1.0}', "its summary.json holds no evaluation"),
        ("encoder", "[]", "its summary.json is damaged (the whole is a list"),
        ("encoder", f"{{{PROBED}, {STEPS}, {SHOWN}}}", "validation is a mapping instead of one with psnr_db"),
    ],
)
def test_a_damaged_summary_is_told_in_a_sentence(
    part: str,
    summary: str,
    told: str,
    tiny_agent: Path,
    tiny_encoder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    agent, encoder = tmp_path / "agent", tmp_path / "encoder"
    for source, copy in ((tiny_agent, agent), (tiny_encoder, encoder)):
        shutil.copytree(source, copy, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    ({"agent": agent, "encoder": encoder}[part] / "summary.json").write_text(summary)
    words = ["--agent", str(agent), "--encoder", str(encoder), "--out", str(tmp_path / "new" / "x.html")]
    assert cli.main(["report", *words]) == 2
    message = capsys.readouterr().err
    assert told in message and message.count("\n") == 1 and not (tmp_path / "new").exists()


def test_a_place_that_no_page_can_have_is_told_before_anything_is_drawn(
    tiny_agent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nerf_rl.report.report.find_sources", lambda config: pytest.fail("something was read"))
    (tmp_path / "file").touch()
    assert cli.main(["report", "--agent", str(tiny_agent), "--out", str(tmp_path / "file" / "x.html")]) == 2
    message = capsys.readouterr().err
    assert "file is a file and no folder" in message and message.count("\n") == 1


def test_a_field_whose_classes_nobody_names_is_told_by_report_and_view(
    tiny_agent: Path, tiny_encoder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    encoder = tmp_path / "encoder"
    shutil.copytree(tiny_encoder, encoder, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    description = json.loads((encoder / "encoder.json").read_text())
    del description["palette"]
    (encoder / "encoder.json").write_text(json.dumps(description))
    for words in (
        ["report", "--agent", str(tiny_agent), "--out", str(tmp_path / "x.html")],
        ["view", str(tiny_agent), "--png", str(tmp_path / "x.png")],
    ):
        assert cli.main([*words, "--encoder", str(encoder), "--episodes", "1"]) == 2
        message = capsys.readouterr().err
        assert "does not name the classes and their colours" in message and message.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["encoder"]


def test_a_damaged_record_of_how_a_run_was_made_leaves_the_rest_of_the_page(tiny_agent: Path, tmp_path: Path) -> None:
    run, page = tmp_path / "agent", tmp_path / "page.html"
    shutil.copytree(tiny_agent, run, ignore=shutil.ignore_patterns("checkpoints", "logs"))
    (run / "provenance.json").write_text("{")
    assert cli.main(["report", "--agent", str(run), "--out", str(page), "--episodes", "1"]) == 0
    assert f"{run}: unknown" in page.read_text()
