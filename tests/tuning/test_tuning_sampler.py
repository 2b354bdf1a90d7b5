"""WhaleSampler in plain Optuna studies: spaces, direction, resumption, parallel workers, failures."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pytest
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, Trial, TrialState

from nerf_rl.errors import UnknownNameError
from nerf_rl.tuning.sampler import SLOT, WhaleSampler
from nerf_rl.tuning.space import decode, encode, width
from nerf_rl.tuning.storage import open_storage
from nerf_rl.tuning.whale import next_positions

SPACE: dict[str, BaseDistribution] = {
    "rate": FloatDistribution(1e-5, 1e-1, log=True),
    "share": FloatDistribution(-1.0, 3.0),
    "stepped": FloatDistribution(0.0, 1.0, step=0.25),
    "count": IntDistribution(2, 9),
    "size": IntDistribution(16, 512, log=True),
    "kind": CategoricalDistribution(["layer", "none", 3, True]),
}
optuna.logging.set_verbosity(optuna.logging.WARNING)


def objective(trial: Trial) -> float:
    rate = trial.suggest_float("rate", 1e-5, 1e-1, log=True)
    share = trial.suggest_float("share", -1.0, 3.0)
    trial.suggest_float("stepped", 0.0, 1.0, step=0.25)
    count = trial.suggest_int("count", 2, 9)
    trial.suggest_int("size", 16, 512, log=True)
    kind = trial.suggest_categorical("kind", ["layer", "none", 3, True])
    return (math.log10(rate) + 3) ** 2 + (share - 0.5) ** 2 + (count - 4) ** 2 + (kind != "none")


def proposals(study: optuna.Study) -> dict[tuple[int, int], dict[str, Any]]:
    """Return the parameters of every slot that is held."""
    held = [trial for trial in study.get_trials() if trial.state != TrialState.FAIL]
    slots = {tuple(trial.system_attrs[SLOT]): trial.params for trial in held}
    assert len(slots) == len(held), "two trials hold one slot"
    return slots


def searched(trials: int, function: Callable[[Trial], float] = objective, **keys: Any) -> optuna.Study:
    """Return a finished study in memory."""
    direction = keys.pop("direction", "minimize")
    study = optuna.create_study(sampler=WhaleSampler(4, 5, **keys), direction=direction)
    study.optimize(function, trials)
    return study


@pytest.mark.parametrize("name", SPACE)
def test_values_survive_their_coordinates(name: str) -> None:
    distribution, rng = SPACE[name], np.random.default_rng(0)
    for _ in range(200):
        value = decode(distribution, rng.random(width(distribution)).tolist())
        assert distribution._contains(distribution.to_internal_repr(value))
        again = decode(distribution, encode(distribution, value))
        assert again == (pytest.approx(value) if isinstance(value, float) else value)
    for corner in (0.0, 1.0):
        value = decode(distribution, [corner] * width(distribution))
        assert distribution._contains(distribution.to_internal_repr(value))


def test_whole_numbers_and_options_have_equal_shares() -> None:
    for distribution, options in ((SPACE["count"], 8), (SPACE["stepped"], 5), (SPACE["kind"], 4)):
        rng = np.random.default_rng(1)
        values = [decode(distribution, rng.random(width(distribution)).tolist()) for _ in range(8000)]
        shares = np.array([values.count(value) for value in set(values)]) / 8000
        assert len(shares) == options and np.allclose(shares, 1 / options, atol=0.02)


def test_a_rate_is_searched_on_a_logarithmic_scale() -> None:
    rates = [searched(1, seed=seed).get_trials()[0].params["rate"] for seed in range(200)]
    assert np.mean(np.array(rates) < 1e-3) == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("mode", ["faithful", "shift_invariant"])
def test_later_generations_are_better_than_the_first(mode: str) -> None:
    values = [trial.value for trial in searched(60, mode=mode, seed=2).get_trials()]
    assert min(values[8:]) < min(values[:4])


def test_maximising_the_negative_proposes_what_minimising_does() -> None:
    down = searched(20)
    up = searched(20, lambda trial: -objective(trial), direction="maximize")
    assert proposals(down) == proposals(up)
    assert up.best_value == -down.best_value


@pytest.mark.parametrize("storage", ["journal", "sqlite"])
def test_a_resumed_study_proposes_what_an_uninterrupted_one_does(storage: str, tmp_path: Path) -> None:
    for trials in (3, 1, 9, 7):
        place = f"sqlite:///{tmp_path}/study.db" if storage == "sqlite" else ""
        study = optuna.create_study(
            storage=open_storage(place, tmp_path), study_name="s", sampler=WhaleSampler(4, 5), load_if_exists=True
        )
        study.optimize(objective, trials)
    assert proposals(study) == proposals(searched(20))


def test_failed_trials_free_their_slots_for_the_same_proposals() -> None:
    calls = iter(range(100))

    def sometimes(trial: Trial) -> float:
        value = objective(trial)
        if next(calls) % 3 == 1:
            raise OSError("lost")
        return value

    study = optuna.create_study(sampler=WhaleSampler(4, 5))
    study.optimize(sometimes, 28, catch=OSError)
    whole = proposals(searched(20))
    found = proposals(study)
    assert len(found) < 28 and all(whole[slot] == params for slot, params in found.items())


def test_trials_that_failed_before_they_had_a_position_change_nothing() -> None:
    study = optuna.create_study(sampler=WhaleSampler(4, 5))
    for _ in range(20):
        study.tell(study.ask(), state=TrialState.FAIL)
        study.optimize(objective, 1)
    assert proposals(study) == proposals(searched(20))


def test_pruned_trials_keep_their_slots_and_do_not_lead() -> None:
    def prunes_the_best(trial: Trial) -> float:
        value = objective(trial)
        if trial.number < 4:
            trial.report(-1000.0, 1)
            raise optuna.TrialPruned
        return value

    study = searched(12, prunes_the_best)
    assert [trial.state for trial in study.get_trials()[:4]] == [TrialState.PRUNED] * 4
    assert sorted(proposals(study)) == [(generation, whale) for generation in range(3) for whale in range(4)]


def test_no_slot_is_taken_twice_by_parallel_trials() -> None:
    study = optuna.create_study(sampler=WhaleSampler(4, 5))
    study.optimize(objective, 40, n_jobs=4)
    assert sorted(proposals(study)) == [divmod(index, 4) for index in range(40)]


def test_a_parallel_study_that_waits_for_generations_proposes_what_one_worker_does() -> None:
    def wait(study: optuna.Study, trial: FrozenTrial) -> None:
        assert trial.state == TrialState.RUNNING

    study = optuna.create_study(sampler=WhaleSampler(4, 5, wait=wait))
    study.optimize(objective, 20, n_jobs=3)
    assert proposals(study) == proposals(searched(20))


def test_a_space_known_beforehand_is_searched_like_one_found_in_the_trials() -> None:
    study = optuna.create_study(sampler=WhaleSampler(4, 5, space=SPACE))
    for _ in range(12):
        trial = study.ask(fixed_distributions=SPACE)
        study.tell(trial, objective(trial))
    assert proposals(study) == proposals(searched(12))


def test_the_first_whale_starts_at_the_known_good_values() -> None:
    start = {"rate": 3e-4, "share": 0.25, "stepped": 0.75, "count": 5, "size": 128, "kind": 3}
    first = searched(4, start=start).get_trials()[0].params
    assert first["rate"] == pytest.approx(3e-4) and first["share"] == pytest.approx(0.25)
    assert {name: first[name] for name in ("stepped", "count", "size", "kind")} == {
        "stepped": 0.75,
        "count": 5,
        "size": 128,
        "kind": 3,
    }


def test_the_faithful_mode_is_drawn_to_the_known_good_values() -> None:
    def best(start: dict[str, float]) -> float:
        study = optuna.create_study(sampler=WhaleSampler(10, 10, start=start))

        def near(trial: Trial) -> float:
            return sum((trial.suggest_float(name, -10, 10) - 4.0) ** 2 for name in "abcdef")

        study.optimize(near, 100)
        return study.best_value

    assert best(dict.fromkeys("abcdef", 4.1)) < 0.1 * best({})


def test_the_search_goes_on_beyond_its_last_generation() -> None:
    study = searched(4 * 5 + 10)
    assert sorted(proposals(study))[-1] == (7, 1)


def test_later_generations_are_as_narrow_as_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    progress: list[float] = []

    def note(positions: np.ndarray, leader: np.ndarray, done: float, *rest: Any) -> np.ndarray:
        progress.append(done)
        return next_positions(positions, leader, done, *rest)

    monkeypatch.setattr("nerf_rl.tuning.sampler.next_positions", note)
    searched(4 * 8)
    assert sorted(set(progress)) == [0.0, 0.2, 0.4, 0.6] and progress[-1] == progress[4 * 3] == 0.6


def test_parameters_that_only_some_trials_have_are_drawn_on_their_own() -> None:
    def changing(trial: Trial) -> float:
        x = trial.suggest_float("x", 0, 1)
        return x + (trial.suggest_float("y", 0, 1) if trial.number % 2 else trial.suggest_int("z", 1, 3))

    assert len(proposals(searched(20, changing))) == 20


def test_values_that_a_user_asks_for_take_part() -> None:
    study = optuna.create_study(sampler=WhaleSampler(4, 5))
    wanted = {"rate": 1e-3, "share": 0.5, "stepped": 0.5, "count": 4, "size": 64, "kind": "none"}
    study.enqueue_trial(wanted)
    study.optimize(objective, 12)
    assert proposals(study)[0, 0] == wanted
    assert study.best_value < 1e-3


def test_several_objectives_are_refused() -> None:
    study = optuna.create_study(directions=["minimize", "maximize"], sampler=WhaleSampler())
    with pytest.raises(ValueError, match="follows one leader, but the study has 2 objectives"):
        study.ask()


def test_an_unknown_mode_is_answered_with_those_there_are() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown mode 'faithfull' \(did you mean faithful\?\)"):
        WhaleSampler(mode="faithfull")


def test_an_unfinished_last_line_of_a_killed_writer_does_not_spoil_a_journal(tmp_path: Path) -> None:
    study = optuna.create_study(storage=open_storage("", tmp_path), study_name="s", sampler=WhaleSampler(4, 5))
    study.optimize(objective, 5)
    with open(tmp_path / "study.journal", "ab") as journal:
        journal.write(b'{"op_code": 4, "worker_id": "' + b"x" * 5000)
    again = optuna.load_study(storage=open_storage("", tmp_path), study_name="s", sampler=WhaleSampler(4, 5))
    again.optimize(objective, 5)
    third = optuna.load_study(storage=open_storage("", tmp_path), study_name="s")
    assert proposals(third) == proposals(searched(10))
