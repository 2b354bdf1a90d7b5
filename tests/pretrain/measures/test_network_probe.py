"""Network probes: what they read that a linear map cannot, and that they are hardly worse where it can."""

import numpy as np
import torch

from nerf_rl.pretrain.measures.linear_probe import linear_probe
from nerf_rl.pretrain.measures.network_probe import network_probe

EPISODES = np.repeat(np.arange(200), 5)


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return latents of very different scales."""
    rng = np.random.default_rng(seed)
    scales = np.logspace(-2, 2, 6)
    return rng.normal(size=(1000, 6)) * scales + 3.0, rng.normal(size=(400, 6)) * scales + 3.0


def mean_squared(latents: np.ndarray, targets: np.ndarray, queries: np.ndarray, truth: np.ndarray) -> tuple:
    """Return the errors of both probes for each target."""
    readings = linear_probe(latents, targets, queries), network_probe(latents, targets, queries, EPISODES, seed=0)
    return tuple(((read - truth) ** 2).mean(0) for read in readings)


def test_it_reads_what_is_no_linear_function_of_a_latent():
    latents, queries = drawn(0)

    def bent(values: np.ndarray) -> np.ndarray:
        a, b, *_ = ((values - 3.0) / np.logspace(-2, 2, 6)).T
        return np.stack([0.001 * (a * b), 50.0 + 20.0 * np.sin(2 * a)], axis=1)

    linear, network = mean_squared(latents, bent(latents), queries, bent(queries))
    assert (network < 0.25 * linear).all()


def test_it_is_as_good_as_a_linear_probe_where_there_is_nothing_more_to_read():
    latents, queries = drawn(1)
    rng = np.random.default_rng(2)
    weights = rng.normal(size=(6, 3)) / np.logspace(-2, 2, 6)[:, None]
    targets, truth = latents @ weights, queries @ weights
    targets = targets + rng.normal(size=targets.shape)  # as much as cannot be read
    truth = truth + rng.normal(size=truth.shape)
    linear, network = mean_squared(latents, targets, queries, truth)
    assert (network < 1.05 * linear).all()


def test_a_seed_decides_it_and_the_random_state_is_left_alone():
    latents, queries = drawn(3)
    targets = (latents**2)[:, :2]
    torch.manual_seed(1)
    before = torch.get_rng_state()
    first = network_probe(latents, targets, queries, EPISODES, seed=4)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(2)
    np.testing.assert_array_equal(network_probe(latents, targets, queries, EPISODES, seed=4), first)
    assert not np.array_equal(network_probe(latents, targets, queries, EPISODES, seed=5), first)


def test_two_frames_are_enough_and_what_never_varied_is_harmless():
    latents = np.array([[0.0, 1.0], [1.0, 1.0]])
    for episodes in (np.array([0, 0]), np.array([0, 1])):
        read = network_probe(latents, np.array([[0.0], [2.0]]), np.array([[0.5, 1.0]]), episodes, seed=0)
        assert read.shape == (1, 1) and np.isfinite(read).all()
