"""Replayed steps: the losses and gradients of each step's own inputs, on a GPU and by what stands in for one."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.config import PretrainConfig
from nerf_rl.pretrain.data.data_module import MultiViewDataModule
from nerf_rl.pretrain.execution import step_graph
from nerf_rl.pretrain.execution.step_graph import StepGraph
from nerf_rl.pretrain.fitting import make_module
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU"))]


class Recomputed:
    """What a CUDA graph does, on the processor: it computes the same again, from and into the same memory."""

    again: Callable[[], None]

    def replay(self) -> None:
        self.again()


class Stream:
    def wait_stream(self, _: object) -> None:
        pass


@pytest.fixture
def recomputing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let graphs be captured on a machine without a GPU."""
    captured: list[tuple[Any, Any]] = []
    whole = StepGraph._compute

    def compute(self: StepGraph, losses: Any) -> Any:
        captured.append((lambda: whole(self, losses), whole(self, losses)))
        return captured[-1][1]

    @contextmanager
    def graph(recomputed: Recomputed, capture_error_mode: str) -> Iterator[None]:
        assert capture_error_mode == "thread_local"
        yield
        compute_again, (named, total, gradients) = captured[-1]

        def again() -> None:
            new_named, new_total, new_gradients = compute_again()
            for old, new in zip(
                [*named.values(), total, *gradients], [*new_named.values(), new_total, *new_gradients], strict=True
            ):
                old.copy_(new)

        recomputed.again = again

    monkeypatch.setattr(StepGraph, "_compute", compute)
    for name, fake in (("CUDAGraph", Recomputed), ("Stream", Stream), ("graph", graph)):
        monkeypatch.setattr(step_graph.torch.cuda, name, fake)
    monkeypatch.setattr(step_graph.torch.cuda, "current_stream", Stream)
    monkeypatch.setattr(step_graph.torch.cuda, "stream", lambda _: nullcontext())


@pytest.mark.parametrize("device", DEVICES)
def test_a_replayed_step_has_the_losses_and_gradients_of_its_own_inputs(device: str, request: pytest.FixtureRequest):
    if device == "cpu":
        request.getfixturevalue("recomputing")
    layer, unused = nn.Linear(3, 2, device=device), nn.Parameter(torch.ones(2, device=device))
    trained = [*layer.parameters(), unused]

    def losses(inputs: Sequence[Tensor]) -> tuple[dict[str, Tensor], Tensor]:
        error = layer(inputs[0]) - inputs[1]
        named = {"square": error.square().mean(), "size": error.abs().mean()}
        return named, 2.0 * named["square"] + 0.5 * named["size"]

    steps = [[torch.randn(4, 3, device=device), torch.randn(4, 2, device=device)] for _ in range(3)]
    graph = StepGraph(losses, trained, steps[0])
    for inputs in steps:
        named, total = graph(inputs)
        (3.0 * total).backward()
        found = [value.clone() for value in (*named.values(), total.detach())]
        gradients = [parameter.grad.clone() for parameter in trained if parameter.grad is not None]
        expected, expected_total = losses(inputs)
        wanted = torch.autograd.grad(3.0 * expected_total, list(layer.parameters()))
        torch.testing.assert_close(found, [value.detach() for value in (*expected.values(), expected_total)])
        torch.testing.assert_close(gradients, [*wanted, torch.zeros_like(unused)])
        for parameter in trained:
            parameter.grad = None
        with torch.no_grad():  # an optimiser moves weights where they are
            layer.weight -= 0.1 * wanted[0]


def module_of(dataset: Path, **settings: Any) -> tuple[SnerlModule, MultiViewDataModule]:
    config = PretrainConfig(str(dataset), "out", scenes_per_step=4, rays_per_scene=8, **settings)
    recorded = MultiViewDataset(dataset)
    data = MultiViewDataModule(recorded, config)
    module = make_module(config, recorded, data)
    assert isinstance(module, SnerlModule)
    return module, data


@pytest.mark.filterwarnings("ignore:You are trying to `self.log")
@pytest.mark.parametrize("device", DEVICES)
def test_training_by_replays_is_training(device: str, tiny_dataset: Path, request: pytest.FixtureRequest):
    if device == "cpu":
        request.getfixturevalue("recomputing")
    losses: dict[bool, list[float]] = {}
    for replays in (True, False):
        torch.manual_seed(0)
        module, data = module_of(tiny_dataset, step_graph=replays)
        module.to(device)
        if device == "cpu" and replays:
            module._replays = True  # type: ignore[misc]
        optimiser = module.configure_optimizers()["optimizer"]
        losses[replays] = []
        for _, batch in zip(range(3), data.train_dataloader(), strict=False):
            loss = module.training_step(type(batch)(*(part.to(device) for part in batch)), 0)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses[replays].append(float(loss.detach()))
        assert (module._graph is not None) == replays
    assert losses[True] == pytest.approx(losses[False], rel=1e-4 if device == "cuda" else 1e-6)
    assert len(set(losses[True])) == 3


@pytest.mark.parametrize(
    ("device", "settings", "replays"),
    [
        ("cuda:0", {}, True),
        ("cuda:0", {"step_graph": False}, False),
        ("cuda:0", {"devices": 2}, False),
        ("cuda:0", {"strategy": "ddp"}, False),
        ("cuda:0", {"precision": "bf16"}, False),
        ("cuda:0", {"precision": "32"}, True),
        ("cpu", {}, False),
    ],
)
def test_steps_are_replayed_on_one_gpu_unless_otherwise_asked(
    device: str, settings: dict[str, Any], replays: bool, tiny_dataset: Path
):
    module, _ = module_of(tiny_dataset, **settings)
    module._device = torch.device(device)
    assert module._replays is replays
