"""The doctor: what works is found to work, what does not comes with its fix, and nothing takes the doctor down."""

import contextlib
import io
import json
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from nerf_rl import cli
from nerf_rl.doctor import doctor
from nerf_rl.doctor import optional_packages as doctor_extras
from nerf_rl.doctor import probes as doctor_probes
from nerf_rl.doctor import trial as doctor_trial


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, str, dict[str, Any], list[Path]]:
    """What the doctor exits with, prints and reports where all works, and what it leaves of its temporary files."""
    folder, scratch = tmp_path_factory.mktemp("doctor"), tmp_path_factory.mktemp("scratch")
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as printed:
        patch.setattr(doctor, "_LEAST_DISK", 0.0)  # not the machine's space is tested here
        patch.setattr(doctor, "_LEAST_SHARED", 0.0)
        patch.setattr(tempfile, "tempdir", str(scratch))
        code = cli.main(["doctor", "--folder", str(folder / "new"), "--json", str(folder / "report.json")])
    return code, printed.getvalue(), json.loads((folder / "report.json").read_text()), list(scratch.iterdir())


def test_a_machine_that_passes_the_tests_is_well(healthy: tuple[int, str, dict[str, Any], list[Path]]):
    code, printed, report, _ = healthy
    assert code == 0
    by_name = {finding["name"]: finding for finding in report["findings"]}
    assert report["ok"] and by_name["torch"]["status"] == "ok"
    assert "(the one in use)" in printed and "everything that is needed works" in printed
    for finding in report["findings"]:
        assert finding["detail"] in printed
        assert (finding["status"] == "ok") == (finding["fix"] == "")


def test_a_probe_that_crashes_hangs_or_babbles_is_told_apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    program = tmp_path / "python"
    monkeypatch.setattr(sys, "executable", str(program))
    told = {}
    for name, body in {"crash": "kill -SEGV $$", "hang": "exec sleep 60", "babble": "echo hello; exit 3"}.items():
        program.write_text(f"#!/bin/sh\n{body}\n")
        program.chmod(0o755)
        told[name] = doctor.run_probe("rendering", 1.0)
    assert not any(probe["ok"] for probe in told.values())
    assert "signal 11" in told["crash"]["error"]
    assert "hung for 1 s" in told["hang"]["error"]
    assert "ended with 3" in told["babble"]["error"]


@pytest.mark.parametrize(
    "working, chosen, broken, fix",
    [
        (["egl", "osmesa"], "egl", [], ""),
        (["osmesa"], "egl", ["egl"], "export MUJOCO_GL=osmesa"),
        ([], "egl", ["egl"], "apt install libegl1"),
        ([], None, ["egl"], "apt install libegl1"),
        (["egl"], "glfw", ["glfw"], "export MUJOCO_GL=egl"),
    ],
)
def test_only_the_backend_in_use_must_work(working: list[str], chosen: str | None, broken: list[str], fix: str):
    probes = {
        name: {"ok": True, "renderer": "llvmpipe"} if name in working else {"ok": False, "error": "no display"}
        for name in doctor.BACKENDS
    }
    findings = {finding.name.split()[-1]: finding for finding in doctor.rendering(probes, chosen)}
    assert [name for name, finding in findings.items() if finding.status == "broken"] == broken
    for name in broken:
        assert fix in findings[name].fix
    for name in working:
        assert findings[name].detail.startswith("software renderer llvmpipe")


def test_what_is_needed_and_broken_fails_the_command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    error = "RuntimeError: SumSegmentTreeFp32 is not available"
    monkeypatch.setattr(doctor, "probed", lambda timeout: [doctor.torch_pair({"ok": False, "error": error})])
    assert cli.main(["doctor"]) == 1
    output = capsys.readouterr()
    assert "broken   torch" in output.out and error in output.out and "pip install 'torch>=" in output.out
    assert "what is needed does not work:" in output.err and "torch" in output.err


def test_findings_are_written_to_a_folder_that_is_made_and_a_place_that_cannot_be_is_told_before_the_probes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(doctor, "probed", lambda timeout: [])
    monkeypatch.setattr(doctor, "_LEAST_DISK", 0.0)
    monkeypatch.setattr(doctor, "_LEAST_SHARED", 0.0)
    assert cli.main(["doctor", "--json", str(tmp_path / "new" / "x.json")]) == 0
    assert json.loads((tmp_path / "new" / "x.json").read_text())["ok"]
    capsys.readouterr()
    (tmp_path / "file").touch()
    (tmp_path / "folder.json").mkdir()
    for place, told in (("file/x.json", "file is a file and no folder"), ("folder.json", "it is a folder and no file")):
        assert cli.main(["doctor", "--json", str(tmp_path / place)]) == 2
        output = capsys.readouterr()
        assert told in output.err and output.err.count("\n") == 1 and output.out == ""


def test_little_memory_or_space_is_told_with_a_fix(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    for free, status in ((1e6, "broken"), (0.2e9, "note"), (0.8e9, "ok")):
        monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _, free=free: type("Usage", (), {"free": free}))
        finding = doctor.shared_memory(tmp_path)
        assert (finding.status, bool(finding.fix)) == (status, status != "ok")
    assert doctor.disk(tmp_path / "not" / "there").status == "broken"
    assert doctor.shared_memory(tmp_path / "none").status == "broken"


