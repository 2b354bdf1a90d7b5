"""Environments of one's own: registered with Gymnasium, of the examples and of this file, and tiny encoders of them."""

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from tiny_recipes import TINY_DATASET, TINY_PRETRAINING, TINY_TRAINING

from nerf_rl import cli

ROOT = Path(__file__).parents[1]
RECIPE = str(ROOT / "rl" / "gym.yaml")
CAMERAS = "rig: {encoder: [view_0, view_1], test: [view_2], random: {count: 1}}\n"
BLOCK = "gym/reach_block:ReachBlock-v0"
DM_CONTROL = "gym/shimmy:dm_control/cartpole-balance-v0"
with_dm_control = pytest.mark.skipif(find_spec("shimmy") is None, reason="needs the extra dm_control")


class Slider(gymnasium.Env):
    """A mass on a rail that has to come to a goal; the observation is a goal environment's dictionary."""

    XML = """<mujoco><worldbody><geom type="plane" size="1 1 0.1"/><body name="cart"><joint name="rail" type="slide"
    axis="1 0 0" damping="1"/><geom size="0.05"/></body></worldbody><actuator><motor joint="rail" gear="3"
    ctrlrange="-2 2" ctrllimited="true"/></actuator></mujoco>"""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(self.XML)
        self.data = mujoco.MjData(self.model)
        self.action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,), np.float32)
        parts = {"observation": 2, "achieved_goal": 1, "desired_goal": 1}
        boxes = {name: gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float64) for name, size in parts.items()}
        self.observation_space = gymnasium.spaces.Dict(boxes)
        self.goal = np.zeros(1)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Any], dict]:
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        self.goal = self.np_random.uniform(-0.3, 0.3, 1)
        return self._get_obs(), {}

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict]:
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, 10)
        reward = self.compute_reward(self.data.qpos, self.goal, {})
        return self._get_obs(), reward, False, False, {"is_success": np.float32(reward == 0.0)}

    def compute_reward(self, achieved: np.ndarray, desired: np.ndarray, info: dict) -> float:
        """Take one goal at a time, as an environment may."""
        assert achieved.shape == desired.shape == (1,)
        return -float(abs(achieved - desired)[0] > 0.05)

    def _get_obs(self) -> dict[str, Any]:
        state = np.concatenate([self.data.qpos, self.data.qvel])
        return {"observation": state, "achieved_goal": self.data.qpos.copy(), "desired_goal": self.goal.copy()}


class NamedGoalSlider(Slider):
    """Its goals are dictionaries with a goal for each thing, as those of Gymnasium-Robotics' FrankaKitchen are."""

    def __init__(self) -> None:
        super().__init__()
        parts = self.observation_space.spaces.items()
        nested = {name: gymnasium.spaces.Dict({"cart": box}) if "goal" in name else box for name, box in parts}
        self.observation_space = gymnasium.spaces.Dict(nested)

    def _get_obs(self) -> dict[str, Any]:
        return {name: {"cart": part} if "goal" in name else part for name, part in super()._get_obs().items()}


class LateSlider(Slider):
    """Its episodes are of different lengths, and tell at their end alone whether they succeeded, which they all do."""

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Any], dict]:
        observation, info = super().reset(seed=seed, options=options)
        self.left = int(self.np_random.integers(3, 9))
        return observation, info

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict]:
        observation, reward, *_ = super().step(action)
        self.left -= 1
        return observation, reward, self.left == 0, False, {} if self.left else {"is_success": True}


class RecompiledSlider(Slider):
    """Its model is compiled anew at each reset, as robosuite's are, with other places, sizes and colours."""

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Any], dict]:
        rng = np.random.default_rng(seed)
        x, y, z = rng.uniform(-0.3, 0.3, 3)
        colour = " ".join(map(str, rng.uniform(0.2, 1.0, 3)))
        post = f'<body name="post" pos="{x} {y} {abs(z)}"><geom size="0.05" rgba="{colour} 1"/></body>'
        xml = self.XML.replace('size="0.05"', f'size="{rng.uniform(0.04, 0.08)}"').replace(
            "</worldbody>", post + "</worldbody>"
        )
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        return super().reset(seed=seed, options=options)


class BreakingSlider(Slider):
    """It gives up after some steps, as dm_control does when a simulation diverges."""

    def __init__(self) -> None:
        super().__init__()
        self.left = 40

    def step(self, action: np.ndarray) -> tuple[dict[str, Any], float, bool, bool, dict]:
        self.left -= 1
        if not self.left:
            raise ArithmeticError("the physics\nis invalid")
        return super().step(action)


class RefusingSlider(Slider):
    """It cannot be made, and does not say why."""

    def __init__(self) -> None:
        assert self.XML == ""


class AnotherSlider(Slider):
    """Its cart is of another size in each episode, for which the model is compiled anew; so is the order of bodies."""

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Any], dict]:
        xml = self.XML.replace("0.05", f"{0.05 * (1 + (seed or 0))}")
        if seed:
            xml = xml.replace('<body name="cart">', '<body name="post" pos="0 0 -9"/><body name="cart">')
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        return super().reset(seed=seed, options=options)


