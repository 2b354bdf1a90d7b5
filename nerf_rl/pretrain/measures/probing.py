"""What a frozen encoder's latent knows of the true state, beside other encoders of its size."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.measures.figures import MEDIAN, NETWORK, RMSE, describe_error
from nerf_rl.pretrain.measures.linear_probe import encode_frames, linear_probe
from nerf_rl.pretrain.measures.network_probe import network_probe
from nerf_rl.pretrain.measures.probe_targets import Target, column_targets, joint_targets, varying
from nerf_rl.pretrain.measures.supervised import train_supervised
from nerf_rl.pretrain.model.encoder import Encoder

Figures = dict[str, dict[str, float]]
"""Name of what is read to ``rmse_mm`` and ``median_mm``, or ``rmse_deg`` and ``median_deg``, and ``r2``; after
``network_``, those of the network probe."""


@dataclass(frozen=True)
class EncoderFigures:
    """Figures of one encoder."""

    columns: Figures
    """of the privileged state"""
    joints: Figures
    """of the scene; none of a dataset that does not name them"""


@dataclass
class ProbeResult:
    """Figures of the encoder and of others beside it."""

    encoder: EncoderFigures
    random_encoder: EncoderFigures
    """of an untrained encoder"""
    supervised: EncoderFigures | None = None
    """of an encoder that was trained on the columns themselves"""

    def table(self) -> str:
        """Return the errors as lines of text, each of the linear probe and then of the network probe.

        A median far below its RMSE says that few frames make the error: often those in which no camera sees the thing,
        or in which it is where hardly a frame of the training shows it.
        """
        others = {"untrained encoder": self.random_encoder, "supervised encoder": self.supervised}
        beside = {title: figures for title, figures in others.items() if figures is not None}
        head = f"{'linear probe, network probe':<28} {'RMSE':>17} {'median':>17} {'R2':>7}"
        lines = [head + "".join(f" {title:>20}" for title in beside)]
        for group in ("columns", "joints"):
            for name, figures in getattr(self.encoder, group).items():
                cells = (f" {_both(getattr(other, group)[name]):>20}" for other in beside.values())
                own = f"{name:<28} {_both(figures):>17} {_both(figures, MEDIAN):>17} {figures['r2']:>7.3f}"
                lines.append(own + "".join(cells))
        return "\n".join(lines) if len(lines) > 1 else "no true state that varies, so nothing to probe"

    def summary(self) -> dict[str, Figures]:
        """Return what ``summary.json`` holds of them."""
        encoders = {"": self.encoder, "_random_encoder": self.random_encoder, "_supervised_encoder": self.supervised}
        found = {name: figures for name, figures in encoders.items() if figures is not None}
        columns = {f"probe{name}": figures.columns for name, figures in found.items()}
        return columns | {f"joint_probe{name}": figures.joints for name, figures in found.items() if figures.joints}


def probe_encoder(
    encoder: Encoder, dataset: MultiViewDataset, frames: int, seed: int, ceiling_steps: int = 0
) -> ProbeResult:
    """Fit probes on training frames and measure them on all held-out frames, for the encoder and an untrained copy.

    What does not vary is left out.

    Args:
        encoder: frozen; it is run where it is.
        dataset: with the encoder's cameras.
        frames: how many training frames to fit on, evenly spread.
        seed: of the untrained copy and of network probes.
        ceiling_steps: for how long to train a copy on the true state, which shows what is possible; 0 for none.

    Raises:
        UserError: there are too few frames.
    """
    train, held_out = dataset.split("train"), dataset.split("validation")
    if len(train) < 2 or len(held_out) < 2:
        raise UserError(f"{dataset.folder} needs at least two training and two validation frames to probe on")
    train = train[np.linspace(0, len(train) - 1, min(frames, len(train))).astype(int)]
    columns = [column_targets(dataset, part) for part in (train, held_out)]
    joints = [joint_targets(dataset, part) for part in (train, held_out)]
    probed, moving = varying(*columns), varying(*joints)
    episodes = dataset.read("episode", train)

    def figures(candidate: Encoder) -> EncoderFigures:
        latents = [encode_frames(candidate, dataset, part) for part in (train, held_out)]
        known, truth = (
            [*(named[i] for i in probed), *(turned[i] for i in moving)]
            for named, turned in zip(columns, joints, strict=True)
        )
        found = _figures(latents, known, truth, episodes, seed)
        names = [target.name for target in truth]
        of_columns, of_joints = found[: len(probed)], found[len(probed) :]
        return EncoderFigures(
            dict(zip(names[: len(probed)], of_columns, strict=True)),
            dict(zip(names[len(probed) :], of_joints, strict=True)),
        )

    result = ProbeResult(figures(encoder), figures(encoder.untrained(seed)))
    if ceiling_steps and not probed:
        print("no supervised encoder: no column of the true state varies as the encoder's cameras see it", flush=True)
    elif ceiling_steps:
        supervised = train_supervised(encoder, dataset, probed, ceiling_steps, seed)
        result.supervised = figures(supervised.to(encoder.latent_mean.device))
    return result


def _figures(
    latents: Sequence[ndarray], known: Sequence[Target], truth: Sequence[Target], episodes: ndarray, seed: int
) -> list[dict[str, float]]:
    """Return the figures of each target.

    Args:
        latents: of the frames to fit on, and of those to measure on.
        known: of the frames to fit on.
        truth: of the frames to measure on.
        episodes: of the frames to fit on.
        seed: of the network probe.
    """
    if not known:
        return []
    values = np.concatenate([target.values for target in known], axis=1)
    found: list[dict[str, float]] = [{} for _ in truth]
    read = {"": linear_probe(latents[0], values, latents[1])}
    read[NETWORK] = network_probe(latents[0], values, latents[1], episodes, seed)
    for kind, numbers in read.items():
        places = np.cumsum([target.values.shape[1] for target in truth])[:-1]
        for figures, target, part in zip(found, truth, np.split(numbers, places, axis=1), strict=True):
            errors = target.error(target.values, part)
            unexplained = ((part - target.values) ** 2).mean(0).sum() / target.values.var(0).sum()
            figures[f"{kind}{RMSE}_{target.unit}"] = round(float((errors**2).mean()) ** 0.5, 3)
            figures[f"{kind}{MEDIAN}_{target.unit}"] = round(float(np.median(np.abs(errors))), 3)
            figures[f"{kind}r2"] = round(1.0 - float(unexplained), 4)
    return found


def _both(figures: dict[str, float], error: str = RMSE) -> str:
    return f"{describe_error(figures, error=error)}, {describe_error(figures, NETWORK, error)}"
