"""What ``make`` does about what is there already: of a demo, and of an environment that was not finished."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NERF_RL = """#!/bin/sh
# Stands for the command: does nothing but to write what make looks for, and to refuse a report that is there.
command=$1
while [ $# -gt 0 ]; do
    case $1 in --out) out=$2 ;; --overwrite) overwrite=$2 ;; esac
    shift
done
echo "$command" >>calls
if [ "$command" != report ]; then mkdir -p "$out" && touch "$out/summary.json" && exit; fi
[ ! -e "$out" ] || [ "${overwrite:-false}" = true ] || exit 2
touch "$out"
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with what make reads."""
    for file in ("Makefile", "pyproject.toml", *(f"tools/install/{n}.sh" for n in ("environment", "find_python"))):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / file, tmp_path / file)
    (tmp_path / "tools" / "install" / "python_packages.sh").write_text("install_with() { :; }\n")
    return tmp_path


def test_a_demo_whose_agent_was_taken_away_is_completed(checkout: Path) -> None:
    (checkout / ".venv" / "bin").mkdir(parents=True)
    (checkout / ".venv" / "bin" / "nerf-rl").write_text(NERF_RL)
    (checkout / ".venv" / "bin" / "nerf-rl").chmod(0o755)
    digest = subprocess.run(["cksum", "pyproject.toml"], cwd=checkout, capture_output=True, text=True, check=True)
    (checkout / ".venv" / f"ready-{digest.stdout.split()[0]}").touch()
    for expected in (["gen-dataset", "pretrain", "train-rl", "report"], ["train-rl", "report"], []):
        (checkout / "calls").write_text("")
        subprocess.run(["make", "demo"], cwd=checkout, check=True, capture_output=True)
        assert (checkout / "calls").read_text().split() == expected
        if len(expected) == 4:
            shutil.rmtree(checkout / "runs" / "demo" / "agent")


def test_an_environment_without_pip_is_completed_and_keeps_what_is_in_it(checkout: Path) -> None:
    python = checkout / ".venv" / "bin" / "python"
    setup = ["env", f"PYTHON={sys.executable}", "sh", "tools/install/environment.sh"]
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", checkout / ".venv"], check=True)
    (checkout / ".venv" / "mine").touch()
    for anew in (True, False):
        said = subprocess.run(setup, cwd=checkout, check=True, capture_output=True, text=True).stdout
        assert ("making .venv" in said) == anew and (checkout / ".venv" / "mine").exists()
        subprocess.run([python, "-m", "pip", "--version"], check=True, capture_output=True)
