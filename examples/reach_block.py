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
ABOVE, NEAR = 0.12, 0.04  # [m] of the point above the block's middle, and the distance to it that counts as there


class ReachBlock(MjcfEnv):
    """The reward is minus the distance from the hand to a point above the red block [m].

    An episode is broken off when a block has been swept off the table: no camera sees what rolls away over the floor,
    so it would only spoil the data and the memory.
    """

    def __init__(self) -> None:
        super().__init__(mujoco.MjModel.from_xml_path(str(SCENE)))

    def step(self, action: ndarray) -> tuple[ndarray, float, bool, bool, dict[str, Any]]:
        """Act for 0.05 s."""
        observation, _, terminated, truncated, info = super().step(action)
        goal = self.data.body("red_block").xpos + np.array([0.0, 0.0, ABOVE])
        distance = float(np.linalg.norm(self.data.body("hand").xpos - goal))
        lost = any(self.data.body(f"{colour}_block").xpos[2] < 0.0 for colour in ("red", "green", "blue"))
        return observation, -distance, terminated, truncated or lost, {**info, "success": distance < NEAR}


gymnasium.register("ReachBlock-v0", entry_point=ReachBlock, max_episode_steps=60)
