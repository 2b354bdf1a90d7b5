"""What probing an encoder reports: figures of the held-out frames, of both probes, beside an untrained encoder."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.pretrain.measures.linear_probe import encode_frames, linear_probe
from nerf_rl.pretrain.measures.probing import EncoderFigures, ProbeResult, probe_encoder
from nerf_rl.pretrain.model.encoder import Encoder


def test_figures_are_those_of_the_held_out_frames_in_columns_that_vary(tiny_dataset: Path, tiny_encoder: Path):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    result = probe_encoder(encoder, dataset, 9, seed=0)
    train, held_out = dataset.split("train"), dataset.split("validation")
    assert len(train) == 9
    state = dataset.read("state/privileged").astype(float)
    varying = [i for i in range(9) if min(state[train, i].std(), state[held_out, i].std()) > 1e-4]
    names = [dataset.columns("privileged")[i] for i in varying]
    assert list(result.encoder.columns) == list(result.random_encoder.columns) == names
    assert {"hand_x", "hand_y", "hand_z"} <= set(names) and "goal_z" not in names
    latents = [encode_frames(encoder, dataset, part) for part in (train, held_out)]
    linear = linear_probe(latents[0], state[train], latents[1])
    for name, column in zip(names, varying, strict=True):
        figures, truth = result.encoder.columns[name], state[held_out, column]
        error = linear[:, column] - truth
        assert figures["rmse_mm"] == pytest.approx(1000 * np.sqrt((error**2).mean()), rel=1e-3)
        assert figures["median_mm"] == pytest.approx(1000 * np.median(np.abs(error)), rel=1e-2)
        assert figures["r2"] == pytest.approx(1 - (error**2).mean() / truth.var(), abs=1e-3)
        assert figures["network_rmse_mm"] > 0 and figures["network_r2"] <= 1
    assert result.encoder != result.random_encoder


def test_joints_are_probed_as_angles_and_the_columns_do_not_depend_on_it(tiny_dataset: Path, tiny_encoder: Path):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    result = probe_encoder(encoder, dataset, 9, seed=0)
    train, held_out = dataset.split("train"), dataset.split("validation")
    latents = [encode_frames(encoder, dataset, part) for part in (train, held_out)]
    angle = dataset.read("state/qpos")[:, 0]
    cosine, sine = linear_probe(latents[0], np.stack([np.cos(angle), np.sin(angle)], 1)[train], latents[1]).T
    error = (np.arctan2(sine, cosine) - angle[held_out] + np.pi) % (2 * np.pi) - np.pi
    figures = result.encoder.joints["right_j0"]
    assert figures["rmse_deg"] == pytest.approx(np.degrees(np.sqrt((error**2).mean())), rel=1e-3)
    assert figures["median_deg"] == pytest.approx(np.degrees(np.median(np.abs(error))), rel=1e-2)
    assert set(result.encoder.joints) == set(result.random_encoder.joints)
    del dataset.manifest["joints"]
    older = probe_encoder(encoder, dataset, 9, seed=0)
    assert older.encoder.joints == {} and set(older.summary()) == {"probe", "probe_random_encoder"}
    for name, figures in older.encoder.columns.items():
        assert figures["rmse_mm"] == result.encoder.columns[name]["rmse_mm"]


def test_the_table_shows_both_probes_of_every_encoder():
    def figures(error: float) -> EncoderFigures:
        column = {"rmse_mm": error, "median_mm": error / 4, "r2": 0.5, "network_rmse_mm": error / 2}
        joint = {"rmse_deg": 3 * error, "median_deg": error, "r2": 0.25, "network_median_deg": error / 2}
        return EncoderFigures({"hand_x": column}, {"lid": joint})

    head, hand, lid = ProbeResult(figures(2.0), figures(20.0), figures(1.0)).table().splitlines()
    assert " ".join(head.split()) == "linear probe, network probe RMSE median R2 untrained encoder supervised encoder"
    assert " ".join(hand.split()) == "hand_x 2.0 mm, 1.0 mm 0.5 mm, unknown 0.500 20.0 mm, 10.0 mm 1.0 mm, 0.5 mm"
    assert " ".join(lid.split()) == "lid 6.0°, unknown 2.0°, 1.0° 0.250 60.0°, unknown 3.0°, unknown"


def test_the_random_encoder_is_decided_by_the_seed_and_leaves_the_random_state_alone(
    tiny_dataset: Path, tiny_encoder: Path
):
    dataset, encoder = MultiViewDataset(tiny_dataset), Encoder.load(tiny_encoder)
    torch.manual_seed(1)
    before = torch.get_rng_state()
    first = probe_encoder(encoder, dataset, 9, seed=0).random_encoder
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(2)
    assert probe_encoder(encoder, dataset, 9, seed=0).random_encoder == first
    assert probe_encoder(encoder, dataset, 9, seed=1).random_encoder != first


def test_a_dataset_without_held_out_frames_is_refused(
    tiny_dataset: Path, tiny_encoder: Path, monkeypatch: pytest.MonkeyPatch
):
    dataset = MultiViewDataset(tiny_dataset)
    monkeypatch.setattr(dataset, "split", lambda name: np.arange(12 if name == "train" else 1))
    with pytest.raises(UserError, match="needs at least two training and two validation frames to probe on"):
        probe_encoder(Encoder.load(tiny_encoder), dataset, 9, seed=0)
