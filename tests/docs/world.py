"""A folder in which a page's commands and Python are run as they stand, but for frames, steps and pixels."""

import contextlib
import functools
import io
import os
import re
import shlex
import shutil
import string
import subprocess
import tomllib
import urllib.request
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import gymnasium
import metaworld  # noqa: F401  registers its environments
import mujoco
import numpy as np
import pytest
import torch
from code_blocks import ROOT, Block, blocks, pages
from not_run import LINES, LISTINGS, TEXTS, UNFINISHED
from tiny_recipes import STEPS_OF_RECIPE

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.viewer import server

FEWER = {
    "gen-dataset": "--episodes 10 --frames_per_episode 2 --episode_steps 12 --size 24 --episodes_per_shard 5",
    "pretrain": "--steps 2 --validation_frames 1 --probe_frames 9",
    "train-rl": "--episode_steps 20 --evaluation_episodes 1 --final_evaluation_episodes 1",
    "evaluate": "--episodes 1 --video_episodes 1",
    "tune": "--trials 2 --whale.population 2 --workers 1 --overrides.env_steps 600 --overrides.warmup_steps 560"
    " --overrides.episode_steps 20 --overrides.evaluation_every 600 --overrides.final_evaluation_episodes 1",
    "view": "--frames 2 --episodes 1",
    "report": "--episodes 1",
}
"""Keys that make each command's work small."""
WHOLE_EPISODES = "--frames_per_episode 13"  # with the episode_steps above; what keeps every step still does
SMALLER = {
    "--ceiling_steps 1000": "--ceiling_steps 2",
    "--seeds 0..19": "--seeds 0,1",
    "$SLURM_ARRAY_TASK_ID/8": "$SLURM_ARRAY_TASK_ID/2",
    "episodes=50, size=128": "episodes=2, size=24",
}
"""Numbers of frames, steps, pixels, seeds and array jobs, in the words of the pages."""
TASKS = {"SLURM_ARRAY_TASK_ID": ("1", "2")}
"""Variables, and for which of their values a command is run."""
NEEDS = {"gymnasium_robotics": "gymnasium_robotics", "panda": "panda_gym", "ppo": "stable_baselines3", "mesh": "open3d"}
NEEDS |= {"lerobot": "av", "shimmy": "shimmy"}
"""What a command's line holds that needs an optional package."""
FIRST = {
    "--encoder runs/fetch-encoder": (
        "nerf-rl gen-dataset --config datasets/gym.yaml --scene gym/gymnasium_robotics:FetchReach-v4 --out data/fetch",
        "nerf-rl pretrain --config pretrain/demo.yaml --data data/fetch --out runs/fetch-encoder",
    ),
    "merge part1 part2": (
        "nerf-rl gen-dataset --config datasets/drawer-open.yaml --out part1 --shard 1/2",
        "nerf-rl gen-dataset --config datasets/drawer-open.yaml --out part2 --shard 2/2",
    ),
    "import captures": (
        "nerf-rl gen-dataset --config datasets/demo.yaml --out data/captured",
        "nerf-rl export data/captured --out captures",
    ),
    "import scenes": ("nerf-rl export data/drawer --out scenes",),
}
_LEROBOT = (
    "nerf-rl gen-dataset --scene metaworld/drawer-open-v3 --out data/episodes --frames_per_episode 101",
    "nerf-rl export data/episodes --out lerobot --format lerobot",
)
FIRST |= {"import lerobot": _LEROBOT, "av.open(path)": _LEROBOT}
"""What a page leaves to its reader to have done before."""


