"""Replay memory on disk, prioritised (Schaul et al. 2016), on TorchRL's storage and segment trees."""

import logging
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray
from torch import Tensor
from torchrl.data import LazyMemmapStorage, ReplayBuffer
from torchrl.data.replay_buffers.samplers import PrioritizedSampler, RandomSampler

from nerf_rl.errors import BEGIN_ANEW, MissingFileError, UserError
from nerf_rl.files.tensor_files import require_tensors
from nerf_rl.rl.config import ReplayConfig
from nerf_rl.rl.experience.n_step import Transition
from nerf_rl.rl.experience.returns_to_go import returns_to_go, steady_value

_UNKNOWN = torch.finfo(torch.float32).min  # finite, as all numbers of a checkpoint are

logging.getLogger("torchrl").setLevel(logging.WARNING)


class Batch(NamedTuple):
    """Transitions drawn from memory."""

    indices: Int[Tensor, "B"]
    """their rows in memory; those of demonstrations are beyond its capacity"""
    weight: Float[Tensor, "B"]
    """importance weights in (0, 1]"""
    observation: Float[Tensor, "B O"]
    action: Float[Tensor, "B A"]
    reward: Float[Tensor, "B"]
    discount: Float[Tensor, "B"]
    next_observation: Float[Tensor, "B O"]
    bound: Float[Tensor, "B"]
    """what the transition's episode brought from it on, discounted; the least number where nothing is known"""


