"""What succeeded is done again from other starts, and remembered from there."""

from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AsyncVectorEnv
from numpy import ndarray
from tiny_run import config, train

from nerf_rl.errors import MissingFileError
from nerf_rl.rl.training.curriculum import Curriculum
from nerf_rl.rl.training.curves import MetricsLog
from nerf_rl.rl.training.echoes import Echoes
from nerf_rl.rl.training.exploration import Exploration
from nerf_rl.rl.training.loop import Trainer

NO, YES = np.array([False]), np.array([True])


def at(place: float) -> ndarray:
    return np.array([place, 0.0], np.float32)


def acts(value: float) -> ndarray:
    return np.full((1, 3), value, np.float32)


def act_out(
    made: Echoes, place: float, value: float, steps: int, success_at: int | None, echo: bool = False
) -> ndarray:
    """Act an episode whose policy always does ``value``; return what was done [steps, 3]."""
    made.begin(0, at(place), echo)
    succeeded = [success_at is not None and step > success_at for step in range(steps)]
    done = [made.act(acts(value), YES if yes else NO)[0] for yes in succeeded]
    made.end(0, success_at is not None)
    return np.stack(done)


def held(done: ndarray, value: float) -> int:
    """Return for how many actions from the first one on a value was done, but for noise."""
    near = np.abs(done - value).max(axis=1) < 0.6
    return int(np.argmin(near)) if not near.all() else len(near)


def test_an_echo_does_what_succeeded_from_a_similar_start_and_then_what_the_policy_says() -> None:
    made = Echoes(1, 50, np.random.default_rng(0))
    for place in (-1.0, 1.0):
        for success_at in (29, 19, 24, 39, 34):  # the quickest takes 20 actions, and five more are kept
            act_out(made, place + 0.01 * success_at, 0.7 * place, steps=50, success_at=success_at)
    lengths = []
    for _ in range(200):
        done = act_out(made, 1.5, -0.7, steps=50, success_at=None, echo=True)
        lengths.append(held(done, 0.7))
        assert (done[lengths[-1] :] == np.float32(-0.7)).all()
        assert 0.05 < (done[: lengths[-1]] - 0.7).std() < 0.15
    assert len(made) == 10, "they failed"
    assert max(lengths) == 25 and min(lengths) == 15 and len(set(lengths)) == 11, "up to half is left out"
    assert 0.2 < np.mean(np.array(lengths) == 25) < 0.4


def test_what_an_echo_did_is_remembered_with_its_own_start_and_once_quicker_done_in_place_of_it() -> None:
    made = Echoes(1, 50, np.random.default_rng(0))
    act_out(made, 0.0, 0.7, steps=40, success_at=39)
    for place in range(1, 40):
        act_out(made, 0.1 * place, -0.7, steps=50, success_at=9, echo=True)
    state = made.state_dict()
    assert state["start"][:, 0].tolist() == pytest.approx([0.1 * place for place in range(40)], abs=1e-6)
    assert state["length"].tolist() == [40] + [15] * 39
    first, echo = (actions.numpy() for actions in state["action"].split(state["length"].tolist())[:2])
    assert held(first, 0.7) == 40 and held(echo, 0.7) == 15


def test_what_is_left_out_comes_before_the_success() -> None:
    made = Echoes(1, 50, np.random.default_rng(0))
    made.begin(0, at(0.0), False)
    for step in range(20):
        made.act(acts(1.0 if step > 14 else -1.0), YES if step > 14 else NO)
    made.end(0, True)
    for _ in range(50):
        done = act_out(made, 0.0, 0.0, steps=20, success_at=None, echo=True)[:, 0]
        assert (done > 0.5).sum() == 5 and 8 <= (done < -0.5).sum() <= 15


def test_the_latest_are_remembered_and_actions_stay_in_their_box() -> None:
    made = Echoes(1, 2, np.random.default_rng(0))
    for place in (0.1, 0.2, 1.0):
        act_out(made, place, 1.0, steps=20, success_at=2)
    assert made.state_dict()["start"][:, 0].tolist() == pytest.approx([0.2, 1.0])
    assert act_out(made, 1.0, 0.0, steps=20, success_at=None, echo=True).max() == 1.0


def test_whoever_echoes_nothing_acts_as_the_policy_says() -> None:
    made = Echoes(2, 0, np.random.default_rng(0))
    before = made._rng.bit_generator.state
    for env in (0, 1):
        made.begin(env, at(0.0), False)
    action = np.random.default_rng(1).uniform(-1, 1, (2, 3)).astype(np.float32)
    assert np.array_equal(made.act(action, np.array([True, False])), action)
    made.end(0, True)
    assert not len(made) and made._rng.bit_generator.state == before


