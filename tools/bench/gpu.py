"""Measure the demo on a machine with a GPU: generation by its OpenGL, pretraining, an agent, the viewer's field.

Run from a checkout's root, with nothing else running:

    .venv/bin/python -m tools.bench.gpu [--json FILE] [--work FOLDER] [--keep] [--stages STAGE ...]

Pretraining runs the demo's recipe in float32 and in bfloat16, for its steps or --minutes, whichever is over first. The
agent learns on the CPU and on the GPU. The profile tells for how much of a training step the device is busy, and with
what. --device cpu --share 0.02 tries all of it, small, on a machine without one. A stage that fails is recorded with
what it said, and the others go on; stages that are left out keep what the file says of them.
"""

import argparse
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nerf_rl.cameras.geometry import look_at
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions
from nerf_rl.machine.gl import is_software

RECIPES = {"data": "datasets/demo.yaml", "encoder": "pretrain/demo.yaml", "agent": "rl/demo.yaml"}
PRECISIONS = ("32", "bf16")
WARM_STEPS, TIMED_STEPS, PROFILED_STEPS = 20, 100, 10  # of training, for the profile
BATCHES = 8  # that it goes round
LISTED_OPERATIONS = 12  # those that take the device longest
PICTURES = 40  # of the field, from a camera that moves
SIDE = 128  # of a picture [pixels]


