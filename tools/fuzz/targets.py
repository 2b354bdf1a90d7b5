"""The kinds of file that a user may hand in, and the commands and loaders that read each, for ``fuzz_inputs.py``."""

import contextlib
import io
import json
import random
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lightning
import numpy as np
import yaml

from nerf_rl import cli
from nerf_rl.errors import FailureError, UserError
from nerf_rl.files.checksummed_json import CHECKSUM, with_checksum
from tools.fuzz import mutations

KINDS = (
    "recipe", "manifest", "plan", "shard", "encoder.json", "field.json", "policy.json", "weights", "checkpoint",
    "transforms",
)  # fmt: skip
RESULT, SENTENCE, TRACEBACK, HANG, MEMORY, EXECUTED = OUTCOMES = (
    "results", "sentences", "tracebacks", "hangs", "memory", "executed",
)  # fmt: skip
_MANIFEST, _PLAN, _SHARD = "manifest.json", "plan.json", "shards/000001.h5"
_CONFIG = "config.yaml"
_LONGEST_LINE = 5000
_FEW_VIEWS = 200  # that are rendered in a second or two


@dataclass(frozen=True)
class Base:
    """Good files to mutate: run folders of the commands, and a recipe."""

    recipe: Path
    dataset: Path
    encoder: Path
    agent: Path


