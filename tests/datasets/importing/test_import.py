"""Nerfstudio scenes as datasets: what was exported comes back, and real cameras' pictures are taken as they are."""

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from captures import HEIGHT, TINY, WIDTH, read, write_capture

from nerf_rl import cli
from nerf_rl.cameras.geometry import look_from, pixel_centres, pixel_directions, project, projection_matrix
from nerf_rl.datasets.export.picture_names import picture_names
from nerf_rl.datasets.importing import importer
from nerf_rl.datasets.importing.frame_rows import shrunk_colours
from nerf_rl.datasets.importing.nerfstudio.lens import Lens, unbend
from nerf_rl.datasets.importing.nerfstudio.lens import shown as lens_shows
from nerf_rl.datasets.storage.frames import read_frame
from nerf_rl.datasets.storage.point_cloud import fuse_views
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.shards import MANIFEST, SHARDS, UNFINISHED

PRETRAIN = Path(__file__).parents[3] / "pretrain"


@pytest.fixture(scope="module")
def original(tiny_dataset: Path) -> MultiViewDataset:
    return MultiViewDataset(tiny_dataset)


@pytest.fixture(scope="module")
def scenes(tiny_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scenes") / "out"
    assert cli.main(["export", str(tiny_dataset), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def imported(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    return read(scenes, tmp_path_factory.mktemp("imported") / "out", "--empty_depth", "nothing")


def order_of(original: MultiViewDataset, imported: MultiViewDataset) -> list[int]:
    """Return the positions of the imported cameras among the original ones."""
    return [original.camera_names.index(name) for name in imported.camera_names]


def test_an_export_comes_back_as_it_was(original: MultiViewDataset, imported: MultiViewDataset):
    views, frames = order_of(original, imported), np.arange(len(original))
    assert len(imported) == len(original) and imported.absent == ("state",)
    for name in ("rgb", "semantic"):
        np.testing.assert_array_equal(imported.read(name), original.read(name)[:, views])
    for name in ("episode", "step", "split"):
        np.testing.assert_array_equal(imported.read(name), original.read(name))
    assert imported.class_names == original.class_names
    np.testing.assert_array_equal(imported.palette, original.palette)
    for mine, theirs in zip(imported.cameras(frames), original.cameras(frames), strict=True):
        np.testing.assert_allclose(mine, theirs[views] if mine.ndim == 3 else theirs[:, views], atol=1e-6)
    np.testing.assert_allclose(imported.projections(frames), original.projections(frames)[:, views], atol=1e-4)
    roles = {camera["name"]: camera["role"] for camera in original.manifest["cameras"]}
    assert {camera["name"]: camera["role"] for camera in imported.manifest["cameras"]} == roles
    depth, truth = imported.read("depth"), original.read("depth")[:, views]
    hit = truth < 0.999 * original.manifest["far"]
    assert 0 < hit.mean() < 1
    np.testing.assert_allclose(depth[hit], truth[hit], atol=0.00051)  # whole millimetres
    np.testing.assert_array_equal(depth[~hit], imported.manifest["far"])
    assert imported.read_valid([0]) is None


def test_what_is_unknown_does_not_count_unless_it_is_said_to_be_nothing(
    original: MultiViewDataset, scenes: Path, tmp_path: Path
):
    imported = read(scenes, tmp_path / "out")
    views = order_of(original, imported)
    hit = original.read("depth")[:, views] < 0.999 * original.manifest["far"]
    np.testing.assert_array_equal(imported.read_valid(np.arange(len(imported))), hit)


def test_masks_say_what_counts(original: MultiViewDataset, tmp_path: Path):
    command = ["export", str(original.folder), "--out", str(tmp_path / "scenes"), "--exclude", "[robot]"]
    assert cli.main(command) == 0
    imported = read(tmp_path / "scenes", tmp_path / "out", "--empty_depth", "nothing")
    robot = original.read("semantic")[:, order_of(original, imported)] == original.class_names.index("robot")
    assert robot.any()
    np.testing.assert_array_equal(imported.read_valid(np.arange(len(imported))), ~robot)
    frame = read_frame(imported, 0)
    reach, everything = 0.999 * frame.far, range(len(imported.class_names))
    cloud = fuse_views(frame, "RGB", imported.palette, (0.0, 1.0), everything, reach)
    assert len(cloud.points) == ((frame.depth < reach) & ~robot[0]).sum()
    assert cli.main(["export", str(imported.folder), "--out", str(tmp_path / "again")]) == 0
    back = read(tmp_path / "again", tmp_path / "back", "--empty_depth", "nothing")
    np.testing.assert_array_equal(back.read_valid(np.arange(len(back))), ~robot)


def test_rays_are_drawn_from_pixels_that_count(original: MultiViewDataset, tmp_path: Path):
    from nerf_rl.pretrain.config import PretrainConfig
    from nerf_rl.pretrain.data.batches import RayBatches
    from nerf_rl.pretrain.data.statistics import measure

    command = ["export", str(original.folder), "--out", str(tmp_path / "scenes"), "--exclude", "[robot]"]
    assert cli.main(command) == 0
    robot = original.class_names.index("robot")
    shares = []
    for keys in ([], ["--empty_depth", "nothing"]):
        dataset = read(tmp_path / "scenes", tmp_path / f"out{len(keys)}", *keys)
        config = PretrainConfig(data="", out="", scenes_per_step=4, rays_per_scene=256)
        statistics = measure(dataset, config)
        batch = RayBatches(dataset, config, statistics)[0]
        assert not (batch.semantic == robot).any()
        shares.append(float((batch.depth >= statistics.bounds.far).float().mean()))
    assert shares[0] < shares[1]  # of unknown depth, no ray is drawn


def test_a_trained_encoder_needs_no_more_than_the_shipped_recipe(
    imported: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    recipe = ["--config", str(PRETRAIN / "demo.yaml"), *TINY]
    assert cli.main(["pretrain", *recipe, "--data", str(imported.folder), "--out", str(tmp_path / "run")]) == 0
    assert "no true state that varies" in capsys.readouterr().out
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["steps"] == 4 and summary["validation"]["miou"] is not None
    assert summary["validation"]["depth_mae_m"] is not None and summary["probe"] == {}
    picture = ["--png", str(tmp_path / "sheet.png"), "--frames", "2"]
    assert cli.main(["view", str(tmp_path / "run"), *picture]) == 0
    assert cli.main(["view", str(imported.folder), *picture, "--overwrite", "true"]) == 0
    words = ["--encoder", str(tmp_path / "run"), "--data", str(imported.folder)]
    assert cli.main(["probe", *words]) == 2
    assert "has no columns of the true state" in capsys.readouterr().err
    agent = ["--encoder", str(tmp_path / "run"), "--out", str(tmp_path / "agent")]
    assert cli.main(["train-rl", *agent]) == 2
    assert "images that were imported, and no simulator can show it" in capsys.readouterr().err
    assert cli.main(["train-rl", *agent[:2], "--scene", imported.manifest["scene"]["name"], *agent[2:]]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_what_others_wrote_means_what_nerfstudio_means(tmp_path: Path):
    """A point projects where nerfstudio's own formula, with OpenGL's axes, has it."""
    write_capture(tmp_path / "capture", moments=2)
    dataset = read(tmp_path / "capture", tmp_path / "data", "--scale", "2")
    content = json.loads((tmp_path / "capture" / "moment_0" / "transforms.json").read_text())
    point = np.array([0.1, -0.2, 0.15])
    for view, frame in enumerate(content["frames"]):
        local = np.linalg.inv(np.array(frame["transform_matrix"])) @ [*point, 1.0]
        x = 14.5 + 24.0 * local[0] / -local[2]
        y = 9.5 - 25.0 * local[1] / -local[2]
        pixels, depth = project(dataset.projections([0])[0, view], 2 * point[None])  # in metres, twice as far
        np.testing.assert_allclose([*pixels[0], depth[0]], [x, y, -2 * local[2]], atol=1e-9)


def test_smaller_pictures_keep_their_rays(tmp_path: Path):
    write_capture(tmp_path / "capture", moments=2)
    full, small = (read(tmp_path / "capture", tmp_path / f"x{n}", "--shrink", f"{n}") for n in (1, 4))
    assert small.read("rgb").shape[2:] == (HEIGHT // 4, WIDTH // 4, 3)
    (K, poses), (k, _) = full.cameras([0]), small.cameras([0])
    block = full.read("rgb", [0])[0, :, 4:8, 8:12].astype(float).mean((1, 2))
    np.testing.assert_allclose(small.read("rgb", [0])[0, :, 1, 2], block, atol=0.51)
    middle = pixel_directions(K[0], poses[0, 0], np.array([[10.0, 6.0]]))  # of that block
    np.testing.assert_allclose(pixel_directions(k[0], poses[0, 0], np.array([[2.5, 1.5]])), middle)


def test_smaller_pictures_leave_out_what_does_not_count():
    rgb, valid = np.full((1, 8, 8, 3), 200, np.uint8), np.ones((1, 8, 8), bool)
    rgb[:, :, :2], valid[:, :, :2] = 0, False
    assert (shrunk_colours(rgb, 4, valid) == 200).all() and shrunk_colours(rgb, 4)[0, 0, 0].tolist() == [100] * 3
    assert (shrunk_colours(rgb, 2, valid)[:, :, 0] == 0).all(), "where nothing counts it is what it is"


@pytest.mark.parametrize("k1", [0.1, -0.2])
def test_the_rim_of_an_unbent_picture_is_what_it_shows(k1: float):
    lens, K = Lens((k1, 0.0, 0.0, 0.0, 0.0)), np.array([[60.0, 0, 32], [0, 60, 32], [0, 0, 1]])
    maps = lens.maps(K, 64, 64)
    unbent = unbend(np.full((64, 64, 3), 200, np.uint8), maps)
    assert (unbent[lens_shows(maps, 64, 64)] == 200).all() and (unbent[~lens_shows(maps, 64, 64)] == 0).all()
    assert lens_shows(maps, 64, 64).all() == (k1 < 0)


def test_a_bent_picture_becomes_that_of_a_pinhole(tmp_path: Path):
    """Dots that OpenCV projects through the lens lie after the import where the dataset's matrices say."""
    k1, p1 = 0.8, 0.02
    write_capture(tmp_path / "capture", moments=2, k1=k1, p1=p1)
    K, pose = np.array([[24.0, 0, 14.0], [0, 25.0, 9.0], [0, 0, 1]]), look_from(np.array([1.0, 0, 0.6]), np.zeros(3))
    points = np.array([[0.0, 0.45, 0.1], [0.0, -0.43, 0.05], [0.0, 0.0, -0.3]])
    rotation, translation = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
    bent = cv2.projectPoints(points, rotation, translation, K, np.array([k1, 0, p1, 0, 0]))[0][:, 0]  # centres at 0
    for moment in range(2):
        picture = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        row, column = np.mgrid[0:HEIGHT, 0:WIDTH]
        for x, y in bent:
            picture += 250 * np.exp(-((row - y) ** 2 + (column - x) ** 2) / 2)[..., None]
        cv2.imwrite(
            str(tmp_path / "capture" / f"moment_{moment}" / "images" / "a.jpg"),
            picture.round().clip(0, 255).astype(np.uint8),
            [1, 100],
        )
    dataset = read(tmp_path / "capture", tmp_path / "data")
    shown = dataset.read("rgb", [0])[0, 0].astype(float).mean(-1)
    pixels, _ = project(projection_matrix(*[part[0] for part in (dataset.cameras([0])[0], [pose])]), points)
    for x, y in pixels:
        near = (np.abs(pixel_centres(HEIGHT, WIDTH) - [x, y]).max(1) < 3).reshape(HEIGHT, WIDTH)
        weight = shown * near
        row, column = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
        found = [(weight * column).sum() / weight.sum(), (weight * row).sum() / weight.sum()]
        np.testing.assert_allclose(found, [x, y], atol=0.4)
    assert np.abs(bent + 0.5 - pixels).max() > 0.5  # the lens does bend
    assert not dataset.read_valid([0]).all()


def test_an_import_that_was_cut_off_goes_on_to_the_same_bytes(
    scenes: Path, imported: MultiViewDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    keys = ["--empty_depth", "nothing", "--episodes_per_shard", "1"]
    whole = read(scenes, tmp_path / "whole", *keys)
    write, done = importer._write_shard, []

    def interrupted(*arguments: Any) -> Any:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(arguments)
        return write(*arguments)

    monkeypatch.setattr(importer, "_write_shard", interrupted)
    command = ["import", str(scenes), "--out", str(tmp_path / "out"), *keys]
    assert cli.main(command) == 130
    assert sorted(path.name for path in (tmp_path / "out" / SHARDS).iterdir()) == ["000000.h5", "000001.h5"]
    assert (tmp_path / "out" / UNFINISHED).is_file() and not (tmp_path / "out" / MANIFEST).exists()
    assert len(MultiViewDataset(tmp_path / "out", unfinished=True)) == 6
    kept = (tmp_path / "out" / SHARDS / "000000.h5").stat().st_mtime_ns
    monkeypatch.undo()
    assert cli.main(command) == 2  # it is in use
    assert cli.main([*command, "--resume", "true"]) == 0
    assert (tmp_path / "out" / SHARDS / "000000.h5").stat().st_mtime_ns == kept
    for path in (tmp_path / "whole").rglob("*"):
        if (path.is_file() and path.parent.name == SHARDS) or path.name in (MANIFEST, "plan.json"):
            assert path.read_bytes() == (tmp_path / "out" / path.relative_to(tmp_path / "whole")).read_bytes()
    assert whole.digest() == MultiViewDataset(tmp_path / "out").digest()
    assert cli.main([*command, "--resume", "true", "--shrink", "2"]) == 2


def test_a_damaged_import_is_found_and_mended_by_importing_again(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    command = ["import", str(scenes), "--out", str(tmp_path / "out"), "--episodes_per_shard", "2"]
    assert cli.main(command) == 0
    assert cli.main(["check", str(tmp_path / "out")]) == 0
    shard = tmp_path / "out" / SHARDS / "000001.h5"
    good = shard.read_bytes()
    shard.write_bytes(good[:-100] + bytes([good[-100] ^ 1]) + good[-99:])
    capsys.readouterr()
    assert cli.main(["check", str(tmp_path / "out")]) == 1
    assert "nerf-rl import with the same keys and --resume true" in capsys.readouterr().err
    assert cli.main(["check", str(tmp_path / "out"), "--repair", "true"]) == 2
    said = capsys.readouterr().err
    assert "was imported, so there is no simulator to render its shards again" in said and said.count("\n") == 1
    assert cli.main([*command, "--resume", "true"]) == 0
    assert shard.read_bytes() == good and cli.main(["check", str(tmp_path / "out")]) == 0


def test_a_full_disk_is_told_before_anything_is_written(
    scenes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 5, 5))  # type: ignore[attr-defined]
    assert cli.main(["import", str(scenes), "--out", str(tmp_path / "out")]) == 1
    assert "a larger --shrink" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_nothing_renders_imported_pictures_again(
    imported: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    keys = ["--behaviour.random", "0", "--behaviour.replay", "1", "--behaviour.states", str(imported.folder)]
    assert cli.main(["gen-dataset", "--out", str(tmp_path / "out"), *keys]) == 2
    said = capsys.readouterr().err
    assert "there is no simulator to render them again" in said and said.count("\n") == 1


def test_cameras_get_the_roles_that_are_asked_for(scenes: Path, tmp_path: Path):
    dataset = read(scenes, tmp_path / "out", "--encoder", "[top, left]", "--test", "[right]")
    roles = {camera["name"]: camera["role"] for camera in dataset.manifest["cameras"]}
    assert roles == {"left": "encoder", "top": "encoder", "right": "test", "random_0": "supervision"}


def test_frames_of_an_episode_are_in_their_order_though_an_environment_ended_within_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    write_capture(tmp_path / "capture", moments=4)
    descriptions = sorted((tmp_path / "capture").glob("*/transforms.json"))

    def say(frames: tuple[int, ...]) -> None:
        for description, frame in zip(descriptions, frames, strict=True):
            content = json.loads(description.read_text())
            content["source"] = {"dataset": "x", "episode": 5, "frame": frame, "step": (0, 7, 0, 3)[frame]}
            description.write_text(json.dumps(content))

    unordered = read(tmp_path / "capture", tmp_path / "unordered").read("rgb")
    say((2, 0, 3, 1))
    ordered = read(tmp_path / "capture", tmp_path / "ordered")
    assert ordered.read("step").tolist() == [0, 7, 0, 3] and set(ordered.read("episode")) == {0}
    np.testing.assert_array_equal(ordered.read("rgb"), unordered[[1, 3, 0, 2]])
    say((2, 0, 2, 1))
    assert cli.main(["import", str(tmp_path / "capture"), "--out", str(tmp_path / "twice")]) == 2
    assert "moment_2/transforms.json cannot be imported: it is of the same moment as " in capsys.readouterr().err


def test_one_scene_is_a_source_too(scenes: Path, tmp_path: Path):
    assert len(read(scenes / "frame_000004", tmp_path / "out")) == 1


def test_no_cameras_name_leads_an_exported_picture_elsewhere(tmp_path: Path):
    write_capture(tmp_path / "capture", moments=1)
    description = tmp_path / "capture" / "moment_0" / "transforms.json"
    content = json.loads(description.read_text())
    names = ("../../../escaped_0", "escaped_0", "arm/wrist")
    for frame, name in zip(content["frames"], names, strict=True):
        frame["camera"] = name
    description.write_text(json.dumps(content))
    dataset = read(tmp_path / "capture", tmp_path / "data")
    assert sorted(dataset.camera_names) == sorted(names)
    out = tmp_path / "exports" / "out"
    assert cli.main(["export", str(dataset.folder), "--out", str(out)]) == 0
    pictures = sorted(path.relative_to(out / "frame_000000").as_posix() for path in tmp_path.rglob("*.png"))
    assert pictures == ["images/arm/wrist.png", "images/escaped_0.png", "images/escaped_0_2.png"]
    back = read(out, tmp_path / "back")
    assert back.camera_names == dataset.camera_names
    np.testing.assert_array_equal(back.read("rgb"), dataset.read("rgb"))


def test_files_of_pictures_are_named_after_their_cameras_as_far_as_that_is_safe():
    cameras = ["left", "arm/wrist", "/left", "a/../left", "Ka.mera ö:1"]
    cameras += ["", "..", "C:x", "left.png/x", "x" * 300, "left"]
    names = picture_names(cameras)
    assert names[:2] == cameras[:2] and names[2:4] == ["left_2", "a_left"] and names[4] == cameras[4]
    assert len(set(names)) == len(names)
    for name in names:
        assert (Path("/folder") / f"{name}.png").resolve().is_relative_to("/folder") and len(name) < 220