def main() -> int:
    """Measure, print, write; return 1 if a stage failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, default=Path("tools/results/gpu.json"))
    parser.add_argument("--work", type=Path, default=None, help="where datasets and runs go (default: a temporary one)")
    parser.add_argument("--keep", action="store_true", help="leave them there")
    parser.add_argument("--device", choices=["gpu", "cpu"], default="gpu")
    parser.add_argument("--share", type=float, default=1.0, help="of the demo's frames and steps")
    parser.add_argument(
        "--minutes", type=float, default=None, help="of each pretraining; as the recipe has it if left out"
    )
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)), help="render processes")
    parser.add_argument("--stages", nargs="+", help="only these (default: all)")
    arguments = parser.parse_args()
    work = arguments.work or Path(tempfile.mkdtemp(prefix="bench_gpu_"))
    result: dict[str, Any] = {
        "command": " ".join(["python -m tools.bench.gpu", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": package_versions(),
        "processors": len(os.sched_getaffinity(0)),
        "share": arguments.share,
    }
    bench = Bench(work, arguments.device, arguments.share, arguments.minutes, arguments.workers)
    stages: dict[str, Callable[[], dict[str, Any]]] = {
        "gpu": bench.gpu,
        "generation": bench.generation,
        **{f"pretraining_{name}": (lambda name=name: bench.pretraining(name)) for name in PRECISIONS},
        **{f"profile_{name}": (lambda name=name: bench.profile(name)) for name in PRECISIONS},
        "batches": bench.batches,
        **{
            f"agent_on_{name}": (lambda name=name: bench.agent(name))
            for name in dict.fromkeys(("cpu", arguments.device))
        },
        "field": bench.field,
    }
    if unknown := set(arguments.stages or ()) - set(stages):
        parser.error(f"unknown stages {', '.join(sorted(unknown))}; there are {', '.join(stages)}")
    if arguments.stages and arguments.json.exists():
        result = {**read_json(arguments.json), **result}
    for name, measure in stages.items():
        if arguments.stages and name not in arguments.stages:
            continue
        start = time.monotonic()
        try:
            result[name] = measure()
        except Exception as error:  # the figures of the other stages are worth having
            result[name] = {"failed": f"{type(error).__name__}: {error}"}
        print(f"{name}: {time.monotonic() - start:.0f} s  {json.dumps(result[name])}", flush=True)
        write_json(arguments.json, result)
    if not arguments.keep:
        shutil.rmtree(work)
    return int(any("failed" in value for value in result.values() if isinstance(value, dict)))


class Bench:
    """The stages, each from what the ones before have left in a folder.

    Args:
        work: the folder.
        device: ``gpu`` or ``cpu``.
        share: of the demo's frames and steps.
        minutes: of each pretraining; None as in the recipe.
        workers: render processes.
    """

    def __init__(self, work: Path, device: str, share: float, minutes: float | None, workers: int):
        self._work, self._device, self._share, self._minutes, self._workers = work, device, share, minutes, workers
        self._recipes = {name: yaml.safe_load(Path(path).read_text()) for name, path in RECIPES.items()}
        self._torch_device = "cuda" if device == "gpu" else "cpu"

    def gpu(self) -> dict[str, Any]:
        """Return what PyTorch finds."""
        import torch

        if self._torch_device == "cpu":
            return {"name": "none"}
        properties = torch.cuda.get_device_properties(0)
        return {
            "name": properties.name,
            "memory_gb": round(properties.total_memory / 1e9, 1),
            "computes_bfloat16": torch.cuda.is_bf16_supported(including_emulation=False),
        }

    def generation(self) -> dict[str, Any]:
        """Render the demo's dataset."""
        recipe = self._recipes["data"]
        episodes = max(4, round(self._share * recipe["episodes"]))
        shard = max(1, min(recipe["episodes_per_shard"], -(-episodes // self._workers)))
        keys = {"episodes": episodes, "episodes_per_shard": shard, "workers": self._workers}
        summary = self._run("gen-dataset", "data", "data", keys)
        return {**summary, "hardware": not is_software(summary["renderer"])}

    def pretraining(self, precision: str) -> dict[str, Any]:
        """Train the demo's encoder in a precision."""
        recipe = self._recipes["encoder"]
        keys = {
            "data": self._work / "data",
            "accelerator": self._device,
            "precision": precision,
            "steps": max(4, round(self._share * recipe["steps"])),
            "max_minutes": self._minutes or recipe["max_minutes"],
        }
        return self._run("pretrain", "encoder", f"encoder_{precision}", keys)

    def profile(self, precision: str) -> dict[str, Any]:
        """Return how long a training step takes and what it consists of: launched in parts, and replayed as one graph.

        Only a GPU replays, and only in float32.
        """
        launched = {"launched": self._profile(precision, graph=False)}
        if self._torch_device == "cpu" or precision != "32":
            return launched
        return {"replayed": self._profile(precision, graph=True), **launched}

    def _profile(self, precision: str, graph: bool) -> dict[str, Any]:
        """Return how long a training step of the demo takes, and for how much of it the device computes what [ms]."""
        import torch

        device = torch.device(self._torch_device)
        step = self._training_step(precision, graph)
        for _ in range(WARM_STEPS):
            step()
        start = time.perf_counter()
        for _ in range(TIMED_STEPS):
            step()
        if device.type == "cuda":
            torch.cuda.synchronize()
        taken = 1e3 * (time.perf_counter() - start) / TIMED_STEPS
        with torch.profiler.profile() as profiler:  # of the processor, and of the GPU if there is one
            for _ in range(PROFILED_STEPS):
                step()
            if device.type == "cuda":
                torch.cuda.synchronize()
        on_cpu = device.type == "cpu"
        spent = {
            event.key: (event.self_cpu_time_total if on_cpu else event.self_device_time_total, event.count)
            for event in profiler.key_averages()
            if on_cpu or event.device_type == torch.autograd.DeviceType.CUDA
        }
        ordered = sorted(spent.items(), key=lambda item: -item[1][0])
        busy = sum(microseconds for microseconds, _ in spent.values()) / 1e3 / PROFILED_STEPS
        return {
            "step_ms": round(taken, 2),
            "busy_ms": round(busy, 2),
            "operations": round(sum(count for _, count in spent.values()) / PROFILED_STEPS),
            "longest_ms": {
                name[:80]: round(time / 1e3 / PROFILED_STEPS, 3) for name, (time, _) in ordered[:LISTED_OPERATIONS]
            },
        }

    def _training_step(self, precision: str, graph: bool) -> Callable[[], None]:
        """Return what does a training step of the demo's encoder, on batches that are on the device already."""
        import torch

        from nerf_rl.arguments.parsing import parse_config
        from nerf_rl.datasets.storage.reader import MultiViewDataset
        from nerf_rl.pretrain.config import PretrainConfig
        from nerf_rl.pretrain.data.data_module import MultiViewDataModule
        from nerf_rl.pretrain.fitting import make_module

        device = torch.device(self._torch_device)
        words = ["--config", RECIPES["encoder"], "--data", str(self._work / "data"), "--out", "out"]
        words += ["--step_graph", str(graph).lower(), "--precision", precision]
        config = parse_config(PretrainConfig, "pretrain", "", words)
        dataset = MultiViewDataset(self._work / "data")
        data = MultiViewDataModule(dataset, config)
        module = make_module(config, dataset, data).to(device)
        optimiser = module.configure_optimizers()["optimizer"]
        drawn = itertools.islice(data.train_dataloader(), BATCHES)
        batches = itertools.cycle([type(batch)(*(part.to(device) for part in batch)) for batch in drawn])

        def step() -> None:
            with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bf16"):
                loss = module.training_step(next(batches), 0)
            optimiser.zero_grad()
            loss.backward()
            module.configure_gradient_clipping(optimiser)
            optimiser.step()

        return step

    def batches(self) -> dict[str, Any]:
        """Return how long a loop of 5 ms steps waits for its batches [ms], by the processes that prepare them."""
        from nerf_rl.datasets.storage.reader import MultiViewDataset
        from nerf_rl.pretrain.config import PretrainConfig
        from nerf_rl.pretrain.data.data_module import MultiViewDataModule

        waits = {}
        dataset = MultiViewDataset(self._work / "data")
        for workers in (0, 2, 4, 8):
            module = MultiViewDataModule(dataset, PretrainConfig("data", "out", loader_workers=workers))
            batches, found = iter(module.train_dataloader()), []
            for _ in range(60):
                start = time.perf_counter()
                next(batches)
                found.append(1e3 * (time.perf_counter() - start))
                time.sleep(0.005)
            waits[str(workers)] = round(float(np.median(found[10:])), 2)
        return {"median_wait_ms_by_loader_workers": waits}

    def agent(self, device: str) -> dict[str, Any]:
        """Train the demo's agent on a device, from the encoder that was trained last."""
        recipe = self._recipes["agent"]
        steps = max(1500, round(self._share * recipe["env_steps"]))
        keys = {
            "encoder": self._encoder(),
            "device": {"gpu": "cuda"}.get(device, device),
            "env_steps": steps,
            "warmup_steps": min(recipe["warmup_steps"], steps // 2),
        }
        return self._run("train-rl", "agent", f"agent_{device}", keys)

    def field(self) -> dict[str, Any]:
        """Return how fast the viewer's field renders for a camera that moves."""
        import torch

        from nerf_rl.pretrain.model.conditioned_field import ConditionedField
        from nerf_rl.pretrain.model.field import RadianceField
        from nerf_rl.viewer.field.progressive import FreeCamera, Picture, render_progressively

        device = torch.device(self._torch_device)
        folder = self._encoder()
        whole = RadianceField.load(folder).to(device)
        latent = torch.zeros(whole.sizes["latent"], device=device)
        field, seconds = ConditionedField(whole, latent), []
        for azimuth in np.linspace(0.0, 90.0, PICTURES):
            pose = look_at(np.array(whole.bounds.centre), 2.0 * whole.bounds.half_extent, float(azimuth), -30.0)
            camera = FreeCamera(pose, float(np.deg2rad(45.0)), 1.0)
            start = time.perf_counter()
            *_, image = render_progressively(field, camera, 32, [Picture(SIDE)])
            seconds.append(time.perf_counter() - start)
        assert np.isfinite(image.rgb).all()
        return {"side": SIDE, "pictures_per_second": round(1.0 / float(np.median(seconds[3:])), 1)}

    def _encoder(self) -> Path:
        found = [self._work / f"encoder_{name}" for name in PRECISIONS]
        return next(folder for folder in reversed(found) if (folder / SUMMARY).is_file())

    def _run(self, command: str, recipe: str, out: str, keys: dict[str, Any]) -> dict[str, Any]:
        """Run a command with a recipe and other keys; return its summary."""
        folder = self._work / out
        words = [word for key, value in keys.items() for word in (f"--{key}", str(value))]
        start = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "nerf_rl.cli", command, "--config", RECIPES[recipe], "--out", str(folder), *words],
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise RuntimeError(done.stderr.strip().rpartition("\n")[2])
        return {"whole_command_seconds": round(time.monotonic() - start, 1), **read_json(folder / SUMMARY)}


if __name__ == "__main__":
    sys.exit(main())