class Targets:
    """Mutates a file of a copy of the base, and lets commands read it.

    Args:
        base: good files; they are left as they are.
        scratch: an empty folder.
        every: each so many-th mutation is read by whole commands that take seconds, too.
    """

    def __init__(self, base: Base, scratch: Path, every: int):
        self._every, self._scratch = every, scratch
        self.marker = scratch / "marker"
        scratch.mkdir(exist_ok=True)
        (scratch / f"{mutations.MODULE}.py").write_text(f"open({str(self.marker)!r}, 'w').close()\nclass Part: pass\n")
        sys.path.insert(0, str(scratch))
        folders = {name: scratch / name for name in ("dataset", "encoder", "agent")}
        for name, folder in folders.items():
            shutil.copytree(getattr(base, name), folder)
        self._base = Base(Path(shutil.copy(base.recipe, scratch / "recipe.yaml")), **folders)
        self._original = base
        for file, key in ((self._base.encoder / "config.yaml", "data"), (self._base.agent / "config.yaml", "encoder")):
            config = yaml.safe_load(file.read_text()) | {key: str(folders["dataset" if key == "data" else "encoder"])}
            file.write_text(yaml.safe_dump(config))
        policy = json.loads((self._base.agent / "policy.json").read_text())
        policy["env"]["encoder"] = str(self._base.encoder)
        (self._base.agent / "policy.json").write_text(json.dumps(policy))
        self._scenes = scratch / "scenes"
        _command("export", str(self._base.dataset), "--out", str(self._scenes), "--frames", "[0, 1]")

    def mutate(self, kind: str, seed: str, number: int) -> tuple[str, str]:
        """Mutate a file and read it; return the outcome and what was said or shown."""
        rng = random.Random(f"{seed} {kind} {number}")
        paths = self._files(kind)
        path = paths[number % len(paths)]
        good = {file: file.read_bytes() for file in (path, self._base.dataset / _MANIFEST)}
        others = [file.read_bytes() for kind_ in KINDS for file in self._files(kind_)]
        try:
            path.write_bytes(self._mutated(kind, path, good[path], rng, others))
            if kind == "shard" and rng.random() < 0.5:
                self._sign_shard()
            said = []
            for read in self._readers(kind, path, number):
                outcome, text = _outcome(read)
                said.append(text)
                if outcome == TRACEBACK:
                    return outcome, text
                if outcome == SENTENCE:
                    break
            return (SENTENCE if outcome == SENTENCE else RESULT), said[-1]
        finally:
            for file, content in good.items():
                file.write_bytes(content)
            for name in ("out", "run"):
                shutil.rmtree(self._scratch / name, ignore_errors=True)

    def executed(self) -> bool:
        """Tell whether a payload ran; forget it."""
        found = self.marker.exists()
        self.marker.unlink(missing_ok=True)
        sys.modules.pop(mutations.MODULE, None)
        return found

    def _files(self, kind: str) -> list[Path]:
        base = self._base
        checkpoint = next((base.agent / "checkpoints").iterdir())
        files = {
            "recipe": [base.recipe, base.dataset / _CONFIG, base.encoder / _CONFIG, base.agent / _CONFIG],
            "manifest": [base.dataset / _MANIFEST],
            "plan": [base.dataset / _PLAN],
            "shard": [base.dataset / _SHARD],
            "weights": [*sorted(base.encoder.glob("*.safetensors")), base.agent / "policy.safetensors"],
            "transforms": [self._scenes / "frame_000001" / "transforms.json"],
            "checkpoint": [base.encoder / "checkpoints" / "last.ckpt", *sorted(checkpoint.iterdir())],
        }  # fmt: skip
        return files.get(kind) or [(base.agent if kind == "policy.json" else base.encoder) / kind]

    def _mutated(self, kind: str, path: Path, good: bytes, rng: random.Random, others: list[bytes]) -> bytes:
        if path.suffix == ".yaml":
            return mutations.mutated_yaml(good, rng, others, self.marker)
        if path.suffix == ".safetensors":
            return mutations.mutated_tensors(good, rng, others, self.marker)
        if path.suffix == ".ckpt":
            return mutations.mutated_pickle_archive(good, rng, others, self.marker)
        if path.suffix == ".h5":
            return mutations.mutated_shard(good, rng, others)
        return mutations.mutated_json(good, rng, others, _signed if CHECKSUM in json.loads(good) else dict)

    def _sign_shard(self) -> None:
        """Let the manifest say that the shard was made as it is now."""
        from nerf_rl.datasets.storage.shards import sha256_of

        manifest = json.loads((self._base.dataset / _MANIFEST).read_text())
        manifest["shards"][1]["sha256"] = sha256_of(self._base.dataset / _SHARD)
        (self._base.dataset / _MANIFEST).write_text(json.dumps(with_checksum(manifest), indent=2) + "\n")

    def _readers(self, kind: str, path: Path, number: int) -> list[Callable[[], Any]]:
        base, out = self._base, str(self._scratch / "out")
        data, encoder, agent = str(base.dataset), str(base.encoder), str(base.agent)
        slow = number % (self._every * len(self._files(kind))) < len(self._files(kind))

        def command(*words: str) -> Callable[[], Any]:
            return lambda: _command(*words)

        def picture(subject: str, *words: str) -> Callable[[], Any]:
            return command("view", subject, "--png", f"{out}.png", "--overwrite", "true", "--frames", "1", *words)

        probe = command("probe", "--encoder", encoder, "--data", data, "--frames", "9")
        if kind == "recipe":
            commands = {base.encoder: "pretrain", base.agent: "train-rl"}
            words = (commands.get(path.parent, "gen-dataset"), "--config", str(path), "--out", out)
            slowly = [command(*words, "--estimate", "true"), lambda: _generate_little(words)]
            return [lambda: cli.parse(*_split(words)), *(slowly if slow and words[0] == "gen-dataset" else [])]
        seen = [picture(data), command("export", data, "--out", out, "--frames", "1"), probe, self._pretrain]
        if kind == "manifest":
            return [lambda: _read_dataset(base.dataset), *(seen if slow else []), command("check", data)]
        if kind == "plan":
            resume = ("gen-dataset", "--config", str(base.recipe), "--out", data, "--resume", "true")
            return [lambda: _resumable(resume), command("check", data)]
        if kind == "shard":
            return [lambda: _read_dataset(base.dataset), *(seen if slow else []), command("check", data)]
        evaluate = command("evaluate", "--run", agent, "--out", out, "--episodes", "1", "--envs", "1")
        if kind == "transforms":
            return [command("import", str(self._scenes), "--out", out)]
        if kind == "encoder.json":
            return [probe, *([picture(encoder), self._train] if slow else [])]
        if kind == "field.json" or path.name == "field.safetensors":
            return [lambda: _read_field(base.encoder), *([picture(encoder)] if slow else [])]
        if kind == "policy.json" or path.name == "policy.safetensors":
            return [lambda: _act(base.agent, encoder), *([evaluate] if slow else [])]
        if kind == "weights":
            return [probe, *([self._train] if slow else [])]
        if path.suffix == ".ckpt":
            checkpointed = command("probe", "--encoder", str(path), "--data", data, "--frames", "9")
            return [checkpointed, lambda: _go_on(path, base), *([lambda: self._resume("pretrain")] if slow else [])]
        return [lambda: _continue(base.agent), *([lambda: self._resume("train-rl")] if slow else [])]

    def _pretrain(self) -> None:
        """Train an encoder on the dataset for two steps."""
        words = ("--config", str(self._base.encoder / _CONFIG), "--data", str(self._base.dataset), "--steps", "2")
        _command("pretrain", *words, "--out", str(self._scratch / "out"), "--overwrite", "true")

    def _train(self) -> None:
        """Train an agent on the encoder for as short as can be."""
        words = ("--config", str(self._base.agent / _CONFIG), "--encoder", str(self._base.encoder), "--env_steps", "60")
        _command("train-rl", *words, "--out", str(self._scratch / "out"), "--overwrite", "true")

    def _resume(self, command: str) -> None:
        """Resume a copy of the run whose checkpoint was mutated, for a step more."""
        run = shutil.copytree(self._base.encoder if command == "pretrain" else self._base.agent, self._scratch / "run")
        config = yaml.safe_load((run / "config.yaml").read_text())
        steps = {"steps": 8} if command == "pretrain" else {"env_steps": 100}
        recipe = self._scratch / "resume.yaml"
        recipe.write_text(yaml.safe_dump({**config, **steps, "out": str(run), "resume": True, "overwrite": False}))
        _command(command, "--config", str(recipe))


