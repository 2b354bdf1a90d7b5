"""A few steps of the real commands on a tiny scene: what the doctor cannot tell from parts that work one by one."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from nerf_rl.doctor.finding import Finding, shortened
from nerf_rl.files.json_files import read_json
from nerf_rl.files.outputs import SUMMARY

_SCENE = "metaworld/drawer-open-v3"
_DATASET = """
--episodes 4 --frames_per_episode 2 --episode_steps 8 --size 24 --validation_fraction 0.5 --episodes_per_shard 4
--workers 1
"""
_PRETRAINING = """
--steps 2 --steps_per_epoch 2 --epochs_per_validation 1 --validation_frames 1 --probe_frames 4 --scenes_per_step 2
--rays_per_scene 8 --encoder.latent 8 --encoder.patch 4 --encoder.channels [8,16] --encoder.hidden 16
--radiance_field.width 16 --radiance_field.layers 2 --sampling.rendering_stratified 4
--sampling.rendering_importance 2
"""
_TRAINING = """
--env_steps 60 --warmup_steps 30 --episode_steps 20 --envs 1 --learner.batch_size 8 --replay.capacity 100
--network.hidden [16,16] --evaluation_every 60 --evaluation_episodes 1 --final_evaluation_episodes 1
"""


@dataclass(frozen=True)
class _Run:
    """How a command went."""

    error: str
    """what went wrong, in a line; empty if nothing did"""
    seconds: float


def trial(timeout: float) -> Iterable[Finding]:
    """Generate a dataset, pretrain on it in the precision that is chosen here, and train from the encoder.

    Args:
        timeout: after which a command is ended [s].
    """
    with TemporaryDirectory(prefix="nerf-rl-doctor-") as scratch:
        data, encoder, agent = (Path(scratch) / name for name in ("data", "encoder", "agent"))
        generated = _run(["gen-dataset", "--scene", _SCENE, "--out", str(data), *_DATASET.split()], timeout)
        if generated.error:
            yield _broken("gen-dataset", generated)
            return
        pretraining = ["pretrain", "--data", str(data), "--out", str(encoder), *_PRETRAINING.split()]
        pretrained = _run(pretraining, timeout)
        if pretrained.error:
            plain = _run([*pretraining, "--precision", "32", "--overwrite", "true"], timeout)
            if plain.error:
                yield _broken("pretrain", pretrained)
            else:
                told = _Run(f"in the precision that auto takes here, not in 32: {pretrained.error}", pretrained.seconds)
                yield _broken("pretrain", told, "pretrain with --precision 32")
            return
        summary = read_json(encoder / SUMMARY)
        precision, device = summary.get("precision"), summary.get("device")
        how = (f" in precision {precision}" if precision else "") + (f" on {device}" if device else "")
        yield _works("pretrain", pretrained, f"{summary['steps']} steps{how}")
        keys = ["--scene", _SCENE, "--encoder", str(encoder), "--out", str(agent)]
        trained = _run(["train-rl", *keys, *_TRAINING.split()], timeout)
        if trained.error:
            yield _broken("train-rl", trained)
            return
        summary = read_json(agent / SUMMARY)
        yield _works("train-rl", trained, f"{summary['env_steps']} environment steps, {summary['updates']} updates")


def _works(command: str, run: _Run, what: str) -> Finding:
    return Finding(f"trial of {command}", "ok", f"{what}, {run.seconds:.0f} s with its start")


def _broken(command: str, run: _Run, fix: str = "") -> Finding:
    whole = f"run nerf-rl {command} with keys of your own to see all of the message"
    return Finding(f"trial of {command}", "broken", shortened(run.error), fix or whole)


def _run(arguments: Sequence[str], timeout: float) -> _Run:
    """Run a command in a process, and a session, of its own; end it and its workers if it hangs."""
    started = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "nerf_rl.cli", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        told = process.communicate(timeout=timeout)[1]
    except subprocess.TimeoutExpired:
        return _Run(f"hung for {timeout:.0f} s", timeout)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    seconds = time.monotonic() - started
    if process.returncode == 0:
        return _Run("", seconds)
    crashed = f"crashed (signal {-process.returncode})" if process.returncode < 0 else "failed"
    return _Run(f"{crashed}: {told.strip().rpartition(chr(10))[2]}", seconds)
