"""The Whale Optimisation Algorithm as a sampler for any Optuna study.

Every trial takes a slot: (generation, whale). Slot and position are kept with the trial in the study's storage, and
the random numbers of a generation come from (seed, generation). So what a slot proposes depends on the seed and on the
results of the generations before it only: the sampler holds no state, and workers, machines and resumed studies propose
the same.
"""

import datetime
import time
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from optuna import Study
from optuna.distributions import BaseDistribution
from optuna.samplers import BaseSampler
from optuna.search_space import intersection_search_space
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from nerf_rl.errors import UnknownNameError
from nerf_rl.tuning.space import decode, encode, width
from nerf_rl.tuning.trial_notes import write_system_note
from nerf_rl.tuning.whale import MODES, next_positions

SLOT = "whale:slot"
POSITION = "whale:position"
_FINISHED = (TrialState.COMPLETE, TrialState.PRUNED)
_PATIENCE = datetime.timedelta(seconds=5)

Slot = tuple[int, int]
"""Generation and whale, both from 0."""


class WhaleSampler(BaseSampler):
    """Proposes the positions of whales, generation by generation.

    A failed trial frees its slot, which a later trial fills with the same proposal. A pruned trial keeps its slot, but
    is not followed. Later slots than ``population * iterations`` are proposed as those of the last generation are.

    Args:
        population: whales in a generation.
        iterations: generations over which the search narrows.
        mode: faithful or shift_invariant, see :mod:`nerf_rl.tuning.whale`.
        seed: of everything random.
        start: known good values, by parameter. The first whale starts there; and it is the origin of the coordinates,
            which the faithful mode prefers. Without one, the origin is the middle of the box.
        space: the parameters with their distributions, if known beforehand; otherwise those that all trials had so far.
        wait: called again and again, with the study and the trial, while a trial waits until the generation before its
            own is finished. None goes on with what is known, which then depends on who was faster.
    """

    def __init__(
        self,
        population: int = 10,
        iterations: int = 10,
        mode: str = "faithful",
        seed: int = 0,
        start: Mapping[str, Any] | None = None,
        space: Mapping[str, BaseDistribution] | None = None,
        wait: Callable[[Study, FrozenTrial], None] | None = None,
    ):
        if population < 2 or iterations < 1 or seed < 0:
            raise ValueError(
                "WhaleSampler needs a population of at least 2, an iteration and a seed that is not negative"
            )
        if mode not in MODES:
            raise UnknownNameError("mode", mode, MODES)
        self._population, self._iterations, self._mode, self._seed = population, iterations, mode, seed
        self._start, self._space, self._wait = dict(start or {}), space, wait

    def before_trial(self, study: Study, trial: FrozenTrial) -> None:
        """Take the first free slot. Trials are served in the order of their numbers, so no slot is taken twice."""
        if len(study.directions) > 1:
            raise ValueError(f"WhaleSampler follows one leader, but the study has {len(study.directions)} objectives")
        while True:
            trials = study.get_trials(deepcopy=False)
            slot = self.free_slot(trials)
            served = not any(self._is_before(other, trial) for other in trials)
            if served and (self._wait is None or self._is_finished(trials, slot[0] - 1)):
                write_system_note(study, trial, SLOT, list(slot))
                return
            if self._wait is not None:
                self._wait(study, trial)
            else:
                time.sleep(0.01)

    def infer_relative_search_space(self, study: Study, trial: FrozenTrial) -> dict[str, BaseDistribution]:
        """Return the parameters that whales move in."""
        space = self._space if self._space is not None else intersection_search_space(study.get_trials(deepcopy=False))
        return {name: space[name] for name in sorted(space) if not space[name].single()}

    def sample_relative(
        self, study: Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Return the values that the trial's slot proposes."""
        if not search_space:
            return {}
        trials = study.get_trials(deepcopy=False)
        slot = slot_of(trials[trial.number])
        assert slot is not None
        position = self._proposed_before(trials, slot, search_space)
        if position is None:
            position = _split(self._propose(trials, slot, search_space, study.direction), search_space)
        write_system_note(study, trial, POSITION, position)
        return {name: decode(distribution, position[name]) for name, distribution in search_space.items()}

    def sample_independent(
        self, study: Study, trial: FrozenTrial, param_name: str, param_distribution: BaseDistribution
    ) -> Any:
        """Return a random value of a parameter that not all trials have; it depends on the slot and the name only."""
        stored = study.get_trials(deepcopy=False)[trial.number]
        slot = slot_of(stored)
        assert slot is not None
        coordinates = self._random(slot, param_name, param_distribution)
        position = {**stored.system_attrs.get(POSITION, {}), param_name: coordinates}
        write_system_note(study, trial, POSITION, position)
        return decode(param_distribution, coordinates)

    def free_slot(self, trials: list[FrozenTrial]) -> Slot:
        """Return the first slot that no trial holds."""
        held = {slot_of(trial) for trial in trials if trial.state != TrialState.FAIL}
        index = next(i for i in range(len(held) + 1) if divmod(i, self._population) not in held)
        return divmod(index, self._population)

    def _is_finished(self, trials: list[FrozenTrial], generation: int) -> bool:
        finished = {slot_of(trial) for trial in trials if trial.state in _FINISHED}
        return generation < 0 or all((generation, whale) in finished for whale in range(self._population))

    def _is_before(self, other: FrozenTrial, trial: FrozenTrial) -> bool:
        """Tell whether another trial is to take its slot before this one does.

        A worker may die before its trial has a slot. ``wait`` is to fail such a trial; without it, the trial is passed
        over some seconds after its start.
        """
        if other.number >= trial.number or other.state != TrialState.RUNNING or slot_of(other) is not None:
            return False
        assert other.datetime_start is not None
        return self._wait is not None or datetime.datetime.now() - other.datetime_start < _PATIENCE

    def _proposed_before(
        self, trials: list[FrozenTrial], slot: Slot, space: dict[str, BaseDistribution]
    ) -> dict[str, list[float]] | None:
        """Return the position that an earlier, failed trial had in the same slot, if it was in the same space."""
        for trial in trials:
            position = trial.system_attrs.get(POSITION, {})
            if slot_of(trial) == slot and {name: len(position.get(name, ())) for name in space} == {
                name: width(distribution) for name, distribution in space.items()
            }:
                return {name: position[name] for name in space}
        return None

    def _propose(
        self, trials: list[FrozenTrial], slot: Slot, space: dict[str, BaseDistribution], direction: StudyDirection
    ) -> Float[ndarray, "D"]:
        """Return the coordinates of a slot."""
        generation, whale = slot
        leader = self._leader(trials, generation, direction)
        if leader is None:
            return np.concatenate([self._random(slot, name, distribution) for name, distribution in space.items()])
        holders = {slot_of(trial): trial for trial in sorted(trials, key=_holds)}
        whales = [(generation - 1, i) for i in range(self._population)]
        positions = np.stack([self._coordinates(holders.get(at), at, space) for at in whales])
        leading = slot_of(leader)
        assert leading is not None
        origin = np.concatenate([self._origin(name, distribution) for name, distribution in space.items()])
        done = (min(generation, max(1, self._iterations - 1)) - 1) / self._iterations
        moved = next_positions(
            positions - origin,
            self._coordinates(leader, leading, space) - origin,
            done,
            np.random.default_rng([self._seed, generation]),
            self._mode,
        )
        return np.clip(moved[whale] + origin, 0.0, 1.0)

    def _leader(self, trials: list[FrozenTrial], generation: int, direction: StudyDirection) -> FrozenTrial | None:
        """Return the best finished trial of earlier generations; of equals the one with the first slot."""
        sign = -1.0 if direction == StudyDirection.MAXIMIZE else 1.0
        earlier = [
            (sign * trial.value, slot, trial.number)
            for trial in trials
            if trial.state == TrialState.COMPLETE and (slot := slot_of(trial)) and slot[0] < generation
            if trial.value is not None
        ]
        return trials[min(earlier)[2]] if earlier else None

    def _coordinates(
        self, trial: FrozenTrial | None, slot: Slot, space: dict[str, BaseDistribution]
    ) -> Float[ndarray, "D"]:
        """Return where a trial was; its values count where they are not those of its position (if they were given)."""
        coordinates: list[float] = []
        for name, distribution in space.items():
            position = trial.system_attrs.get(POSITION, {}).get(name) if trial is not None else None
            known = trial is not None and trial.distributions.get(name) == distribution
            if position is not None and len(position) != width(distribution):
                position = None
            if (
                trial is not None
                and known
                and (position is None or decode(distribution, position) != trial.params[name])
            ):
                position = encode(distribution, trial.params[name])
            coordinates += self._random(slot, name, distribution) if position is None else position
        return np.array(coordinates)

    def _random(self, slot: Slot, name: str, distribution: BaseDistribution) -> list[float]:
        """Return random coordinates of one parameter; the first whale starts at the origin, if one was given."""
        if slot == (0, 0) and name in self._start:
            return self._origin(name, distribution)
        return (
            np.random.default_rng([self._seed, *slot, zlib.crc32(name.encode())]).random(width(distribution)).tolist()
        )

    def _origin(self, name: str, distribution: BaseDistribution) -> list[float]:
        """Return the coordinates of a parameter's known good value, or of the middle."""
        return encode(distribution, self._start[name]) if name in self._start else [0.5] * width(distribution)


def slot_of(trial: FrozenTrial) -> Slot | None:
    """Return the slot that a trial has taken."""
    stored = trial.system_attrs.get(SLOT)
    return None if stored is None else (stored[0], stored[1])


def _holds(trial: FrozenTrial) -> tuple[bool, bool, int]:
    """Order the trials of a slot by how well they tell its position; a failed one may have ended before it had any."""
    return trial.state != TrialState.FAIL, POSITION in trial.system_attrs, -trial.number


def _split(coordinates: Float[ndarray, "D"], space: dict[str, BaseDistribution]) -> dict[str, list[float]]:
    """Return the coordinates of each parameter."""
    ends = np.cumsum([width(distribution) for distribution in space.values()])[:-1]
    return {name: part.tolist() for name, part in zip(space, np.split(coordinates, ends), strict=True)}
