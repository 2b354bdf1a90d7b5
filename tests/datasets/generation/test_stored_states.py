"""Replaying states: of a dataset and of NumPy archives."""

import io
import shutil
from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.config import BehaviourConfig, GenDatasetConfig
from nerf_rl.datasets.generation.stored_states import open_states
from nerf_rl.datasets.storage.plan import command_keys, plan_of, same_content
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.scenes.make import make_scene

BLOCKS = "datasets/scenes/blocks.xml"
SAME = ("rgb", "depth", "semantic", "state/qpos", "state/proprio", "state/privileged", "state/action", "reward", "step")


def generate(out: Path, *arguments: str) -> MultiViewDataset:
    assert cli.main(["gen-dataset", "--out", str(out), "--workers", "1", *arguments]) == 0
    return MultiViewDataset(out)


def replay(source: Path, episodes: int, frames: int) -> list[str]:
    mixture = [
        "--behaviour.random",
        "0",
        "--behaviour.scripted",
        "0",
        "--behaviour.noisy",
        "0",
        "--behaviour.replay",
        "1",
    ]
    sizes = ["--episodes", str(episodes), "--frames_per_episode", str(frames), "--episode_steps", str(frames - 1)]
    return [*mixture, *sizes, "--behaviour.states", str(source)]


def test_a_replayed_dataset_shows_what_the_first_one_showed(tiny_dataset: Path, tiny_recipe: Path, tmp_path: Path):
    first = MultiViewDataset(tiny_dataset)
    cameras = ["--config", str(tiny_recipe), "--rig.random.count", "0"]
    again = generate(tmp_path / "again", *cameras, *replay(tiny_dataset, 4, 3))
    frames = np.arange(len(first))
    assert len(again) == len(first)
    for name in SAME:
        before, after = first.read(name, frames), again.read(name, frames)
        if name in ("rgb", "depth", "semantic"):
            before = before[:, : after.shape[1]]  # without the random camera
        np.testing.assert_allclose(after, before, atol=1e-6, err_msg=name)


def test_an_archive_of_positions_is_rendered_as_it_is(tmp_path: Path):
    scene = make_scene(BLOCKS)
    rng = np.random.default_rng(0)
    qpos = []
    for seed in range(2):
        scene.env.reset(seed=seed)
        for _ in range(4):
            scene.env.step(rng.uniform(-1, 1, 6).astype(np.float32))
            qpos.append(scene.data.qpos.copy())
    np.savez(tmp_path / "states.npz", qpos=np.reshape(qpos, (2, 4, -1)))
    dataset = generate(tmp_path / "data", "--scene", BLOCKS, "--size", "24", *replay(tmp_path / "states.npz", 2, 4))
    np.testing.assert_array_equal(dataset.read("state/qpos", np.arange(8)), qpos)
    assert dataset.read("step", np.arange(8)).tolist() == [0, 1, 2, 3, 0, 1, 2, 3]
    assert not dataset.read("reward", np.arange(8)).any()


def test_a_replay_goes_on_with_the_same_states_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    source, out = tmp_path / "states.npz", tmp_path / "data"
    qpos = np.tile(make_scene(BLOCKS).data.qpos, (2, 2, 1))
    np.savez(source, qpos=qpos)
    states = source.read_bytes()
    keys = ["--scene", BLOCKS, "--size", "16", "--episodes_per_shard", "1", *replay(source, 2, 2)]
    command = ["gen-dataset", "--workers", "1", "--out", str(out), *keys]
    for part in ("1/2", "2/2"):
        assert cli.main([*command, "--shard", part]) == 0
    assert cli.main(["merge", str(out)]) == 0 and cli.main(["check", str(out)]) == 0
    whole = {path.name: path.read_bytes() for path in (out / "shards").iterdir()}
    lost = out / "shards" / "000001.h5"

    np.savez(source, qpos=qpos + 1e-3)
    lost.unlink()
    capsys.readouterr()
    assert cli.main([*command, "--resume", "true"]) == 2
    said = capsys.readouterr().err
    assert f"with other states in {source} (what differs: states_sha256); use the same one" in said
    assert said.count("\n") == 1
    assert cli.main(["check", str(out), "--repair", "true"]) == 1
    assert f"{source} holds other states than it did" in capsys.readouterr().err and not lost.exists()

    source.write_bytes(states)
    for words in (["check", str(out), "--repair", "true"], [*command, "--resume", "true"]):
        lost.unlink(missing_ok=True)
        assert cli.main(words) == 0
        assert {path.name: path.read_bytes() for path in (out / "shards").iterdir()} == whole


def test_the_content_of_a_replayed_dataset_counts_and_that_of_older_plans_is_not_asked_for(
    tiny_dataset: Path, tmp_path: Path
):
    config = GenDatasetConfig("", behaviour=BehaviourConfig(replay=1.0, states=str(tmp_path / "source")))
    plans = []
    for dataset in (tiny_dataset, generate(tmp_path / "other", "--episodes", "1", "--size", "8").folder):
        (tmp_path / "source").unlink(missing_ok=True)
        (tmp_path / "source").symlink_to(dataset)
        plans.append(plan_of(config))
    older = config.content()
    assert not same_content(*plans) and same_content(plans[0], older) and same_content(older, plans[1])
    assert command_keys(plans[0]) == older
    assert plan_of(GenDatasetConfig("")) == GenDatasetConfig("").content()


