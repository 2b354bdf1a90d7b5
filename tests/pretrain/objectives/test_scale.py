"""A scene of another size is learnt as this one is: no length in a recipe is meant for scenes of one size."""

from pathlib import Path

import numpy as np
import pytest
import torch
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.statistics import measure
from nerf_rl.pretrain.model.encoder import Encoding
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.ray_rendering import SampleNoise
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule

SCENES, RAYS = 4, 64


class Resized(MultiViewDataset):
    """A dataset of which everything is so many times as large and as far off."""

    def __init__(self, folder: Path, times: float):
        super().__init__(folder)
        self._times = times
        self.manifest["far"] *= times

    def read(self, name: str, frames: ndarray | list[int] | None = None) -> ndarray:
        values = super().read(name, frames)
        return values * values.dtype.type(self._times) if name == "depth" else values

    def cameras(self, frames: ndarray) -> tuple[ndarray, ndarray]:
        intrinsics, poses = super().cameras(frames)
        return intrinsics, poses * np.array([1.0, 1.0, 1.0, self._times])


def first_losses(dataset: MultiViewDataset) -> dict[str, float]:
    """Return the losses of a first step, from given latents: an encoder reads its cameras' matrices in metres."""
    config = PretrainConfig("data", "out", scenes_per_step=SCENES, rays_per_scene=RAYS)
    statistics = measure(dataset, config)
    torch.manual_seed(0)
    module = SnerlModule(config, dataset, statistics, EncoderRig.of_dataset(dataset))
    latent = torch.randn(SCENES, config.encoder.latent)
    module.encoder.read = lambda images, projections: Encoding(latent, None)  # type: ignore[method-assign]
    noise = SampleNoise.draw(config.sampling, SCENES, RAYS, torch.Generator().manual_seed(0), torch.device("cpu"))
    named, _ = module._losses(RayBatches(dataset, config, statistics)[0], noise)
    return {name: float(value.detach()) for name, value in named.items()}


@pytest.mark.parametrize("times", [0.125, 8.0])
def test_the_losses_of_a_step_do_not_depend_on_how_large_a_scene_is(tiny_dataset: Path, times: float):
    """By powers of two, so that numbers are rounded alike."""
    losses = first_losses(MultiViewDataset(tiny_dataset))
    assert set(losses) == {"rgb", "semantic", "depth", "feature", "anchor"}
    assert first_losses(Resized(tiny_dataset, times)) == pytest.approx(losses, rel=1e-4)
