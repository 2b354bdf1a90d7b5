"""Pruning of poor whales."""

import numpy as np
from optuna import Study
from optuna.pruners import BasePruner
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from nerf_rl.tuning.sampler import slot_of

_LEAST_TRIALS = 4  # of earlier generations, without which nothing is pruned


class EarlierMedianPruner(BasePruner):
    """Optuna's median rule among earlier generations: stop a trial whose best value so far is below their median.

    Trials of the same generation do not count, so what is pruned does not depend on which of them was faster.

    Args:
        warmup_steps: steps before which nothing is pruned.
    """

    def __init__(self, warmup_steps: int = 0):
        self._warmup_steps = warmup_steps

    def prune(self, study: Study, trial: FrozenTrial) -> bool:
        """Tell whether to stop a trial after its last reported value."""
        step, slot = trial.last_step, slot_of(trial)
        if step is None or slot is None or step < self._warmup_steps:
            return False
        sign = -1.0 if study.direction == StudyDirection.MINIMIZE else 1.0
        earlier = [
            sign * other.intermediate_values[step]
            for other in study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
            if step in other.intermediate_values and (held := slot_of(other)) is not None and held[0] < slot[0]
        ]
        if len(earlier) < _LEAST_TRIALS:
            return False
        own = [sign * value for at, value in trial.intermediate_values.items() if at <= step]
        return not np.nanmax([-np.inf, *own]) >= np.nanmedian(earlier)