@pytest.mark.parametrize("threads, limit", [(None, ""), ("3", ", OMP_NUM_THREADS=3")])
def test_the_processors_that_may_be_used_are_told(threads: str | None, limit: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: {0, 5, 6})
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if threads is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
    assert doctor.machine().detail == f"3 of 8 may be used{limit}; use --workers 3"


@pytest.mark.parametrize("gpu", [True, False])
def test_a_gpu_is_told_by_name_and_its_absence_with_the_threads(gpu: bool, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: gpu)
    monkeypatch.setattr("torch.cuda.get_device_name", lambda index: f"Card {index}")
    device = doctor_probes.torch()["device"]
    assert device == "Card 0" if gpu else device.startswith("no GPU, ")


def test_a_probe_of_rendering_fails_on_a_wrong_picture(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(doctor_probes, "_SCENE", doctor_probes._SCENE.replace("0.9 0.1 0.1", "0.1 0.9 0.1"))
    with pytest.raises(RuntimeError, match="a red ball has the colour"):
        doctor_probes.rendering()


def test_a_trial_runs_steps_of_the_real_commands_and_leaves_nothing(
    healthy: tuple[int, str, dict[str, Any], list[Path]],
) -> None:
    _, _, report, left = healthy
    findings = {f["name"]: f for f in report["findings"] if f["name"].startswith("trial")}
    assert [(name, finding["status"]) for name, finding in findings.items()] == [
        ("trial of pretrain", "ok"),
        ("trial of train-rl", "ok"),
    ]
    assert findings["trial of pretrain"]["detail"].startswith("2 steps")
    assert "60 environment steps, 15 updates" in findings["trial of train-rl"]["detail"]
    assert left == []


def test_a_trial_tells_which_command_failed_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_trial, "_PRETRAINING", "--steps 0")
    (finding,) = doctor_trial.trial(120.0)
    assert (finding.name, finding.status) == ("trial of pretrain", "broken")
    assert "--steps must be at least 1, got 0" in finding.detail and "nerf-rl pretrain" in finding.fix
    monkeypatch.setattr(doctor_trial, "_DATASET", "--size -1")
    (finding,) = doctor_trial.trial(120.0)
    assert (finding.name, finding.status) == ("trial of gen-dataset", "broken") and "--size" in finding.detail
    (finding,) = doctor_trial.trial(0.05)
    assert "hung for 0 s" in finding.detail


def test_a_precision_that_fails_where_32_works_is_told_with_its_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    run = doctor_trial._run

    def fails_unless_32(arguments: list[str], timeout: float) -> object:
        works = arguments[0] != "pretrain" or "32" in arguments
        return run(arguments if works else [*arguments, "--scenes_per_step", "0"], timeout)

    monkeypatch.setattr(doctor_trial, "_run", fails_unless_32)
    (finding,) = doctor_trial.trial(120.0)
    assert finding.status == "broken" and finding.fix == "pretrain with --precision 32"
    assert "auto takes here" in finding.detail


@pytest.mark.parametrize(
    "python, machine, told",
    [
        ((3, 11), "x86_64", None),
        ((3, 12), "x86_64", "no wheels from Python 3.12 on, and this is 3.12"),
        ((3, 13), "aarch64", "this is 3.13"),
        ((3, 11), "aarch64", "wheels for x86_64 only, and this is aarch64"),
    ],
)
def test_the_doctor_says_why_panda_cannot_be_had(python: tuple[int, int], machine: str, told: str | None) -> None:
    lack = doctor_extras.no_panda(python, machine)
    assert (lack is None) == (told is None)
    if lack is not None and told is not None:
        assert told in lack[0] and lack[1]
    with open("pyproject.toml", "rb") as file:
        demand = next(iter(tomllib.load(file)["project"]["optional-dependencies"]["panda"]))
    marker = Requirement(demand).marker
    assert marker is not None
    environment = {"python_version": ".".join(map(str, python)), "platform_machine": machine}
    assert marker.evaluate(environment) == (told is None)


@pytest.mark.parametrize(
    "python, library, told",
    [
        ((3, 12), (2, 31), None),
        ((3, 13), (2, 35), None),
        ((3, 13), (2, 31), "need glibc 2.35, and this is 2.31"),
        ((3, 13), None, "another C library"),
    ],
)
def test_the_doctor_says_why_open3d_cannot_be_had(
    python: tuple[int, int], library: tuple[int, int] | None, told: str | None
) -> None:
    lack = doctor_extras.no_open3d(python, library)
    assert (lack is None) == (told is None)
    for installed in (True, False):
        finding = doctor_extras.open3d({"ok": False, "error": "ImportError: no"}, installed, lack)
        assert finding.status == "note" and (told or "") in finding.detail
        assert ("Python 3.11 or 3.12" in finding.fix) == (told is not None)


def test_an_extra_that_is_missing_here_is_told_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_extras, "EXTRAS", {"panda": "no-such-package"})
    monkeypatch.setattr(doctor_extras.platform, "machine", lambda: "aarch64")
    finding = next(iter(doctor_extras.extras({"ok": True, "version": "1"})))
    assert finding.status == "note" and "PyBullet" in finding.detail and finding.fix


def test_a_report_that_cannot_be_written_is_told_in_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["doctor", "--json", "/proc/nowhere/report.json"]) == 2
    assert "/proc/nowhere/report.json cannot be written" in capsys.readouterr().err
