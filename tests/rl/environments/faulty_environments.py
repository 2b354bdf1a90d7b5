"""Environments of one's own that do what no environment should, or succeed, at the fifth step of an episode."""

import os
from typing import Any

import gymnasium
import numpy as np
from own_environments import Slider


class FaultySlider(Slider):
    """A mass on a rail, without goals, with a fault."""

    FAULTS = (
        "observation nan",
        "observation huge",
        "observation short",
        "reward nan",
        "reward inf",
        "reward two",
        "success nan",
        "success text",
        "success two",
        "success true",
        "percent",
        "exit",
    )

    def __init__(self, fault: str):
        super().__init__()
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.fault, self.steps = fault, 0

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Any, dict]:
        self.steps = 0
        return super().reset(seed=seed, options=options)

    def step(self, action: np.ndarray) -> tuple[Any, Any, bool, bool, dict]:
        self.data.ctrl[:] = action
        self.steps += 1
        at = self.fault if self.steps == 5 else ""
        if at == "percent":
            raise RuntimeError(f"boom at 100 % of {self.steps}")
        if at == "exit":
            os._exit(3)
        observation = self._get_obs()
        faulty = {"observation nan": np.array([0.0, np.nan]), "observation huge": np.array([1e300, 0.0])}
        observation = faulty.get(at, observation[:1] if at == "observation short" else observation)
        reward: Any = {"reward nan": float("nan"), "reward inf": np.inf, "reward two": np.zeros(2)}.get(at, -1.0)
        success: Any = {
            "success nan": np.nan,
            "success text": "no",
            "success two": [True, False],
            "success true": 1,
        }.get(at, False)
        return observation, reward, False, False, {"success": success}

    def _get_obs(self) -> Any:
        return np.concatenate([self.data.qpos, self.data.qvel])


class FallingSlider(Slider):
    """A goal environment whose episodes end, whatever the goal, where the cart has gone too far."""

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict]:
        observation, reward, *_, info = super().step(action)
        return observation, reward, bool(abs(self.data.qpos[0]) > 0.002), False, info


class ColumnGoalSlider(Slider):
    """Its goals are columns, and its reward asks for a step's information if it is told to; it is never stepped."""

    def __init__(self, informed: bool = False):
        super().__init__()
        self.informed = informed
        parts = self.observation_space.spaces
        column = gymnasium.spaces.Box(-np.inf, np.inf, (1, 1), np.float64)
        self.observation_space = gymnasium.spaces.Dict(
            {"observation": parts["observation"], "achieved_goal": column, "desired_goal": column}
        )

    def compute_reward(self, achieved: np.ndarray, desired: np.ndarray, info: dict) -> float:
        if self.informed:
            return float(info["grip"])
        assert achieved.shape == desired.shape == (1, 1)
        return -float(abs(achieved - desired).max() > 0.05)

    def _get_obs(self) -> dict[str, Any]:
        return {name: part if name == "observation" else part[:, None] for name, part in super()._get_obs().items()}


def faulty(fault: str) -> str:
    """Return the name of the scene with a fault."""
    return f"gym/faulty_environments:Faulty{fault.title().replace(' ', '')}-v0"


for _fault in FaultySlider.FAULTS:
    name = faulty(_fault).partition(":")[2]
    gymnasium.register(name, entry_point=FaultySlider, max_episode_steps=20, kwargs={"fault": _fault})
gymnasium.register("FallingSlider-v0", entry_point=FallingSlider, max_episode_steps=20)
gymnasium.register("ColumnGoalSlider-v0", entry_point=ColumnGoalSlider, max_episode_steps=20)
gymnasium.register("InformedSlider-v0", entry_point=ColumnGoalSlider, max_episode_steps=20, kwargs={"informed": True})
FALLING, COLUMN_GOAL = "gym/faulty_environments:FallingSlider-v0", "gym/faulty_environments:ColumnGoalSlider-v0"
INFORMED = "gym/faulty_environments:InformedSlider-v0"
