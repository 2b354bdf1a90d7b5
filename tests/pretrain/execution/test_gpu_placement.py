"""All that pretraining computes, on a GPU that need not be there: fake tensors raise where devices mix."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.pretrain.config import EncoderConfig, FieldConfig, LossConfig, SamplingConfig
from nerf_rl.pretrain.data.batches import RayBatch
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import FieldBounds, RadianceField
from nerf_rl.pretrain.model.ray_rendering import SampleNoise, render_depth_guided, render_without_depth
from nerf_rl.pretrain.objectives.losses import SEGMENTATION, losses, segmentation_loss, weighted_sum

SCENES, RAYS, VIEWS, SIZE, CLASSES = 2, 5, 2, 16, 3
SAMPLING = SamplingConfig(rendering_stratified=6, rendering_importance=4)
CUDA = torch.device("cuda", 0)
WAITING = ("_local_scalar_dense", "_linalg_check_errors", "nonzero")
"""operations that read what a GPU has computed"""


@pytest.fixture
def gpu() -> Iterator[None]:
    """Make what is created in a test a fake tensor on a GPU, and refuse tensors that are not."""
    with FakeTensorMode(allow_non_fake_inputs=False), CUDA:
        yield


class NothingIsFetched(TorchDispatchMode):
    """Refuses what makes a GPU and the processor wait for each other, which a CUDA graph cannot hold."""

    def __torch_dispatch__(self, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        done = operation(*args, **(kwargs or {}))
        found = {leaf.device for leaf in tree_leaves((args, kwargs, done)) if isinstance(leaf, torch.Tensor)}
        assert found <= {CUDA} and str(operation).split(".")[1] not in WAITING, f"{operation} of tensors on {found}"
        return done


def make_encoder() -> Encoder:
    pose = np.stack([look_at(np.zeros(3), 1.0, azimuth, -30.0) for azimuth in (20.0, 160.0)])
    intrinsics = np.stack([intrinsics_from_fovy(45.0, SIZE, SIZE)] * VIEWS)
    rig = EncoderRig(("left", "right"), intrinsics, pose, SIZE, SIZE)
    return Encoder(EncoderConfig(latent=8, channels=[8, 16], hidden=16), rig, landmarks=1)


def make_field(free_frames: int = 2, anchors: int = 1) -> RadianceField:
    config = FieldConfig(width=16, layers=3, free_frames=free_frames, plane_size=8, plane_features=2)
    return RadianceField(config, FieldBounds(0.2, 2.0, (0.0, 0.0, 0.0), 0.5), 8, CLASSES, 4, anchors)


def make_batch() -> RayBatch:
    return RayBatch(
        torch.zeros(SCENES, VIEWS, SIZE, SIZE, 3, dtype=torch.uint8),
        torch.rand(SCENES, VIEWS, 3, 4),
        torch.rand(SCENES, RAYS, 3),
        torch.rand(SCENES, RAYS, 3),
        torch.rand(SCENES, RAYS, 3),
        torch.zeros(SCENES, RAYS, dtype=torch.int64),
        torch.rand(SCENES, RAYS),
        torch.rand(SCENES, RAYS, 4),
        torch.rand(SCENES, 1, 3),
        torch.ones(SCENES, 1, dtype=torch.bool),
        torch.rand(SCENES, VIEWS, 2, SIZE // 4, SIZE // 4),
    )


@pytest.mark.usefixtures("gpu")
def test_a_training_step_stays_on_the_gpu():
    encoder, field, batch = make_encoder(), make_field(), make_batch()
    parameters = [*encoder.parameters(), *field.parameters()]
    optimiser = torch.optim.Adam(parameters, fused=True)
    field.set_coarse_to_fine(0.5)
    shape = (SCENES, RAYS)
    noise = SampleNoise(torch.rand(*shape, 4), torch.rand(*shape, 3), torch.randn(*shape, 3))
    with NothingIsFetched():
        latent, landmarks = encoder.read(batch.images, batch.projections)
        assert landmarks is not None
        rendered = render_depth_guided(field, latent, batch.origins, batch.directions, batch.depth, SAMPLING, noise)
        named = losses(rendered, batch, field.origins(latent)[:, :1], torch.rand(1))
        named[SEGMENTATION] = segmentation_loss(landmarks.logits, batch.shares)
        values = [*named.values(), weighted_sum(named, LossConfig()), rendered.depth, *rendered.values.values()]
    assert {value.device for value in values} == {CUDA}
    for parameter in parameters:  # going backwards takes a real GPU
        parameter.grad = torch.zeros_like(parameter)
    torch.nn.utils.clip_grad_norm_(parameters, 1.0)
    optimiser.step()
    assert {parameter.device for parameter in parameters} == {CUDA}


@pytest.mark.usefixtures("gpu")
def test_rays_without_depth_and_latents_stay_on_the_gpu():
    encoder, field, batch = make_encoder().requires_grad_(False), make_field(), make_batch()
    latent = encoder.standardise(encoder(batch.images, batch.projections))
    rendered = render_without_depth(field, latent, batch.origins, batch.directions, SAMPLING)
    values = [*rendered.values.values(), rendered.depth, rendered.weights]
    assert {value.device for value in values} == {CUDA}


@pytest.mark.parametrize("frames", [0, 2])
@pytest.mark.usefixtures("gpu")
def test_a_folded_field_stays_on_the_gpu(frames: int):
    field = make_field(frames, 0)
    field.place_anchors(torch.rand(0, 3), torch.rand(0), torch.rand(0))
    folded = ConditionedField(field, torch.rand(8))
    density, features = folded(torch.rand(7, 3))
    assert density.device == features.device == CUDA


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(lambda x: x[:, [0, 1]], id="indices of the processor"),
        pytest.param(lambda x: x / x.new_tensor([1.0, 2.0, 3.0]), id="numbers of the processor"),
        pytest.param(lambda x: torch.linalg.solve(x, x), id="a check for errors"),
        pytest.param(lambda x: x * float(x.sum()), id="a number that is read"),
    ],
)
@pytest.mark.usefixtures("gpu")
def test_what_a_graph_cannot_hold_is_found(wrong: Callable[[torch.Tensor], torch.Tensor]):
    with pytest.raises((AssertionError, RuntimeError)), NothingIsFetched():
        wrong(torch.rand(3, 3))


@pytest.mark.usefixtures("gpu")
def test_devices_that_mix_are_found():
    field = make_field()
    with pytest.raises(RuntimeError, match=r"two different devices|on the same device"):
        field(torch.rand(1, 4, 3, device="cpu"), torch.rand(1, 8))
