"""What an agent's encoder sees of a simulation is what a dataset would have recorded of it."""

import mujoco
import numpy as np
import pytest

from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.rl.environments.observation import LatentObservation
from nerf_rl.scenes.make import make_scene

SIZE = 64


@pytest.mark.parametrize(
    "name, closeness",
    [("datasets/scenes/blocks.xml", 3.0), ("gym/HalfCheetah-v5", 1.0), ("metaworld/drawer-open-v3", 1.0)],
)
def test_the_encoder_sees_after_each_step_what_a_dataset_records(name: str, closeness: float):
    scene = make_scene(name)
    scene.env.reset(seed=1)
    rig = make_rig(RigConfig(), SIZE, scene)
    intrinsics = rig.intrinsics * np.array([closeness, closeness, 1.0])[:, None]  # to see the last substep's way
    poses = rig.poses(scene.render_data(), np.random.default_rng(0))
    encoder = Encoder(
        EncoderConfig(latent=4, patch=8, channels=[8], hidden=8), EncoderRig(rig.names, intrinsics, poses, SIZE, SIZE)
    )
    encoder.detail = rig.detail(scene.render_data())
    env = LatentObservation(scene.env, encoder.eval())
    env.reset(seed=1)
    recorder = MultiViewRenderer(scene.model, SIZE, SIZE, len(rig.names), "fast", encoder.detail)
    propagated = mujoco.MjData(scene.model)
    rng = np.random.default_rng(2)
    lagging = 0
    for _ in range(6):
        assert scene.env.action_space.shape is not None
        env.step(rng.uniform(-1, 1, scene.env.action_space.shape).astype(np.float32))
        recorded = recorder.render(scene.render_data(), intrinsics, poses).rgb
        np.testing.assert_array_equal(env.last_images, recorded)
        propagated.qpos[:], propagated.qvel[:] = scene.data.qpos, scene.data.qvel
        propagated.mocap_pos[:], propagated.mocap_quat[:] = scene.data.mocap_pos, scene.data.mocap_quat
        mujoco.mj_forward(scene.model, propagated)
        np.testing.assert_array_equal(env.last_images, recorder.render_rgb(propagated, intrinsics, poses))
        lagging += not np.array_equal(env.last_images, recorder.render_rgb(scene.data, intrinsics, poses))
    assert lagging == (0 if name.startswith("metaworld/") else 6)  # Meta-World propagates positions itself
    recorder.close()
    env.close()