class TargetSlider(Slider):
    """It writes where its targets are into the model, or into the place of a mocap body, and how high its table is."""

    XML = Slider.XML.replace(
        "</worldbody>",
        """<geom name="disc" type="cylinder" size="0.04 0.01" pos="0 0 1"/><geom name="post" size="0.04" pos="0 1 0"/>
        <body name="flag"><body name="cloth"><geom size="0.04"/></body></body>
        <body name="mark" mocap="true"><geom size="0.04"/></body>
        <body name="lead" mocap="true"><geom size="0.04"/></body>
        <body name="table" pos="0 0 -1"><geom type="box" size="2 2 0.1"/></body>
        <body name="shelf" pos="0 1 0"><geom type="box" size="0.1 0.1 0.1"/></body></worldbody>
        <equality><weld body1="lead" body2="cart"/></equality>""",
    )
    PLACED = ("disc", "flag", "mark")

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Any], dict]:
        observation, info = super().reset(seed=seed, options=options)
        self.places = self.np_random.uniform([-0.5, -0.5, 0.0], 0.5, (3, 3))
        self.model.geom("disc").pos, self.model.body("flag").pos, self.data.mocap_pos[0] = self.places
        self.data.mocap_pos[1] = self.np_random.uniform(-0.1, 0.1, 3)
        self.model.body("table").pos[2] = self.np_random.uniform(-1.1, -1.0)
        return observation, info


class LensSlider(Slider):
    """It has cameras, one of which its resets move, or let look at a wider or narrower angle."""

    XML = Slider.XML.replace(
        "</worldbody>", '<camera name="still" pos="0 0 2"/><camera name="lens" pos="0 0.5 2"/></worldbody>'
    )

    def __init__(self, zooms: bool) -> None:
        super().__init__()
        self.zooms = zooms

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Any], dict]:
        camera, rng = self.model.camera("lens"), np.random.default_rng(seed)
        if self.zooms:
            camera.fovy[:] = rng.uniform(30, 60)
        else:
            camera.pos[2] = rng.uniform(1.5, 2.0)
        return super().reset(seed=seed, options=options)


gymnasium.register("TargetSlider-v0", entry_point=TargetSlider, max_episode_steps=20)
gymnasium.register("RecompiledSlider-v0", entry_point=RecompiledSlider, max_episode_steps=20)
gymnasium.register("BreakingSlider-v0", entry_point=BreakingSlider, max_episode_steps=20)
gymnasium.register("RefusingSlider-v0", entry_point=RefusingSlider)
gymnasium.register("AnotherSlider-v0", entry_point=AnotherSlider, max_episode_steps=20)
gymnasium.register("Slider-v0", entry_point=Slider, max_episode_steps=20)
gymnasium.register("NamedGoalSlider-v0", entry_point=NamedGoalSlider, max_episode_steps=20)
gymnasium.register("LateSlider-v0", entry_point=LateSlider, max_episode_steps=20)
gymnasium.register("MovedLensSlider-v0", entry_point=LensSlider, max_episode_steps=20, kwargs={"zooms": False})
gymnasium.register("ZoomedLensSlider-v0", entry_point=LensSlider, max_episode_steps=20, kwargs={"zooms": True})
SLIDER, NAMED_GOAL_SLIDER = "gym/own_environments:Slider-v0", "gym/own_environments:NamedGoalSlider-v0"
TARGET_SLIDER = "gym/own_environments:TargetSlider-v0"
RECOMPILED_SLIDER = "gym/own_environments:RecompiledSlider-v0"
BREAKING_SLIDER = "gym/own_environments:BreakingSlider-v0"
ANOTHER_SLIDER = "gym/own_environments:AnotherSlider-v0"
LATE_SLIDER = "gym/own_environments:LateSlider-v0"


def train(out: Path, *arguments: str) -> int:
    return cli.main(["train-rl", "--config", RECIPE, "--out", str(out), *TINY_TRAINING, *arguments])


def make_encoder(scene: str, folder: Path) -> Path:
    """Return a tiny encoder of a scene, made in a folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "examples"))
        before, _, after = TINY_DATASET.partition("rig:")
        rest = after[after.index("validation_fraction") :]
        (folder / "data.yaml").write_text(before.replace("metaworld/drawer-open-v3", scene) + CAMERAS + rest)
        (folder / "pretrain.yaml").write_text(TINY_PRETRAINING)
        data, encoder = folder / "data", folder / "encoder"
        assert cli.main(["gen-dataset", "--config", str(folder / "data.yaml"), "--out", str(data)]) == 0
        words = ["--config", str(folder / "pretrain.yaml"), "--data", str(data), "--out", str(encoder)]
        assert cli.main(["pretrain", *words]) == 0
    return encoder
