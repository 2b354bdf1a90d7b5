"""What the cells of pictures show."""

import numpy as np
import pytest
import torch

from nerf_rl.pretrain.data.anchors import Anchors
from nerf_rl.pretrain.data.segmentation import CellShares
from nerf_rl.pretrain.objectives.losses import segmentation_loss

ANCHORS = Anchors((2, 5), np.zeros((2, 3)), np.ones(2), np.ones(2), np.array([0.09, 0.01]))


def weights_of(shares: CellShares) -> np.ndarray:
    """Return the weight of each class: what a cell full of it has."""
    labels = np.repeat([0, 2, 5], 4).reshape(1, 1, 6, 2).astype(np.uint8)
    return shares.of(labels, None)[0, 0, :, :, 0].max(1)


def test_a_cell_is_shared_by_what_its_pixels_show():
    shares = CellShares(ANCHORS, patch=2)
    labels = np.array([[[[2, 2, 1, 0], [2, 5, 0, 0], [5, 5, 3, 2], [5, 5, 0, 0]]]], np.uint8)
    found = shares.of(labels, None)[0, 0] / weights_of(shares)[:, None, None]
    np.testing.assert_allclose(found[0], [[0, 1], [0, 0.75]], atol=1e-6)
    np.testing.assert_allclose(found[1], [[0.75, 0], [0, 0.25]], atol=1e-6)
    np.testing.assert_allclose(found[2], [[0.25, 0], [1, 0]], atol=1e-6)


def test_rare_classes_weigh_more_and_the_mean_weight_is_one():
    weights = weights_of(CellShares(ANCHORS, patch=2))
    assert weights[2] == pytest.approx(3 * weights[1], rel=1e-5)
    assert (weights * [0.9, 0.09, 0.01]).sum() == pytest.approx(1.0, rel=1e-5)


def test_pixels_that_do_not_count_are_nobodys_and_parts_of_cells_are_left_out():
    shares, valid = CellShares(ANCHORS, patch=2), np.ones((1, 1, 5, 7), bool)
    valid[0, 0, :2, :2] = False
    found = shares.of(np.full((1, 1, 5, 7), 5, np.uint8), valid)
    assert found.shape == (1, 1, 3, 2, 3)
    assert found[0, 0, :, 0, 0].tolist() == [0, 0, 0]
    assert (found[0, 0, 2].ravel()[1:] > 0).all()


def test_the_loss_is_least_where_logits_say_what_cells_show():
    shares = torch.from_numpy(CellShares(ANCHORS, patch=2).of(np.full((2, 3, 4, 4), 5, np.uint8), None))
    right, wrong = torch.zeros(6, 3, 2, 2), torch.zeros(6, 3, 2, 2)
    right[:, 2], wrong[:, 1] = 9.0, 9.0
    losses = [segmentation_loss(logits, shares).item() for logits in (right, torch.zeros_like(right), wrong)]
    assert losses[0] < 0.1 < losses[1] < losses[2]
