"""From a dataset's frames to an encoder's latents, and what a linear probe reads from them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor

from nerf_rl.datasets.storage.frames import Frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import DEPTH, LABELS
from nerf_rl.pretrain.measures.linear_probe import encode_frames, linear_probe
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import described_classes
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.viewer.drawing.pictures import depth_limits


class EncodedDataset:
    """A dataset seen through an encoder and its field.

    Args:
        path: of the encoder.
        folder: its run folder, where the field lies.
        dataset: rendered with the encoder's cameras.
        device: of encoder and field.

    Attributes:
        palette: colours of the classes that the field tells apart, which a dataset without labels does not know.
    """

    def __init__(self, path: str, folder: Path, dataset: MultiViewDataset, device: torch.device | str = "cpu"):
        self.dataset = dataset
        self.encoder = Encoder.load(path).to(device)
        self.field = RadianceField.load(folder).requires_grad_(False).to(device)
        self._views = dataset.views("encoder")
        known = described_classes(folder)[1] if LABELS in dataset.absent else dataset.palette
        self.palette: UInt8[ndarray, "C 3"] = np.array(known, np.uint8)

    @torch.inference_mode()
    def latent(self, frame: Frame) -> Float[Tensor, "Z"]:
        """Return a frame's latent, not standardised."""
        return self.encoder.encode(torch.from_numpy(frame.rgb[self._views])[None])[0]

    def depth_limits(self, frame: Frame) -> tuple[float, float]:
        """Return limits [m] for the colours of depth: those of a frame, or where the field ends if it has no depth."""
        bounds = self.field.bounds
        return (bounds.near, bounds.far) if DEPTH in frame.absent else depth_limits(frame)

    def folded(self, latent: Float[Tensor, "Z"]) -> ConditionedField:
        """Return the field of the scene that a latent describes."""
        return ConditionedField(self.field, latent)

    def fit_probe(self, frames: int = 600) -> "Probe":
        """Fit a linear probe on evenly spread training frames."""
        train = self.dataset.split("train")
        chosen = train[np.unique(np.linspace(0, len(train) - 1, min(frames, len(train))).astype(int))]
        targets = self.dataset.tracked_positions(chosen).astype(np.float64)
        names = self.dataset.columns("privileged")
        varying = [i for i in range(len(names)) if targets[:, i].std() > 1e-4]
        latents = encode_frames(self.encoder, self.dataset, chosen)
        return Probe(tuple(names[i] for i in varying), latents, targets[:, varying])


@dataclass(frozen=True)
class Probe:
    """A linear map from latents to the true state, by the frames that it is fitted on."""

    names: tuple[str, ...]
    """of the T columns"""
    latents: Float[ndarray, "N Z"]
    targets: Float[ndarray, "N T"]
    """[m]"""

    def read(self, latent: Float[Tensor, "Z"]) -> dict[str, float]:
        """Return what the probe reads from a latent [m]."""
        values = linear_probe(self.latents, self.targets, latent[None].double().cpu().numpy())[0]
        return dict(zip(self.names, values.tolist(), strict=True))
