"""Checks on a GPU that computes nothing: PyTorch's fake tensors know their device without having it.

An operation on tensors of two devices raises. There are no numbers: reading one out gives 0, and the backward pass,
whose engine asks the driver, gives gradients of zero. Run as ``python tests/fake_gpu.py ENCODER DATASET``; each check
that passes prints its name. It is a process of its own, since fake tensors have crashed under the tests' type checks.
"""

import sys
from pathlib import Path

import numpy as np
import torch
from torch._subclasses.fake_tensor import FakeTensor, FakeTensorMode

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.measures.linear_probe import encode_frames
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import read_description
from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.agents.networks import LayeredConfig
from nerf_rl.rl.agents.policy import Policy, make_actor
from nerf_rl.rl.config import LearnerConfig, NetworkConfig
from nerf_rl.rl.environments.make import EnvSpec
from nerf_rl.rl.environments.observation import LatentObservation
from nerf_rl.rl.experience.replay import Batch, Replay
from nerf_rl.scenes.make import make_scene
from nerf_rl.viewer.field.progressive import FreeCamera
from nerf_rl.viewer.pages.action_values import ActionValues

GPU = torch.device("cuda", 0)


class Memory(Replay):
    """What DDPG asks of replay, in the CPU's memory."""

    prioritised = True
    demonstrations = 0

    def __init__(self) -> None:
        self.updated: list[torch.device] = []

    def sample(self, beta: float) -> Batch:
        o = torch.zeros(4, 3)
        return Batch(
            torch.arange(4), torch.ones(4), o, torch.zeros(4, 2), torch.zeros(4), torch.ones(4), o, torch.zeros(4)
        )

    def sample_uniform(self) -> Batch:
        return self.sample(1.0)

    def __len__(self) -> int:
        return 4

    def observations(self, index: np.ndarray) -> np.ndarray:
        return np.zeros((len(index), 3), np.float32)

    def update_priority(self, index: torch.Tensor, error: torch.Tensor) -> None:
        self.updated += [index.device, error.device]


def numpy(tensor: torch.Tensor) -> np.ndarray:
    assert tensor.device.type == "cpu", f"a tensor on {tensor.device} cannot become an array"
    return np.zeros(tuple(tensor.shape), np.float32)


def learner(normalisation: str, actor_batch: str) -> None:
    network = NetworkConfig(hidden=[8, 8], normalisation=normalisation)
    agent = DDPG(3, 2, network, LearnerConfig(actor_batch=actor_batch), GPU)

    def grad(_: torch.Tensor, inputs: torch.Tensor | list[torch.Tensor]) -> list[torch.Tensor]:
        # of both, as in a real run: without, PyTorch's fake batch statistics corrupt the process's memory
        for parameter in (*agent.actor.parameters(), *agent.critic.parameters()):
            parameter.grad = torch.zeros_like(parameter)
        return [torch.zeros_like(one) for one in (inputs if isinstance(inputs, list) else [inputs])]

    torch.autograd.grad = grad
    memory = Memory()
    for _ in range(2):
        agent.update_statistics(np.zeros((2, 3), np.float32))
        assert agent.act(np.zeros((2, 3), np.float32)).shape == (2, 2)
        agent.update(memory, beta=0.5)
        agent.diagnose(memory)
    assert {device.type for device in memory.updated} == {"cpu"}
    kept = {name: tensor.device for name, tensor in agent.state_dict().items()}
    assert agent.device == GPU and {device for name, device in kept.items() if "step" not in name} == {GPU}


def policy(network: NetworkConfig | LayeredConfig) -> None:
    with GPU:
        actor = make_actor(3, 2, network)
    acting = Policy(actor, EnvSpec("metaworld/drawer-open-v3", None, 2, 20), network, 3, 2, [], None, 0)
    assert acting.act(np.zeros((5, 3), np.float32)).shape == (5, 2)


def values() -> None:
    agent = DDPG(3, 2, NetworkConfig(hidden=[8, 8]), LearnerConfig(), GPU)
    called = ActionValues(agent.norm, agent.critic)
    assert called(np.zeros((5, 3), np.float32), np.zeros((5, 2), np.float32)).shape == (5,)


def encoder(folder: Path) -> Encoder:
    _, description = read_description(folder)
    with GPU:
        made = Encoder.described(description)
    return made.eval().requires_grad_(False)


def observation(made: Encoder) -> None:
    scene = make_scene("metaworld/drawer-open-v3")
    env = LatentObservation(scene.env, made, scene.proprio)
    observed, _ = env.reset(seed=0)
    assert observed.shape == env.observation_space.shape and env.last_latent.shape == (made.latent_size,)
    env.close()


def main(folder: Path, dataset: Path) -> None:
    FakeTensor.item = lambda _: 0.0
    FakeTensor.numpy = numpy
    with FakeTensorMode(allow_non_fake_inputs=True):
        for network in (NetworkConfig(hidden=[8, 8]), LayeredConfig([8], "tanh", "clip", 10.0)):
            policy(network)
        print("policy", flush=True)
        values()
        print("values", flush=True)
        assert {tensor.device for tensor in FreeCamera(np.eye(4), 0.8, 1.0).rays(4, 4, GPU)} == {GPU}
        print("rays", flush=True)
        latents = encode_frames(encoder(folder), MultiViewDataset(dataset), np.arange(5))
        assert latents.shape[0] == 5
        print("frames", flush=True)
        observation(encoder(folder))
        print("observation", flush=True)
        for normalisation, actor_batch in (("layer", "uniform"), ("none", "uniform"), ("batch", "prioritised")):
            learner(normalisation, actor_batch)
        print("learner", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