class Replay:
    """Memory of n-step transitions.

    A transition is one row [observation, action, reward, discount, next observation] of a memory-mapped float32 file,
    so that a batch is gathered in one pass and memory use does not grow with the capacity. Demonstrations, which are
    few and never replaced, are in memory of their own.

    Args:
        config: capacity and prioritisation.
        observation_size, action_size: O and A.
        batch_size: transitions in a batch.
        folder: holds the file until :meth:`close`.
        seed: of the drawing.
        checkpoint_rows: rows that checkpoints hold beside memory, at most; for the room that they need on the disk.
        envs: environments whose episodes are told apart.
        bounded_steps: that a transition spans, if what episodes brought is to be kept; 0 if it is not.
        steady_ends: whether an episode's end is worth no more than to go on as in its last steps.

    Attributes:
        stored: how many rows have ever been stored; those still there are the last ``len(replay)`` of them.

    Raises:
        UserError: the disk has no room for the capacity (the file is sparse, so it would fail much later) and the
            checkpoints.
    """

    def __init__(
        self,
        config: ReplayConfig,
        observation_size: int,
        action_size: int,
        batch_size: int,
        folder: Path,
        seed: int = 0,
        checkpoint_rows: int = 0,
        envs: int = 1,
        bounded_steps: int = 0,
        steady_ends: bool = False,
    ):
        self.prioritised = config.prioritised
        self._batch_size = batch_size
        self._split = [observation_size, action_size, 1, 1, observation_size]
        self._capacity, self.stored = config.capacity, 0
        self._folder = folder
        shutil.rmtree(folder, ignore_errors=True)  # what a killed run left behind
        require_room(folder.parent, observation_size, action_size, config.capacity + checkpoint_rows)
        folder.mkdir(parents=True)
        self._storage = LazyMemmapStorage(config.capacity, scratch_dir=folder)
        self._sampler = (
            PrioritizedSampler(config.capacity, alpha=config.alpha, beta=config.beta, eps=config.epsilon)
            if config.prioritised
            else RandomSampler()
        )
        self.generator = torch.Generator().manual_seed(seed)
        self._buffer = ReplayBuffer(storage=self._storage, sampler=self._sampler, batch_size=batch_size)
        self._buffer.set_rng(self.generator)
        self._rows: Tensor | None = None
        self._running: list[list[Int[Tensor, "N"]]] = [[] for _ in range(envs)]
        self._bounded_steps, self._steady_ends = bounded_steps, steady_ends
        self._bounds = torch.full((config.capacity if bounded_steps else 0,), _UNKNOWN)
        self._demonstrations: Float[Tensor, "D W"] = torch.zeros(0, sum(self._split))
        # at least one is the agent's own, of which demonstrations have the mean weight
        self._demonstration_count = min(round(config.demonstration_share * batch_size), batch_size - 1)

    def __len__(self) -> int:
        return len(self._storage)

    def add(self, transitions: Sequence[Transition], env: int | None = None) -> None:
        """Store transitions with the greatest priority so far, in place of the oldest ones if memory is full.

        Args:
            transitions: of an episode that is running.
            env: in which environment; None for those that are no part of an episode as it happened.
        """
        if transitions:
            before = self.stored
            self._extend(_rows(transitions))
            if env is not None:
                self._running[env].append(torch.arange(before, self.stored))

    def end_episode(self, env: int, value: Callable[[Float[ndarray, "O"]], float] | None = None) -> None:
        """Tell that an environment's episode is over, all its transitions being stored.

        Args:
            env: which of the environments.
            value: what is to be expected from an observation on, if bounds are kept; None while nobody knows.
        """
        stored, self._running[env] = torch.cat([*self._running[env], torch.zeros(0, dtype=torch.int64)]), []
        if self._bounded_steps and value is not None and len(stored):
            self._bound(stored, value)

    def demonstrate(self, transitions: Sequence[Transition]) -> None:
        """Keep transitions for good; from now on a share of each batch is drawn from them."""
        self._demonstrations = torch.cat([self._demonstrations, _rows(transitions)])

    @property
    def demonstrations(self) -> int:
        """How many transitions are kept for good."""
        return len(self._demonstrations)

    @property
    def oldest(self) -> int:
        """How many rows were stored before the oldest that is still there."""
        return self.stored - len(self)

    def rows(self, first: int, end: int) -> Float[Tensor, "N W"]:
        """Return the rows before which ``first``, ``first`` + 1, ... and ``end`` - 1 others were stored."""
        return self._gather_rows(torch.arange(first, end) % self._capacity)

    def sample(self, beta: float) -> Batch:
        """Draw a batch with P(i) = p_i^alpha / sum_k p_k^alpha and weights w_i = (N P(i))^-beta / max_k w_k.

        The greatest weight is that of the whole memory, which is how TorchRL's segment trees give it. The share of the
        batch that is drawn from demonstrations, uniformly, has the mean weight of the others.
        """
        if self.prioritised:
            self._sampler.beta = beta
        count = self._batch_size - self._demonstrated()
        index, information = self._sampler.sample(self._storage, count)
        weight = information["priority_weight"].float().reshape(count) if self.prioritised else torch.ones(count)
        index, rows = self._with_demonstrations(index, self._gather_rows(index))
        if len(index) > count:
            weight = torch.cat([weight, weight.mean().expand(len(index) - count)])
        return self._batch(index, weight, rows)

    def sample_demonstrations(self) -> Batch:
        """Draw a batch from demonstrations alone, uniformly; there must be some."""
        places, rows = self._draw_demonstrated(self._batch_size)
        return self._batch(self._capacity + places, torch.ones(self._batch_size), rows)

    def sample_uniform(self) -> Batch:
        """Draw a batch in which all transitions are alike, with its share of demonstrations."""
        count = self._batch_size - self._demonstrated()
        index = torch.randint(len(self), (count,), generator=self.generator)
        index, rows = self._with_demonstrations(index, self._gather_rows(index))
        return self._batch(index, torch.ones(len(index)), rows)

    def observations(self, index: Int[ndarray, "B"]) -> Float[ndarray, "B O"]:
        """Return the observations in some rows of memory."""
        return self._gather_rows(torch.from_numpy(index))[:, : self._split[0]].numpy()

    def update_priority(self, index: Int[Tensor, "B"], error: Float[Tensor, "B"]) -> None:
        """Set the priorities of drawn transitions: |error| + epsilon. Demonstrations have none."""
        if self.prioritised:
            if self.demonstrations:
                own = index < self._capacity
                index, error = index[own], error[own]
            self._sampler.update_priority(index, error.abs())

    def priority_spread(self) -> float:
        """Return the effective share of memory that is drawn: (sum p)^2 / (N sum p^2) with p as they are drawn.

        1 where all are drawn alike; near 0 where a few transitions crowd out all others.
        """
        if not self.prioritised or not len(self):
            return 1.0
        p = self._powered_priorities().double()
        return float(p.sum().square() / (len(p) * p.square().sum()))

    def state(self) -> dict[str, Tensor]:
        """Return all that a resumed run needs: the rows and what :meth:`bookkeeping` returns."""
        return {"rows": self.rows(self.oldest, self.stored), **self.bookkeeping()}

    def bookkeeping(self) -> dict[str, Tensor]:
        """Return all but the rows that a resumed run needs: how many were stored, priorities, random state."""
        state = {"stored": torch.tensor(self.stored), "generator": self.generator.get_state()}
        if self.prioritised:
            state["powered_priority"] = self._powered_priorities()
            state["max_priority"] = torch.as_tensor(self._sampler.default_priority, dtype=torch.float32)
        if self._bounded_steps:
            state["bound"] = self._bounds[: len(self)]
        if self.demonstrations:
            state["demonstrations"] = self._demonstrations
        return state

    def load_state(self, state: dict[str, Tensor], source: Path = Path("the checkpoint")) -> None:
        """Fill an empty memory with what :meth:`state` returned; its rows are there from the oldest on.

        Args:
            state: of a checkpoint.
            source: the checkpoint, to be named if it does not fit.

        Raises:
            MissingFileError: it is that of another memory.
        """
        rows = len(state["rows"]) if "rows" in state and state["rows"].dim() else 0
        like = {"rows": torch.zeros(rows, sum(self._split)), "stored": torch.tensor(0)}
        like["generator"] = self.generator.get_state()
        if self.prioritised:
            like |= {"powered_priority": torch.zeros(rows), "max_priority": torch.zeros(())}
        if self._bounded_steps:
            like["bound"] = torch.zeros(rows)
        if "demonstrations" in state:
            shown = len(state["demonstrations"]) if state["demonstrations"].dim() else 0
            like["demonstrations"] = torch.zeros(shown, sum(self._split))
        require_tensors(state, like, source)
        stored = int(state["stored"])
        least = float(state["powered_priority"].min()) if self.prioritised and rows else 1.0
        try:
            if rows == 0 or rows != min(stored, self._capacity) or least <= 0:
                raise ValueError("its rows, their number or their priorities are out of range")
            self.generator.set_state(state["generator"])
        except (ValueError, RuntimeError) as error:
            reason = f"its replay memory is damaged ({error})"
            raise MissingFileError("a checkpoint", source, reason, BEGIN_ANEW) from error
        self._demonstrations = state.get("demonstrations", self._demonstrations)
        self._extend(state["rows"].roll(stored % self._capacity, 0) if rows == self._capacity else state["rows"])
        self.stored = stored
        if self._bounded_steps:
            self._bounds[:rows] = state["bound"]
        self._buffer.writer.load_state_dict({"_cursor": stored % self._capacity})
        if self.prioritised:
            sampler = self._sampler.state_dict()
            indices = torch.arange(len(self))
            for tree in ("_sum_tree", "_min_tree"):
                sampler[tree][indices] = state["powered_priority"]
            sampler["_max_priority"] = (state["max_priority"], None)
            self._sampler.load_state_dict(sampler)

    def close(self) -> None:
        """Remove the file."""
        self._rows = None
        shutil.rmtree(self._folder, ignore_errors=True)

    def _bound(self, stored: Int[Tensor, "T"], value: Callable[[Float[ndarray, "O"]], float]) -> None:
        """Keep what an episode brought from each of its rows on, of those that are still there."""
        index = stored[stored >= self.oldest] % self._capacity
        if not len(index):  # a memory that is smaller than what other environments stored meanwhile
            return
        parts = self._gather_rows(index).split(self._split, dim=-1)
        reward, discount, next_observation = (part.numpy() for part in parts[2:])
        happened, last_value = (reward[:, 0], discount[:, 0], self._bounded_steps), value(next_observation[-1])
        if self._steady_ends:
            last_value = min(last_value, steady_value(*happened))
        found = returns_to_go(*happened, last_value)
        self._bounds[index] = torch.from_numpy(found).float()

    def _extend(self, rows: Tensor) -> None:
        if self._bounded_steps:
            self._bounds[torch.arange(self.stored, self.stored + len(rows)) % self._capacity] = _UNKNOWN
        self._buffer.extend(rows)
        self.stored += len(rows)
        if self._rows is None:
            # A plain view of the mapped file: indexing TorchRL's own tensor subclass costs four times as much.
            self._rows = torch.from_numpy(self._storage._storage.numpy())

    def _powered_priorities(self) -> Float[Tensor, "N"]:
        """Return p^alpha of all rows; of a single one, trees return a number."""
        tree = self._sampler.state_dict()["_sum_tree"]
        return torch.as_tensor(tree[torch.arange(len(self))]).reshape(len(self))

    def _gather_rows(self, index: Tensor) -> Tensor:
        assert self._rows is not None
        return self._rows.index_select(0, index)

    def _demonstrated(self) -> int:
        """Return how many transitions of a batch are demonstrations."""
        return self._demonstration_count if self.demonstrations else 0

    def _draw_demonstrated(self, count: int) -> tuple[Int[Tensor, "count"], Float[Tensor, "count W"]]:
        places = torch.randint(self.demonstrations, (count,), generator=self.generator)
        return places, self._demonstrations.index_select(0, places)

    def _with_demonstrations(self, index: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return drawn rows with the batch's share of demonstrations behind them."""
        if not self._demonstrated():
            return index, rows
        places, shown = self._draw_demonstrated(self._demonstrated())
        return torch.cat([index, self._capacity + places]), torch.cat([rows, shown])

    def _bounds_of(self, index: Int[Tensor, "B"]) -> Float[Tensor, "B"]:
        """Return the bounds of rows; there are none of demonstrations."""
        if not self._bounded_steps:
            return torch.full((len(index),), _UNKNOWN)
        own = index < self._capacity
        return torch.where(own, self._bounds[index.where(own, 0)], _UNKNOWN)

    def _batch(self, index: Tensor, weight: Tensor, rows: Tensor) -> Batch:
        observation, action, reward, discount, next_observation = rows.split(self._split, dim=-1)
        step = (observation, action, reward.squeeze(-1), discount.squeeze(-1), next_observation)
        return Batch(index, weight, *step, self._bounds_of(index))


def _rows(transitions: Sequence[Transition]) -> Float[Tensor, "N W"]:
    rows = [(t.observation, t.action, [t.reward, t.discount], t.next_observation) for t in transitions]
    return torch.from_numpy(np.stack([np.concatenate(row) for row in rows]).astype(np.float32))


def require_room(folder: Path, observation_size: int, action_size: int, rows: int) -> None:
    """Raise UserError if the disk of ``folder`` has no room for so many rows of memory, which are of 32 bits."""
    needed = 4 * (2 * observation_size + action_size + 2) * rows
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise UserError(
            f"replay memory needs {needed / 1e9:.1f} GB of disk, its checkpoints included, and {folder} has "
            f"{free / 1e9:.1f} GB free; "
            "use a smaller --replay.capacity"
        )
