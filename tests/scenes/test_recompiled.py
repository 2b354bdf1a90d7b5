"""Environments that compile their model anew at each reset, of the same parts: what is made for one draws all."""

import copy
from pathlib import Path

import mujoco
import numpy as np
import pytest
from own_environments import RECOMPILED_SLIDER, RecompiledSlider
from tiny_recipes import TINY_DATASET

from nerf_rl import cli
from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.cameras.rig_config import RigConfig
from nerf_rl.files.json_files import read_json
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.rendering.rigs import make_rig
from nerf_rl.rl.environments import observation
from nerf_rl.rl.environments.observation import LatentObservation
from nerf_rl.scenes.make import make_scene
from nerf_rl.scenes.render_data import RenderData

SIZE = 32
WEDGE = '<mesh name="wedge" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'


def test_what_was_made_for_one_model_draws_the_next():
    scene = make_scene(RECOMPILED_SLIDER)
    assert scene.privileged_names[-3:] == ("post_x", "post_y", "post_z")
    rig = make_rig(RigConfig(), SIZE, scene)
    cameras = rig.intrinsics, rig.poses(scene.render_data(), np.random.default_rng(0))
    drawn = scene.drawn_model
    renderer = MultiViewRenderer(drawn, SIZE, SIZE, len(rig.names), "plain")
    seen = []
    for seed in (3, 4, 5):
        scene.env.reset(seed=seed)
        seen.append(renderer.render(scene.render_data(), *cameras))
        assert scene.drawn_model is drawn is not scene.model
        fresh = MultiViewRenderer(scene.model, SIZE, SIZE, len(rig.names), "plain")
        other = fresh.render(RenderData(scene.env).now(), *cameras)
        fresh.close()
        np.testing.assert_array_equal(seen[-1].geom, other.geom)
        hit = other.geom >= 0  # behind, depth is the far plane's, which a model's extent decides
        np.testing.assert_allclose(seen[-1].depth[hit], other.depth[hit], rtol=1e-3)
        assert (np.abs(seen[-1].rgb.astype(int) - other.rgb) > 8).mean() < 0.01
        np.testing.assert_allclose(scene.privileged(None)[-3:], scene.model.body("post").pos)
    renderer.close()
    assert (seen[0].geom != seen[1].geom).any() and (seen[1].rgb != seen[2].rgb).any()


def test_a_polygon_without_an_area_makes_no_other_model():
    """The normals of such polygons, which robosuite's meshes have, are no numbers, and those are never equal."""
    env, drawn = RecompiledSlider(), []
    env.XML = env.XML.replace("<worldbody>", f"<asset>{WEDGE}</asset><worldbody>")
    env.reset(seed=0)
    shown = RenderData(env)
    for seed in (1, 2, 3):
        env.reset(seed=seed)
        env.model.mesh_polynormal[0] = np.nan
        drawn.append(shown.model)
    assert drawn[1] is drawn[2] is not env.model
    env.model.mesh_vert[0] += 0.1
    env.model, env.data = copy.deepcopy(env.model), env.data
    assert shown.model is env.model


def test_what_is_painted_or_whose_ground_is_otherwise_is_the_same_model():
    env, rng = RecompiledSlider(), np.random.default_rng(0)
    assets = (
        '<texture name="paper" type="2d" builtin="flat" width="8" height="8"/><hfield name="ground" nrow="4" ncol="4" '
    )
    env.XML = env.XML.replace("<worldbody>", f'<asset>{assets}size="1 1 .1 .1"/></asset><worldbody>')
    env.reset(seed=0)
    shown, drawn = RenderData(env), []
    for seed in (1, 2, 3):
        env.reset(seed=seed)
        env.model.tex_data[:] = rng.integers(0, 255, env.model.ntexdata)
        env.model.hfield_data[:] = rng.uniform(size=env.model.nhfielddata)
        env.model.hfield_size[0, 2] = rng.uniform()
        drawn.append(shown.model)
        for name in ("tex_data", "hfield_data", "hfield_size"):
            np.testing.assert_array_equal(getattr(shown.model, name), getattr(env.model, name))
    assert drawn[1] is drawn[2] is not env.model
    env.reset(seed=4)
    env.model.tex_type[0] = mujoco.mjtTexture.mjTEXTURE_CUBE
    assert shown.model is env.model


def test_a_simulation_that_goes_back_to_a_model_is_drawn_as_that():
    """Nothing is written into a model that the environment may still use."""
    env, models = RecompiledSlider(), []
    env.reset(seed=1)
    shown = RenderData(env)
    for seed in (1, 2, 3):
        env.reset(seed=seed)
        models.append((env.model, env.data))
        shown.now()
    for env.model, env.data in (models[0], models[2], models[1]):
        places = shown.now().geom_xpos.copy()
        mujoco.mj_kinematics(env.model, env.data)
        np.testing.assert_allclose(places, env.data.geom_xpos)


def test_a_dataset_is_the_same_with_any_number_of_workers(tmp_path: Path):
    recipe = TINY_DATASET.replace("metaworld/drawer-open-v3", RECOMPILED_SLIDER)
    (tmp_path / "data.yaml").write_text(recipe.partition("rig:")[0] + "episodes_per_shard: 1\n")
    shards = []
    for workers in ("1", "2"):
        out = tmp_path / workers
        words = ["gen-dataset", "--config", str(tmp_path / "data.yaml"), "--out", str(out), "--workers", workers]
        assert cli.main(words) == 0
        shards.append(read_json(out / "manifest.json")["shards"])
    assert len(shards[0]) == 4 and shards[0] == shards[1]


def test_an_agent_sees_each_model_through_one_renderer(monkeypatch: pytest.MonkeyPatch):
    poses = look_at(np.zeros(3), 2.0, 30.0, -30.0)[None]
    rig = EncoderRig(("view",), intrinsics_from_fovy(45.0, SIZE, SIZE)[None], poses, SIZE, SIZE)
    encoder = Encoder(EncoderConfig(latent=4, patch=8, channels=[8], hidden=8), rig).eval()
    made = []

    class Counted(MultiViewRenderer):
        def __init__(self, *words, **keys) -> None:
            super().__init__(*words, **keys)
            made.append(self)

    monkeypatch.setattr(observation, "MultiViewRenderer", Counted)
    seen = []
    for seeds in ((1, 2, 3, 4), (4,)):
        env = LatentObservation(RecompiledSlider(), encoder)
        for seed in seeds:
            env.reset(seed=seed)
            seen.append(env.last_images)
        env.close()
    assert len(made) <= 2 + 1  # the first model's, the one that stays, and that of the second environment
    assert (np.abs(seen[3].astype(int) - seen[4]) > 8).mean() < 0.01
    assert (seen[0] != seen[1]).any() and (seen[1] != seen[2]).any() and (seen[2] != seen[3]).any()
