"""What an agent's encoder sees of a simulation is what a dataset would have recorded of it."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from own_environments import AnotherSlider

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.cameras.tracking_frame import TrackingFrame, to_tracking_frame
from nerf_rl.errors import UserError
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.rl.environments.observation import LatentObservation
from nerf_rl.scenes.make import make_scene

SIZE = 64


@pytest.mark.parametrize(
    "name, closeness, quality",
    [
        ("datasets/scenes/blocks.xml", 3.0, "fast"),
        ("gym/HalfCheetah-v5", 1.0, "fast"),
        ("metaworld/drawer-open-v3", 1.0, "fast"),
        ("metaworld/drawer-open-v3", 1.0, "smooth"),
    ],
)
def test_the_encoder_sees_after_each_step_what_a_dataset_records(name: str, closeness: float, quality: str):
    scene = make_scene(name)
    scene.env.reset(seed=1)
    rig = make_rig(RigConfig(), SIZE, scene)
    intrinsics = rig.intrinsics * np.array([closeness, closeness, 1.0])[:, None]  # to see the last substep's way
    start = scene.render_data()
    poses = to_tracking_frame(rig.poses(start, np.random.default_rng(0)), rig.origin(start))
    assert (rig.tracking_frame is not None) == name.startswith("gym/")
    encoder_rig = EncoderRig(rig.names, intrinsics, poses, SIZE, SIZE, rig.tracking_frame)
    encoder = Encoder(EncoderConfig(latent=4, patch=8, channels=[8], hidden=8), encoder_rig)
    encoder.quality, encoder.pixels_per_metre = quality, rig.pixels_per_metre(scene.render_data())
    env = LatentObservation(scene.env, encoder.eval())
    env.reset(seed=1)
    recorder = MultiViewRenderer(scene.model, SIZE, SIZE, len(rig.names), quality, encoder.pixels_per_metre)
    propagated = mujoco.MjData(scene.model)
    rng = np.random.default_rng(2)
    lagging = 0
    for _ in range(6):
        assert scene.env.action_space.shape is not None
        env.step(rng.uniform(-1, 1, scene.env.action_space.shape).astype(np.float32))
        shown = scene.render_data()
        poses = rig.poses(shown, rng)
        recorded = recorder.render(shown, intrinsics, poses).rgb
        np.testing.assert_array_equal(env.last_images, recorded)
        propagated.qpos[:], propagated.qvel[:] = scene.data.qpos, scene.data.qvel
        propagated.mocap_pos[:], propagated.mocap_quat[:] = scene.data.mocap_pos, scene.data.mocap_quat
        mujoco.mj_forward(scene.model, propagated)
        np.testing.assert_array_equal(env.last_images, recorder.render_rgb(propagated, intrinsics, poses))
        lagging += not np.array_equal(env.last_images, recorder.render_rgb(scene.data, intrinsics, poses))
    assert lagging == (0 if name.startswith("metaworld/") else 6)  # Meta-World propagates positions itself
    recorder.close()
    env.close()


def test_after_its_first_look_an_agent_has_the_encoders_latents_to_the_last_bit_without_its_python(tiny_encoder: Path):
    scene = make_scene("metaworld/drawer-open-v3")
    looking, reference = Encoder.load(tiny_encoder), Encoder.load(tiny_encoder)
    assert reference.landmarks is not None
    env = LatentObservation(scene.env, looking)
    env.reset(seed=1)
    looking.forward = None  # type: ignore[assignment]
    rng, latents = np.random.default_rng(0), []
    for _ in range(5):
        env.step(rng.uniform(-1, 1, 4).astype(np.float32))
        latents.append(env.last_latent)
        expected = reference.encode(torch.from_numpy(env.last_images)[None])[0]
        np.testing.assert_array_equal(env.last_latent, expected.numpy())
    assert len(np.unique(latents, axis=0)) == 5
    with torch.no_grad():
        for module in (looking, reference):
            module.merged[-1].bias.add_(1.0)
    for encoder in (reference, reference.untrained()):  # its weights have changed; it is another one
        env.encoder = looking if encoder is reference else encoder
        np.testing.assert_array_equal(env.look(), encoder.encode(torch.from_numpy(env.last_images)[None]))
        assert np.abs(env.look()[0].numpy() - latents[-1]).max() > 0.1
    env.close()


def test_cameras_go_with_the_body_that_the_artefact_names():
    """However far the robot has come, its encoder sees it where it was; one that stands still does not see it."""
    scene = make_scene("gym/HalfCheetah-v5")
    rig = make_rig(RigConfig(), SIZE, scene)
    start = scene.render_data()
    poses = to_tracking_frame(rig.poses(start, np.random.default_rng(0)), rig.origin(start))
    seen = []
    for frame in (rig.tracking_frame, None):
        encoder_rig = EncoderRig(rig.names, rig.intrinsics, poses, SIZE, SIZE, frame)
        encoder = Encoder(EncoderConfig(latent=4, patch=8, channels=[8], hidden=8), encoder_rig)
        env = LatentObservation(scene.env, encoder.eval())
        env.reset(seed=0)
        for way in (0.0, 8.0):  # whole squares of the floor's pattern
            scene.data.qpos[0] = way
            env.observation(np.zeros(17))
            seen.append(env.last_images.astype(np.int64))
        env._renderer.close()  # type: ignore[union-attr]
    assert np.abs(seen[0] - seen[1]).mean() < 3.0 < np.abs(seen[2] - seen[3]).mean()
    np.testing.assert_array_equal(seen[0], seen[2])


@pytest.mark.parametrize("frame", [None, TrackingFrame("cart")])
def test_an_environment_that_compiles_its_model_anew_is_seen_as_it_is_then(frame: TrackingFrame | None):
    poses = look_at(np.zeros(3), 1.0, 30.0, -30.0)[None]
    rig = EncoderRig(("view",), intrinsics_from_fovy(45.0, SIZE, SIZE)[None], poses, SIZE, SIZE, frame)
    encoder = Encoder(EncoderConfig(latent=4, patch=8, channels=[8], hidden=8), rig).eval()
    seen = []
    for seeds in ((0, 2, 0), (2,)):
        env = LatentObservation(AnotherSlider(), encoder)
        for seed in seeds:
            env.reset(seed=seed)
            seen.append(env.last_images)
        env.close()
    small, large, again, fresh = seen
    np.testing.assert_array_equal(large, fresh)
    np.testing.assert_array_equal(small, again)
    assert (small != large).any(-1).mean() > 0.05


def test_what_a_scene_shows_is_of_the_model_that_it_has_now():
    scene = make_scene("gym/own_environments:Slider-v0")
    scene.env.reset(seed=0)
    before = scene.render_data().xpos
    env: Any = scene.env.unwrapped
    env.model = mujoco.MjModel.from_xml_string(env.XML.replace('<body name="cart">', '<body name="cart" pos="0 0 1">'))
    env.data = mujoco.MjData(env.model)
    np.testing.assert_allclose(scene.render_data().xpos - before, [[0, 0, 0], [0, 0, 1]])


def test_a_body_that_the_scene_does_not_have_is_told_with_those_that_it_has():
    scene = make_scene("gym/HalfCheetah-v5")
    rig = make_rig(RigConfig(), SIZE, scene)
    poses = rig.poses(scene.render_data(), np.random.default_rng(0))
    strange = EncoderRig(rig.names, rig.intrinsics, poses, SIZE, SIZE, TrackingFrame("trunk"))
    encoder = Encoder(EncoderConfig(latent=4, patch=8, channels=[8], hidden=8), strange)
    with pytest.raises(UserError, match=r"unknown body of the encoder's cameras 'trunk'.*available: .*torso"):
        LatentObservation(scene.env, encoder)
