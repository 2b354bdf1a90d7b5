"""A training step whose scenes are shared out among threads is the step of one thread."""

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from nerf_rl import cli
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.batches import RayBatches
from nerf_rl.pretrain.data.data_module import MultiViewDataModule
from nerf_rl.pretrain.execution.side_by_side import Shares, equal_shares
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule


@pytest.fixture
def own_threads():
    """Restore PyTorch's number of threads."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize(
    "scenes, most, lengths", [(32, 2, [16] * 2), (32, 3, [16] * 2), (6, 4, [2] * 3), (7, 4, [7]), (3, 8, [1] * 3)]
)
def test_shares_are_equal_and_cover_everything(scenes: int, most: int, lengths: list[int]):
    shares = equal_shares(scenes, most)
    assert [len(range(scenes)[share]) for share in shares] == lengths
    assert [i for share in shares for i in range(scenes)[share]] == list(range(scenes))


@pytest.mark.parametrize("precision", [None, torch.bfloat16])
@pytest.mark.parametrize("threads", [2, 4])
def test_losses_and_gradients_are_those_of_one_thread(
    tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch, precision: torch.dtype | None, threads: int
):
    dataset = MultiViewDataset(tiny_dataset)
    config = PretrainConfig("data", "out", scenes_per_step=8, rays_per_scene=8)
    data = MultiViewDataModule(dataset, config)
    torch.manual_seed(0)
    module = SnerlModule(config, dataset, data.statistics, data.rig)
    module._shares = Shares(threads)
    logged: list[dict[str, Any]] = []
    monkeypatch.setattr(module, "log_dict", logged.append)
    batch = RayBatches(dataset, config, data.statistics)[0]
    found = []
    for count in (1, threads, threads):
        module.threads = count
        module.zero_grad()
        with torch.autocast("cpu", dtype=precision or torch.bfloat16, enabled=precision is not None):
            loss = module.training_step(batch, 0)
        (2.0 * loss).backward()
        found.append((loss.detach(), {name: value.grad for name, value in module.named_parameters()}))
    (one, gradients), (shared, theirs), (again, same) = found
    tolerance = 1e-4 if precision is None else 0.05
    torch.testing.assert_close(shared, one, rtol=tolerance, atol=0.0)
    assert logged[0].keys() == logged[1].keys()
    for name, gradient in gradients.items():
        assert gradient is not None, name
        error = (theirs[name] - gradient).norm() / gradient.norm().clamp_min(1e-12)
        assert error < tolerance, (name, float(error))
    assert torch.equal(shared, again)  # whichever thread is faster
    assert all(torch.equal(theirs[name], same[name]) for name in gradients)


def test_a_run_with_threads_ends_like_one_without(
    tiny_dataset: Path, tiny_pretraining_recipe: Path, tiny_encoder: Path, tmp_path: Path, own_threads: None
):
    words = ["--config", str(tiny_pretraining_recipe), "--data", str(tiny_dataset), "--out", str(tmp_path / "run")]
    assert cli.main(["pretrain", *words, "--threads", "2"]) == 0
    assert torch.get_num_threads() == 2  # what is left to do has both
    one, two = (json.loads((run / "summary.json").read_text()) for run in (tiny_encoder, tmp_path / "run"))
    for name, value in one["validation"].items():
        assert two["validation"][name] == pytest.approx(value, rel=1e-2), name
    for name, figures in one["probe"].items():
        assert two["probe"][name]["rmse_mm"] == pytest.approx(figures["rmse_mm"], rel=0.02), name


def test_a_failure_in_a_thread_is_the_steps_failure():
    def fails(share: slice) -> Any:
        raise RuntimeError(f"no memory for {share.start}")

    with pytest.raises(RuntimeError, match="no memory for 0"):
        Shares(2).mean_losses(fails, equal_shares(4, 2), [torch.zeros(1, requires_grad=True)])