def _signed(content: Any) -> Any:
    with contextlib.suppress(ValueError, RecursionError):  # what JSON cannot say cannot be signed
        return with_checksum(content)
    return content


def _split(words: tuple[str, ...]) -> tuple[str, list[str]]:
    return words[0], list(words[1:])


def _outcome(read: Callable[[], Any]) -> tuple[str, str]:
    """Run a reader; return what came of it, and what it said."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read()
    except (UserError, FailureError) as error:
        line = str(error)
        return (SENTENCE, line) if line else (TRACEBACK, "an empty message")
    except Exception:
        return TRACEBACK, traceback.format_exc()
    return RESULT, ""


def _command(*words: str) -> None:
    """Run a command; raise UserError with its sentence, or another error if it gave more than a line."""
    shown = io.StringIO()
    with contextlib.redirect_stderr(shown), contextlib.redirect_stdout(io.StringIO()):
        code = cli.main(list(words))
    text = shown.getvalue()
    if code == 0:
        return
    lines = [line for line in text.splitlines() if line.startswith("nerf-rl ")]
    if code not in (1, 2) or "Traceback" in text or len(lines) != 1 or len(lines[0]) > _LONGEST_LINE:
        raise RuntimeError(f"{words[0]} returned {code} and said: {text[-6000:]}")
    raise UserError(lines[0])


def _generate_little(words: tuple[str, ...]) -> None:
    """Generate a dataset unless it would be a large one."""
    config = cli.parse(*_split(words))
    if config.episodes * max(config.frames_per_episode, config.episode_steps) < _FEW_VIEWS and config.size < 200:
        _command(*words)


def _read_dataset(folder: Path) -> None:
    from nerf_rl.datasets.storage.frames import read_frame
    from nerf_rl.datasets.storage.reader import MultiViewDataset
    from nerf_rl.pretrain.model.encoder_rig import EncoderRig

    dataset = MultiViewDataset(folder)
    EncoderRig.of_dataset(dataset)
    for name in ("rgb", "depth", "semantic", "split", "state/qpos", "state/privileged", "cameras/projection"):
        dataset.read(name)
    for frame in range(len(dataset)):
        read_frame(dataset, frame)
    dataset.digest()


def _resumable(words: tuple[str, ...]) -> None:
    from nerf_rl.datasets.generation.unfinished import OutputRecord

    OutputRecord(cli.parse(*_split(words))).check()


def _read_field(folder: Path) -> None:
    import torch

    from nerf_rl.pretrain.model.conditioned_field import ConditionedField
    from nerf_rl.pretrain.model.field import RadianceField

    field = RadianceField.load(folder).requires_grad_(False)
    ConditionedField(field, torch.zeros(field.sizes["latent"]))


def _act(run: Path, encoder: str) -> None:
    from nerf_rl.rl.agents.policy import Policy

    policy = Policy.load(run, encoder)
    policy.act(np.zeros((1, policy.observation_size), np.float32))


def _go_on(path: Path, base: Base) -> None:
    """Look at a checkpoint as a run that is to be resumed from it does."""
    from nerf_rl.pretrain.resuming import require_resumable

    require_resumable(path, *_fitted(base))


_FITTED: list[Any] = []


def _fitted(base: Base) -> tuple[Any, Any]:
    """Return a module and a trainer of the base's run, made once."""
    if not _FITTED:
        from nerf_rl.datasets.storage.reader import MultiViewDataset
        from nerf_rl.pretrain.data.statistics import measure
        from nerf_rl.pretrain.model.encoder_rig import EncoderRig
        from nerf_rl.pretrain.objectives.snerl_module import SnerlModule

        config = cli.parse("pretrain", ["--config", str(base.encoder / "config.yaml")])
        dataset = MultiViewDataset(config.data)
        module = SnerlModule(config, dataset, measure(dataset, config), EncoderRig.of_dataset(dataset))
        _FITTED.extend([module, lightning.Trainer(logger=False, enable_checkpointing=False)])
    return _FITTED[0], _FITTED[1]


def _continue(run: Path) -> None:
    """Load the checkpoint of a run of train-rl as the viewer and a resumed run do."""
    import gymnasium

    from nerf_rl.rl.agents.policy import Policy
    from nerf_rl.rl.training.loop import Trainer
    from nerf_rl.viewer.pages.action_values import ActionValues

    policy = Policy.load(run, str(run.parent / "encoder"))
    ActionValues.load(run, policy)
    config = cli.parse("train-rl", ["--config", str(run / "config.yaml"), "--resume", "true"])

    class Spaces:
        num_envs = config.envs
        single_observation_space = gymnasium.spaces.Box(-1, 1, (policy.observation_size,))
        single_action_space = gymnasium.spaces.Box(-1, 1, (policy.action_size,))

    trainer = Trainer(config, Spaces(), run)  # type: ignore[arg-type]
    trainer.replay.close()
