"""What an agent with an untrained encoder needs, to stand beside one whose encoder was trained."""

from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from nerf_rl.rl.environments.observation import LatentObservation

_EPISODES, _STEPS = 16, 6  # that are looked at


def standardise_by_looking(env: "LatentObservation") -> None:
    """Set the encoder's latent mean and deviation by random acting in a few episodes, the same in every process.

    An untrained encoder's latents hardly vary; without this an agent would be as good as blind for their scale alone.
    """
    rng, latents = np.random.default_rng(0), []
    space = env.env.action_space
    for episode in range(_EPISODES):
        env.env.reset(seed=episode)
        for _ in range(_STEPS):
            latents.append(env.look())
            _, _, terminated, truncated, _ = env.env.step(rng.uniform(-1.0, 1.0, space.shape).astype(np.float32))
            if terminated or truncated:
                break
    seen = torch.cat(latents)
    env.encoder.latent_mean.copy_(seen.mean(0))
    env.encoder.latent_std.copy_(seen.std(0).clamp_min(1e-8))
