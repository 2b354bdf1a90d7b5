"""Cameras that often see nothing of what the others see: they look elsewhere, or something stands before them."""

import shlex
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import LABELS

_FRAMES = 100  # that are looked at, evenly from all of a dataset
_LITTLE = 1e-3  # of a picture's pixels, that do not show the background
_OFTEN = 0.1  # of the frames


def warn_of_blind_cameras(folder: Path) -> dict[str, dict[str, float]]:
    """Warn of cameras that in a tenth or more of the frames see the background alone, while another one sees more.

    Each of their pictures may be right, but tells an encoder nothing of what moves. Nothing is known of pictures that
    have no labels, as imported ones may be. If no camera sees anything but the background in any of the frames, that is
    warned of, too.

    Returns:
        What the dataset's summary is to say of them: the share of such frames, by the camera's name.
    """
    dataset = MultiViewDataset(folder)
    if LABELS in dataset.absent:
        return {}
    sees, look = _sees(dataset), f"nerf-rl view {shlex.quote(str(folder))}"
    if not sees.any() and len(dataset.class_names) > 1:
        print(
            f"warning: no camera sees anything but the background in any of {len(sees)} frames: the cameras look "
            "elsewhere, or what moves is too small for them or lies before their near plane (visual/map znear times "
            f"statistic/extent in MJCF); look at them with {look}",
            file=sys.stderr,
        )
    blind = _blind(dataset, sees)
    for name, share in blind.items():
        print(
            f"warning: camera {name} sees nothing but the background in {share:.0%} of the frames, while others see "
            f"more: it looks elsewhere, or something stands before it; look at it with {look}",
            file=sys.stderr,
        )
    return {"blind_cameras": blind} if blind else {}


def _sees(dataset: MultiViewDataset) -> Bool[ndarray, "F V"]:
    """Tell, of some frames, which cameras see more than the background."""
    frames = np.unique(np.linspace(0, len(dataset) - 1, _FRAMES).round().astype(int)).tolist()
    return np.stack([(dataset.read_labels([frame])[0] != 0).mean((-2, -1)) >= _LITTLE for frame in frames])


def _blind(dataset: MultiViewDataset, sees: Bool[ndarray, "F V"]) -> dict[str, float]:
    shares = (~sees & sees.any(1, keepdims=True)).mean(0).tolist()
    return {name: share for name, share in zip(dataset.camera_names, shares, strict=True) if share >= _OFTEN}