def test_a_resumed_run_remembers_the_same_and_damage_is_told() -> None:
    made, copy = (Echoes(1, 50, np.random.default_rng(3)) for _ in range(2))
    for place in (0.1, 0.2):
        act_out(made, place, place, steps=20, success_at=int(10 * place))
    state = made.state_dict()
    copy.load_state_dict(state, (2, 3), Path("run"))
    copy._rng.bit_generator.state = made._rng.bit_generator.state
    done, again = (act_out(each, 0.2, 0.0, 20, None, echo=True) for each in (made, copy))
    assert np.array_equal(done, again)
    for damage in (
        {"length": state["length"] + 1},
        {"length": state["length"] - state["length"].min()},
        {"action": torch.zeros(0, 3)},
        {"start": torch.zeros(2, 5)},
        {"start": state["start"].double()},
    ):
        with pytest.raises(MissingFileError, match="run"):
            Echoes(1, 50, np.random.default_rng(0)).load_state_dict(state | damage, (2, 3), Path("run"))
    for name in state:
        with pytest.raises(MissingFileError, match="run"):
            rest = {each: tensor for each, tensor in state.items() if each != name}
            Echoes(1, 50, np.random.default_rng(0)).load_state_dict(rest, (2, 3), Path("run"))
    copy.load_state_dict({}, (2, 3), Path("run"))
    assert len(copy) == 2, "of a version that remembered nothing"


def test_a_share_of_the_retries_are_echoes_once_there_is_something_to_do_again() -> None:
    made = Curriculum(7, 1, 0.5, None, np.random.default_rng(0), echo_share=0.8)
    made.begin(0, 0)
    made.end(0, True)
    kinds = []
    for index in range(4000):
        made.begin(0, index % 2)
        kinds.append((bool(made.retried[0]), bool(made.echoed[0])))
        made.end(0, False)
    retries = [echoed for retried, echoed in kinds[1::2] if retried]
    assert 0.77 < np.mean(retries) < 0.83 and len(retries) > 500
    assert not any(echoed for retried, echoed in kinds if not retried), "what is new is tried by the policy"
    assert not any(echoed for _, echoed in kinds[::2]), "there was nothing to do again"


def test_echoes_are_over_when_successes_come_by_themselves_and_come_back_when_they_do_not() -> None:
    made = Curriculum(7, 1, 0.9, None, np.random.default_rng(0), echo_share=0.9)

    def echoed(episodes: int, success: bool) -> float:
        """Return the share of echoes among retries; new places succeed, or all of them fail."""
        kinds = []
        for _ in range(episodes):
            made.begin(0, 1)
            kinds += [bool(made.echoed[0])] if made.retried[0] else []
            made.end(0, success)
            made._failed.extend([1] * 20)  # there is always one to try again
        return float(np.mean(kinds))

    made.begin(0, 1)
    made.end(0, True)
    assert echoed(200, False) > 0.8
    made._recent.extend([True] * 5)
    assert echoed(200, True) == 0.0
    made._recent.extend([False] * 16)
    assert echoed(20, False) > 0.6


def test_a_run_echoes_what_succeeded_and_resumes_to_the_same_actions(
    envs: AsyncVectorEnv, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    echoed: list[bool] = []
    begin = Curriculum.begin

    def noted(self: Curriculum, env: int, successes: int = 0) -> int:
        seed = begin(self, env, successes)
        echoed.append(bool(self.echoed[env]))
        return seed

    told: list[str] = []
    gather = MetricsLog.gather

    def read(self: MetricsLog, figures: dict[str, float]) -> None:
        told.extend(figures.keys() & {"episode_return", "echo_success"})
        gather(self, figures)

    explored: list[bool] = []
    end_episode = Exploration.end_episode

    def ended(self: Exploration, success: bool | None, env_step: int, echoed: bool = False) -> None:
        explored.append(echoed)
        end_episode(self, success, env_step, echoed)

    monkeypatch.setattr(Curriculum, "begin", noted)
    monkeypatch.setattr(MetricsLog, "gather", read)
    monkeypatch.setattr(Exploration, "end_episode", ended)
    (tmp_path / "whole").mkdir()
    keys = {"episode_steps": 12, "retry_share": 0.9, "echo_share": 0.9}
    whole = Trainer(config(tmp_path / "whole", **keys), envs, tmp_path / "whole")
    train(whole, 240)
    assert len(whole._echoes), "it succeeds sometimes"
    whole.save()
    train(whole, 480)
    rows = whole.replay.rows(0, whole.replay.stored)
    whole.replay.close()
    assert any(echoed) and not all(echoed)
    episodes = len((tmp_path / "whole" / "monitor.csv").read_text().splitlines()) - 2
    assert len(told) == episodes and 0 < told.count("echo_success") <= sum(echoed), "figures are of the policy's own"
    assert len(explored) == episodes and sum(explored) == told.count("echo_success")
    resumed = Trainer(config(tmp_path / "whole", **keys, resume=True), envs, tmp_path / "whole")
    train(resumed, 480)
    assert torch.equal(resumed.replay.rows(0, resumed.replay.stored), rows)
    resumed.replay.close()
