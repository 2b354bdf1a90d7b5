"""The best episodes so far, kept in view: a share of each batch is drawn from them.

Horvath et al. 2024 ("HiER") draw a part of each batch from a second memory of
episodes with high returns. Here the second memory is a list of rows of the first.
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Int
from torch import Tensor

_LEAST_EPISODES = 10  # before the best of them mean anything


class _Episode(NamedTuple):
    score: float
    rows: Int[Tensor, "N"]


class GoodEpisodes:
    """The rows of the best share of all episodes, by return.

    Args:
        share: of the episodes that is good.
    """

    def __init__(self, share: float):
        self._share = share
        self._closed: list[_Episode] = []
        self._good: Int[Tensor, "N"] = torch.zeros(0, dtype=torch.int64)

    def __len__(self) -> int:
        return len(self._good)

    def add(self, rows: Int[Tensor, "N"], score: float, oldest: int) -> None:
        """Take in an episode that is over.

        Args:
            rows: of the episode, by how many were stored before each.
            score: its return.
            oldest: how many rows were stored before the oldest one that is still in memory.
        """
        if len(rows):
            self._closed.append(_Episode(score, rows))
        self._closed = [episode for episode in self._closed if episode.rows[0] >= oldest]
        self._choose()

    def draw(self, count: int, generator: torch.Generator) -> Int[Tensor, "count"]:
        """Return rows of good episodes, by how many were stored before each; there must be some."""
        return self._good[torch.randint(len(self._good), (count,), generator=generator)]

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs; call it between episodes."""
        rows = [episode.rows for episode in self._closed]
        return {
            "score": torch.tensor([episode.score for episode in self._closed], dtype=torch.float64),
            "length": torch.tensor([len(r) for r in rows], dtype=torch.int64),
            "rows": torch.cat([*rows, torch.zeros(0, dtype=torch.int64)]),
        }

    def load_state_dict(self, state: Mapping[str, Tensor], stored: int) -> None:
        """Put back what :meth:`state_dict` returned.

        Args:
            state: of a checkpoint.
            stored: how many rows have ever been stored.

        Raises:
            ValueError: it cannot be that of this memory.
        """
        if state.keys() != {"score", "length", "rows"}:
            raise ValueError("its good episodes are missing")
        score, length, rows = state["score"], state["length"], state["rows"]
        whole = length.dtype == rows.dtype == torch.int64 and score.dtype == torch.float64
        if not whole or not score.dim() == length.dim() == rows.dim() == 1 or len(score) != len(length):
            raise ValueError("its good episodes have other shapes")
        outside = len(rows) and (rows.min() < 0 or rows.max() >= stored)
        if outside or (len(length) and length.min() < 1) or length.sum() != len(rows) or not score.isfinite().all():
            raise ValueError("its good episodes are out of range")
        parts = rows.split(length.tolist())
        self._closed = [_Episode(float(s), part) for s, part in zip(score, parts, strict=True)]
        self._choose()

    def _choose(self) -> None:
        if len(self._closed) < _LEAST_EPISODES:
            return
        best = sorted(self._closed, key=lambda episode: episode.score, reverse=True)
        self._good = torch.cat([e.rows for e in best[: max(1, round(self._share * len(best)))]])