@pytest.mark.parametrize(
    "arrays, words",
    [
        ({"qvel": np.zeros((3, 24))}, "has no array qpos"),
        ({"qpos": np.zeros((3, 5))}, r"qpos in .* has shape \(1, 3, 5\), the model needs \[T, 27\]"),
        ({"qpos": np.full((3, 27), np.nan)}, "qpos in .* holds values that are not finite"),
        ({"qpos": np.zeros((3, 27)), "qvel": np.zeros((4, 24))}, "differ in their numbers of episodes or steps"),
        ({"qpos": np.array([None] * 3)}, "not a source of states: .*pickle"),
    ],
)
def test_archives_that_do_not_fit_are_refused_in_a_sentence(arrays: dict, words: str, tmp_path: Path):
    np.savez(tmp_path / "states.npz", **arrays)
    with pytest.raises(UserError, match=words):
        open_states(tmp_path / "states.npz", make_scene(BLOCKS))


def stored(compressed: bool = False) -> bytes:
    """Return an archive of positions."""
    qpos = np.random.default_rng(0).random((9, 27))
    (np.savez_compressed if compressed else np.savez)(into := io.BytesIO(), qpos=qpos)
    return into.getvalue()


def single_array() -> bytes:
    """Return what an .npy file holds."""
    np.save(into := io.BytesIO(), np.zeros((3, 27)))
    return into.getvalue()


@pytest.mark.parametrize(
    "content, words",
    [
        (stored()[:-40], "not a zip file"),
        (b"", "No data left in file"),
        (single_array(), "it holds a single array, as .npy files do"),
        (stored(compressed=True)[:200] + bytes([255] * 8) + stored(compressed=True)[208:], "while decompressing data"),
        (b"garbage", "pickle"),
    ],
)
def test_a_damaged_archive_is_refused_in_a_sentence(
    content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "states.npz").write_bytes(content)
    keys = ["--scene", BLOCKS, *replay(tmp_path / "states.npz", 1, 2)]
    assert cli.main(["gen-dataset", "--out", str(tmp_path / "out"), *keys]) == 2
    said = capsys.readouterr().err
    assert words in said and "states.npz is not a source of states" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_dataset_of_another_model_is_refused(tiny_dataset: Path):
    with pytest.raises(UserError, match=r"belong to another model than datasets/scenes/blocks\.xml"):
        open_states(tiny_dataset, make_scene(BLOCKS))


def test_what_is_neither_dataset_nor_archive_is_refused(tmp_path: Path):
    with pytest.raises(
        UserError, match=r"neither a dataset nor an \.npz file; give --behaviour\.states one of the two"
    ):
        open_states(tmp_path, make_scene(BLOCKS))


def test_a_dataset_that_is_not_finished_is_refused_as_such(tiny_dataset: Path, tmp_path: Path):
    begun = shutil.copytree(tiny_dataset, tmp_path / "begun")
    (begun / "manifest.json").rename(begun / "unfinished.json")
    with pytest.raises(UserError, match="a dataset that is not finished; complete it by gen-dataset --resume true"):
        open_states(begun, make_scene(BLOCKS))


def test_too_short_a_source_is_told_with_the_length_it_has(
    tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = ["--out", str(tmp_path / "x"), *replay(tiny_dataset, 4, 5)]
    assert cli.main(["gen-dataset", *arguments]) == 2
    assert (
        "has an episode of 3 states, too few for --episode_steps 4; lower that to at most 2" in capsys.readouterr().err
    )


def test_a_replay_without_a_source_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["gen-dataset", "--out", str(tmp_path / "x"), "--behaviour.replay", "1"]) == 2
    assert "give both" in capsys.readouterr().err


def test_what_is_replayed_changes_no_other_episode(tmp_path: Path):
    """A post that no joint moves stands elsewhere in the states than in the file, whose resets do not put it back."""
    scene = tmp_path / "scene.xml"
    text = """<mujoco><worldbody><light pos="0 0 2"/><geom type="plane" size="2 2 0.1"/>
<body name="post" pos="{} 0 0.1"><geom size="0.05"/></body>
<body pos="0 0 0.2"><joint name="rail" type="slide" axis="0 1 0" range="-1 1"/><geom size="0.05"/></body></worldbody>
<actuator><motor joint="rail" ctrlrange="-1 1"/></actuator></mujoco>"""
    keys = ["--scene", str(scene), "--size", "16", "--episodes_per_shard", "1", "--episode_steps", "2"]
    keys += ["--frames_per_episode", "3"]
    scene.write_text(text.format(0.4))
    states = generate(tmp_path / "states", *keys, "--episodes", "2").read("state/qpos").reshape(2, 1, 3)
    scene.write_text(text.format(-0.4))
    mixed = ["--behaviour.random", "0.5", "--behaviour.replay", "0.5", "--behaviour.scripted", "0"]
    mixed += [
        "--behaviour.noisy",
        "0",
        "--behaviour.states",
        str(tmp_path / "states"),
        "--episodes",
        "8",
        "--seed",
        "1",
    ]
    dataset = generate(tmp_path / "mixed", *keys, *mixed)
    replayed = (dataset.read("state/qpos").reshape(1, 8, 3) == states).all(2).any(0)
    assert 1 <= replayed.sum() <= 7 and (np.diff(replayed.astype(int)) < 0).any(), "others come after them"
    places = dataset.read("state/body_pos")[:, 1, 0].reshape(8, 3)
    np.testing.assert_allclose(places, np.where(replayed, 0.4, -0.4)[:, None].repeat(3, 1))
