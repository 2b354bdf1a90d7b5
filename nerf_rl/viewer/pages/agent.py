"""A trained agent to look at: its learning curves, and episodes acted on demand."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from nerf_rl.pictures.images import surface_limits
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import described_classes, read_description
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.ray_rendering import RenderedImages
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.config import NO_CONTROL, RANDOM
from nerf_rl.rl.rollout import Rollout, rollout
from nerf_rl.rl.training.episodes import evaluation_seeds
from nerf_rl.rl.training.evaluation_results import read_evaluations
from nerf_rl.viewer.pages.action_values import ActionValues


@dataclass(frozen=True)
class ActedEpisode:
    """An episode and what the critic says of it."""

    seed: int
    rollout: Rollout
    values: Float[ndarray, "steps"] | None
    """Q of each action, in scaled rewards; None without a critic"""

    def __len__(self) -> int:
        return len(self.rollout.view)

    def lines(self) -> dict[str, ndarray]:
        """Return numbers at each action, by name."""
        r = self.rollout
        named: dict[str, ndarray] = {"reward": r.rewards}
        if self.values is not None:
            named["Q"] = self.values
        return named | {f"action {i}": r.actions[:, i] for i in range(r.actions.shape[1])}


class Agent:
    """A run of train-rl.

    Args:
        run: its folder.
        encoder: where its encoder is now, if it has moved.
        seed: of its episodes.
        episodes: how many there are to choose from.
        device: of encoder and field; the policy is too small to gain from a GPU.
    """

    def __init__(self, run: Path, encoder: str, seed: int, episodes: int, device: torch.device | str = "cpu"):
        self.run, self._device = run, torch.device(device)
        self.policy = Policy.load(run, encoder)
        self.values = ActionValues.load(run, self.policy)
        self.seeds = evaluation_seeds(seed, episodes)
        self.encoder: Encoder | None = None
        self.field: RadianceField | None = None  # nor for the latents of an encoder that nobody trained
        self.palette: UInt8[ndarray, "C 3"] = np.zeros((1, 3), np.uint8)
        self.class_names: list[str] = []
        if self.policy.spec.encoder is not None:
            self.encoder = Encoder.load(self.policy.spec.encoder)
            folder, _ = read_description(self.policy.spec.encoder)
            if (folder / "field.json").is_file() and self.policy.spec.control != RANDOM:
                self.field = RadianceField.load(folder).requires_grad_(False).to(device)
                self.class_names, palette = described_classes(folder)
                self.palette = np.array(palette, np.uint8)
        self._depth_range: tuple[float, float] | None = None
        self._acted: dict[int, ActedEpisode] = {}

    @property
    def title(self) -> str:
        """What pages call it: its scene, and the kind of control if it is one."""
        spec = self.policy.spec
        return f"{spec.scene}: agent" + ("" if spec.control == NO_CONTROL else f" (control: {spec.control})")

    def act(self, number: int) -> ActedEpisode:
        """Return an episode by its number; it is acted when it is first asked for."""
        if number not in self._acted:
            seed = self.seeds[number]
            episode = rollout(self.run, seed, policy=self.policy, device=str(self._device))
            values = None if self.values is None else self.values(episode.observations, episode.actions)
            self._acted[number] = ActedEpisode(seed, episode, values)
        return self._acted[number]

    def folded(self, episode: ActedEpisode, step: int) -> ConditionedField | None:
        """Return the field of what the agent saw at a step, if its encoder has one."""
        if self.field is None or episode.rollout.latents is None:
            return None
        return ConditionedField(self.field, torch.from_numpy(episode.rollout.latents[step]).to(self._device))

    def depth_range(self, decoded: Sequence[RenderedImages]) -> tuple[float, float]:
        """Return limits [m] for the colours of decoded depth.

        Args:
            decoded: from the encoder's cameras; the first ones decide, so that colours mean the same in all pictures.
        """
        if self._depth_range is None:
            assert self.field is not None
            self._depth_range = surface_limits(np.stack([view.depth for view in decoded]), self.field.bounds.far)
        return self._depth_range

    def evaluations(self) -> list[dict[str, Any]]:
        """Return the evaluations of training; none if it has not ended."""
        return read_evaluations(self.run)

    def metrics(self) -> dict[str, ndarray]:
        """Return the columns of ``metrics.csv``; gaps are NaN."""
        path = self.run / "metrics.csv"
        if not path.is_file():
            return {}
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        names = rows[0] if rows else ()
        return {name: np.array([float(row[name] or "nan") for row in rows]) for name in names}
