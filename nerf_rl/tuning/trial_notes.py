"""Notes beside trials, which other processes read.

Optuna writes them for a trial's own objective alone; samplers and whoever watches over trials need its private
``_trial_id`` and ``_storage``, which are used here and nowhere else. Checked with Optuna 5.0.0.
"""

from typing import Any, TypeAlias

from optuna import Study
from optuna.storages import BaseStorage
from optuna.trial import FrozenTrial, Trial

AnyTrial: TypeAlias = Trial | FrozenTrial


def write_note(storage: BaseStorage, trial: AnyTrial, key: str, value: Any) -> None:
    """Write beside a running trial what ``user_attrs`` shows; raise as the storage does if the trial has ended."""
    storage.set_trial_user_attr(trial._trial_id, key, value)


def write_system_note(study: Study, trial: AnyTrial, key: str, value: Any) -> None:
    """Write beside a running trial what ``system_attrs`` shows: where samplers keep what is theirs."""
    study._storage.set_trial_system_attr(trial._trial_id, key, value)
