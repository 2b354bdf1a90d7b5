"""An encoder that is trained on the true state: how well a latent of that size can know it from these frames."""

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.schedules import warm_cosine
from nerf_rl.progress import Progress

_FRAMES_PER_STEP = 64
_LEARNING_RATE = 7e-4
_LONGEST_GRADIENT = 1.0


def train_supervised(like: Encoder, dataset: MultiViewDataset, columns: list[int], steps: int, seed: int) -> Encoder:
    """Train a new encoder, on the processor, to have some columns of the true state as linear functions of z.

    The loss is the squared error of the columns in units of their deviations, on the dataset's training frames.

    Args:
        like: an encoder of the same architecture and cameras.
        dataset: with these cameras.
        columns: of the privileged state, each of which varies.
        steps: of 64 frames.
        seed: of its weights and of the order of frames.
    """
    frames, views = dataset.split("train"), dataset.views("encoder")
    state = torch.from_numpy(dataset.tracked_positions(frames)[:, columns]).float()
    target = (state - state.mean(0)) / state.std(0)
    rng = np.random.default_rng(seed)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        encoder, head = like.anew(), nn.Linear(like.latent_size, len(columns))
    parameters = [*encoder.parameters(), *head.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=_LEARNING_RATE, betas=(0.9, 0.99), fused=True)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: warm_cosine(step / steps))
    with Progress(steps, "steps of the supervised encoder") as progress:
        for _ in range(steps):
            chosen = rng.integers(len(frames), size=_FRAMES_PER_STEP)
            images = torch.from_numpy(dataset.read("rgb", frames[chosen])[:, views])
            loss = F.mse_loss(head(encoder.encode(images)), target[chosen])
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, _LONGEST_GRADIENT)
            optimiser.step()
            schedule.step()
            progress.advance()
    return encoder.eval().requires_grad_(False)