class World:
    """Runs blocks one after another, as a reader would from the root of a checkout.

    Args:
        folder: empty; it gets the checkout's recipes and examples, and folders named as in the pages.
        made: folders that are there from the start, by name.
    """

    def __init__(self, folder: Path, made: Mapping[str, Path]):
        self.folder = folder
        self._environment: dict[str, str] = {}
        for name in ("datasets", "examples", "pretrain", "rl"):
            (folder / name).symlink_to(ROOT / name)
        for name, path in made.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).symlink_to(path)
        (folder / "my.xml").write_text((ROOT / "datasets" / "scenes" / "blocks.xml").read_text())
        home = mujoco.MjModel.from_xml_path(str(folder / "my.xml")).key_qpos[0]
        np.savez(folder / "states.npz", qpos=np.tile(home, (10, 100, 1)))

    def run(self, block: Block, monkeypatch: pytest.MonkeyPatch) -> None:
        """Run a block; a command that fails, and one that cannot be run and is not listed, is an AssertionError."""
        monkeypatch.chdir(self.folder)
        for name, value in self._environment.items():
            monkeypatch.setenv(name, os.pathsep.join(filter(None, (value, os.environ.get(name)))))
            if name == "PYTHONPATH":
                monkeypatch.syspath_prepend(str(self.folder / value))
        text = block.text
        for words, commands in FIRST.items():
            if (
                words in " ".join(text.split())
                and not (self.folder / commands[-1].rpartition("--out ")[2].split()[0]).exists()
            ):
                for command in commands:
                    self._command(shlex.split(command), monkeypatch)
        for words, smaller in SMALLER.items():
            text = text.replace(words, smaller)
        if block.kind == "shell":
            for words in commands_of(text):
                self._line(words, block.page, monkeypatch)
        elif block.kind == "python":
            self._python(text, str(block))
        else:
            self._text(text)

    def _line(self, words: list[str], page: str, monkeypatch: pytest.MonkeyPatch) -> None:
        line = " ".join(words)
        if any(word in ("nerf-rl", "nerf_rl.cli") for word in words):
            begin = next(i for i, word in enumerate(words) if word in ("nerf-rl", "nerf_rl.cli"))
            check_arguments(words[begin + 1 :])
        if words[0] == "pip" and words[-1].startswith("."):
            extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
            assert re.fullmatch(r"\.\[(\w+)\]", words[-1])[1] in extras
        if line in LINES or last_page().get(line, page) != page:
            return
        if words[0] == "export":
            name, _, value = words[1].partition("=")
            self._environment[name] = value
        elif words[0] == "make":
            done = subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, capture_output=True, text=True)
            assert done.returncode == 0, done.stderr
        elif words[0] == "nerf-rl":
            for values in tasks_of(line):
                self._command([string.Template(word).substitute(values) for word in words], monkeypatch)
        else:
            raise AssertionError(f"nothing runs '{line}', and tests/docs/not_run.py does not list it")

    def _command(self, words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
        """Run nerf-rl; what it would write is removed if it is there, so that pages may use one name twice."""
        for needle, package in NEEDS.items():
            if needle in " ".join(words):
                pytest.importorskip(package, exc_type=ImportError)
        if words[2] == "--help":
            with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
                cli.main(words[1:])
            return
        config = cli.parse(words[1], words[2:])
        out = getattr(config, "out", None)
        goes_on = getattr(config, "resume", False) or getattr(config, "shard", "1/")[:2] not in ("", "1/")
        if out and not goes_on and not getattr(config, "estimate", False):
            remove(Path(out))
        with contextlib.redirect_stdout(io.StringIO()) as told:
            monkeypatch.setattr(server, "time", PressesCtrlC(told))
            assert cli.main([*words[1:], *fewer(words[1], config, words)]) == 0, " ".join(words)
        if out and not getattr(config, "estimate", False):
            assert Path(out).exists(), f"{' '.join(words)} has made nothing"

    def _python(self, text: str, name: str) -> None:
        text = re.sub(r"^(\w+) = \.\.\.", r"\1 = \1", text, flags=re.MULTILINE)
        program = compile(text, name, "exec")
        offered = {"__name__": "__main__"}
        offered |= {word: make() for word, make in self._reader_has().items() if word in program.co_names}
        if "generate_dataset" in program.co_names:
            remove(Path("data/drawer"))
        if "av" in program.co_names:
            offered["av"] = pytest.importorskip("av")
        with contextlib.redirect_stdout(io.StringIO()):
            exec(program, offered)

    def _reader_has(self) -> dict[str, Callable[[], Any]]:
        """Return what the reader of a Python block has at hand, by the names that blocks give it."""
        model = mujoco.MjModel.from_xml_path("my.xml")
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)

        def images() -> Any:
            dataset = MultiViewDataset("data/drawer")
            return torch.from_numpy(dataset.read("rgb", [0, 1])[:, dataset.views("encoder")])

        return {
            "np": lambda: np,
            "model": lambda: model,
            "data": lambda: data,
            "images": images,
            "path": lambda: str(next(Path("lerobot/labels").rglob("*.mp4"))),
            "env": lambda: gymnasium.make("Meta-World/MT1", env_name="drawer-open-v3"),
            "objective": lambda: lambda trial: trial.suggest_float("rate", 1e-5, 1e-2, log=True),
        }

    def _text(self, text: str) -> None:
        if any(text.startswith(begin) for begin in TEXTS):
            return
        folder = next((self.folder / name for begin, name in LISTINGS.items() if text.startswith(begin)), None)
        assert folder is not None, (
            f"nothing runs, and tests/docs/not_run.py does not list, the block that begins '{text[:40]}'"
        )
        listed = {name for name in names_listed(text) if name not in UNFINISHED}
        assert listed and {name for name in listed if not list(folder.glob(name.rstrip("/")))} == set()


