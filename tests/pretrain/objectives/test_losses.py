"""Losses against their formulas in NumPy."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nerf_rl.pretrain.config import LossConfig
from nerf_rl.pretrain.data.batches import RayBatch
from nerf_rl.pretrain.model.ray_rendering import RenderedRays
from nerf_rl.pretrain.objectives.losses import losses, weighted_sum

B, R, S, C, F, A = 2, 3, 4, 5, 4, 2


def random_case(feature: bool = True) -> tuple[RenderedRays, RayBatch, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)

    def random(*shape: int) -> torch.Tensor:
        return torch.rand(shape, generator=generator)

    weights = random(B, R, S)
    values = {"rgb": random(B, R, 3), "semantic": 3 * random(B, R, C)} | (
        {"feature": random(B, R, F)} if feature else {}
    )
    depths, weights = random(B, R, S).sort(-1).values, weights / weights.sum(-1, keepdim=True)
    rendered = RenderedRays(values, depths, weights, torch.ones(B, R))
    batch = RayBatch(
        torch.zeros((B, 1, 2, 2, 3), dtype=torch.uint8),
        random(B, 1, 3, 4),
        random(B, R, 3),
        random(B, R, 3),
        random(B, R, 3),
        torch.randint(C, (B, R), generator=generator),
        random(B, R),
        random(B, R, F),
        random(B, A, 3),
        torch.tensor([[True, False], [True, True]]),
        torch.zeros((B, 1, A + 1, 1, 1)),
    )
    return rendered, batch, random(B, A, 3), torch.tensor([0.5, 0.02])


def test_each_loss_is_its_formula():
    rendered, batch, origins, spread = random_case()
    named = {name: float(value) for name, value in losses(rendered, batch, origins, spread).items()}
    rgb, logits, feature = (rendered.values[name].numpy() for name in ("rgb", "semantic", "feature"))
    assert named["rgb"] == pytest.approx(((rgb - batch.rgb.numpy()) ** 2).mean(), rel=1e-5)
    assert named["feature"] == pytest.approx(((feature - batch.feature.numpy()) ** 2).mean(), rel=1e-5)
    entropy, distance = [], []
    for b, r in np.ndindex(B, R):
        probability = np.exp(logits[b, r]) / np.exp(logits[b, r]).sum()
        entropy.append(-np.log(probability[batch.semantic[b, r]]))
        distance.append(
            sum(float(rendered.weights[b, r, s] * abs(rendered.depths[b, r, s] - batch.depth[b, r])) for s in range(S))
        )
    assert named["semantic"] == pytest.approx(np.mean(entropy), rel=1e-5)
    assert named["depth"] == pytest.approx(np.mean(distance), rel=1e-5)
    away = []
    for b, a in np.ndindex(*batch.seen.shape):
        error = np.abs((origins[b, a] - batch.middles[b, a]).numpy() / float(spread[a]))
        each = np.where(error < 0.1, 5.0 * error**2, error - 0.05).sum()
        away.append(each if batch.seen[b, a] else 0.0)
    assert 0 < batch.seen.sum() < batch.seen.numel()
    assert named["anchor"] == pytest.approx(np.mean(away), rel=1e-5)


def test_without_teachers_there_is_no_feature_loss():
    assert set(losses(*random_case(feature=False))) == {"rgb", "semantic", "depth", "anchor"}


def test_where_no_class_moves_there_is_no_anchor_loss():
    rendered, batch, origins, spread = random_case()
    assert set(losses(rendered, batch, origins[:, :0], spread[:0])) == {"rgb", "semantic", "depth", "feature"}


def test_where_everything_is_hidden_the_anchor_loss_is_nothing():
    rendered, batch, origins, spread = random_case()
    hidden = batch._replace(seen=torch.zeros_like(batch.seen))
    assert float(losses(rendered, hidden, origins, spread)["anchor"]) == 0.0


def test_the_depth_loss_bounds_the_error_of_the_expected_depth():
    rendered, batch, origins, spread = random_case()
    error = ((rendered.weights * rendered.depths).sum(-1) - batch.depth).abs().mean()
    assert float(losses(rendered, batch, origins, spread)["depth"]) >= float(error)


def test_a_perfect_rendering_costs_nothing():
    rendered, batch, _, spread = random_case()
    logits = 100.0 * torch.nn.functional.one_hot(batch.semantic, C).float()
    values = {"rgb": batch.rgb, "semantic": logits, "feature": batch.feature}
    depths, weights = rendered.depths.clone(), torch.zeros(B, R, S)
    depths[..., 1], weights[..., 1] = batch.depth, 1.0
    for name, value in losses(
        replace(rendered, values=values, depths=depths, weights=weights), batch, batch.middles, spread
    ).items():
        assert float(value) == pytest.approx(0.0, abs=1e-6), name


def test_the_total_is_the_weighted_sum_of_the_names():
    named = {
        name: torch.tensor(value) for name, value in {"rgb": 2.0, "semantic": 3.0, "feature": 5.0, "depth": 7.0}.items()
    }
    weights = LossConfig(rgb=1.0, semantic=0.1, feature=0.01, depth=0.001)
    assert float(weighted_sum(named, weights)) == pytest.approx(2.357)
    del named["feature"]
    assert float(weighted_sum(named, weights)) == pytest.approx(2.307)
