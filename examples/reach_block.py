"""A task in a scene of one's own: hold the hand above the red block, wherever that lies.

An MJCF file says nothing of a task. These lines give ``datasets/scenes/blocks.xml`` a reward and a success and register
the result with Gymnasium, after which every command takes it by its name, as long as Python finds this module:

    export PYTHONPATH=examples
    nerf-rl gen-dataset --config datasets/gym.yaml --scene gym/reach_block:ReachBlock-v0 --out data/reach-block
    nerf-rl pretrain --config pretrain/demo.yaml --data data/reach-block --out runs/reach-block/encoder
    nerf-rl train-rl --config rl/gym.yaml --scene gym/reach_block:ReachBlock-v0 \
        --encoder runs/reach-block/encoder --out runs/reach-block/agent
"""

from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy import ndarray

from nerf_rl.scenes.mjcf import MjcfEnv

SCENE = Path(__file__).parents[1] / "datasets" / "scenes" / "blocks.xml"
ABOVE, NEAR = 0.12, 0.05  # [m] of the point above the block's middle, and the distance to it that counts as there
RADIUS, BEARING = (0.24, 0.36), 1.0  # [m] and [rad]: the block begins so far from the arm, at most so far to its sides
APART = 0.08  # [m] at least between the middles of two blocks


class ReachBlock(MjcfEnv):
    """The reward is minus the distance from the hand to a point above the red block [m].

    The block begins anywhere on the table before the arm, so that only who knows where it lies comes to it. An episode
    is broken off when a block has been swept off the table: no camera sees what rolls away over the floor, so it would
    only spoil the data and the memory.
    """

    def __init__(self) -> None:
        super().__init__(mujoco.MjModel.from_xml_path(str(SCENE)))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ndarray, dict[str, Any]]:
        """Start an episode with the red block at a random place."""
        super().reset(seed=seed, options=options)
        others = [self.data.body(f"{colour}_block").xpos[:2] for colour in ("green", "blue")]
        while True:
            radius, bearing = self.np_random.uniform(*RADIUS), self.np_random.uniform(-BEARING, BEARING)
            place = radius * np.array([np.cos(bearing), np.sin(bearing)])
            if all(np.linalg.norm(place - other) > APART for other in others):
                break
        self.data.joint(self.model.body("red_block").jntadr[0]).qpos[:2] = place
        mujoco.mj_forward(self.model, self.data)
        return self.observe(), {}

    def step(self, action: ndarray) -> tuple[ndarray, float, bool, bool, dict[str, Any]]:
        """Act for 0.05 s."""
        observation, _, terminated, truncated, info = super().step(action)
        goal = self.data.body("red_block").xpos + np.array([0.0, 0.0, ABOVE])
        distance = float(np.linalg.norm(self.data.body("hand").xpos - goal))
        lost = any(self.data.body(f"{colour}_block").xpos[2] < 0.0 for colour in ("red", "green", "blue"))
        return observation, -distance, terminated, truncated or lost, {**info, "success": distance < NEAR}


gymnasium.register("ReachBlock-v0", entry_point=ReachBlock, max_episode_steps=60)