class PressesCtrlC:
    """In place of the time module of a server that waits: opens the page that it serves, then ends it."""

    def __init__(self, told: io.StringIO):
        self._told = told

    def sleep(self, seconds: float) -> NoReturn:
        """Look at the page."""
        (url,) = re.findall(r"open (http://\S+)", self._told.getvalue())
        with urllib.request.urlopen(url) as page:
            assert b"<html" in page.read()
        raise KeyboardInterrupt


def commands_of(text: str) -> Iterator[list[str]]:
    """Yield the words of each command in a shell's block, without comments."""
    for line in text.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words


@functools.cache
def last_page() -> dict[str, str]:
    """Return for each command the last page on which it stands, where it is run; pages before have what it makes."""
    shell = [block for page in pages() for block in blocks(page) if block.kind == "shell"]
    return {" ".join(words): block.page for block in shell for words in commands_of(block.text)}


def check_arguments(words: list[str]) -> None:
    """Parse a command's arguments as the command itself does; ``...`` stands for those that it needs."""
    words = [string.Template(word).substitute(dict.fromkeys(TASKS, "1")) for word in words]
    if "..." in words:
        place = words.index("...")
        words[place : place + 1] = ["--data", "data/drawer", "--out", "runs/encoder"]
    if "--help" in words or "runs/tune/best.yaml" in words:  # which only running tune gives
        assert words[0] in cli.COMMANDS
    else:
        cli.parse(words[0], words[1:])


def tasks_of(line: str) -> list[dict[str, str]]:
    """Return the values of the variables in a line, for each of which it is run."""
    names = [name for name in TASKS if f"${name}" in line]
    return [{name: value} for name in names for value in TASKS[name]] or [{}]


def fewer(command: str, config: Any, words: list[str]) -> list[str]:
    """Return the keys that make a command small."""
    keys = FEWER.get(command, "").split()
    if command == "gen-dataset":
        keys += ["--workers", "1"]
        if config.frames_per_episode == config.episode_steps + 1:
            keys += WHOLE_EPISODES.split()
    if command == "train-rl":
        recipe = Path(words[words.index("--config") + 1]).stem
        keys += STEPS_OF_RECIPE.get(recipe, STEPS_OF_RECIPE["drawer-open"])
    return keys


def names_listed(text: str) -> Iterator[str]:
    """Yield the names of files in the first column of a listing."""
    for line in text.splitlines():
        if not line.startswith(" "):
            column = re.split(r"\s{2,}", line)[0].removesuffix(" ...")
            yield from column.split(", ")


def remove(path: Path) -> None:
    """Remove what is there, if anything; of a link, the link alone."""
    if path.is_symlink() or path.is_file():
        path.unlink()
    elif path.is_dir():
        shutil.rmtree(path)
