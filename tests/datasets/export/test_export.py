"""Exports, read back with other libraries and compared with the dataset's own points."""

import dataclasses
import errno
import importlib.util
import json
import resource
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from nerf_rl import cli
from nerf_rl.cameras.geometry import camera_position, look_from, pixel_centres, pixel_directions
from nerf_rl.datasets.export import export
from nerf_rl.datasets.export.mesh import write_mesh
from nerf_rl.datasets.export.seen import Seen
from nerf_rl.datasets.storage.frames import Frame, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError

has_open3d = importlib.util.find_spec("open3d") is not None
needs_open3d = pytest.mark.skipif(not has_open3d, reason="the extra 'export' (Open3D) is not installed")


@pytest.fixture(scope="module")
def dataset(tiny_dataset: Path) -> MultiViewDataset:
    return MultiViewDataset(tiny_dataset)


def exported(dataset: MultiViewDataset, out: Path, *arguments: str) -> Path:
    """Run the command and return its output folder."""
    assert cli.main(["export", str(dataset.folder), "--out", str(out), *arguments]) == 0
    return out


def points_of(dataset: MultiViewDataset, frame: int, view: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the world points [H * W, 3] that a view's pixels show, and whether a surface was hit."""
    depth = dataset.read("depth", [frame])[0, view]
    intrinsics, poses = dataset.cameras([frame])
    directions = pixel_directions(intrinsics[view], poses[0, view], pixel_centres(*depth.shape))
    hit = depth.ravel() < 0.99 * dataset.manifest["far"]
    return camera_position(poses[0, view]) + depth.reshape(-1, 1) * directions, hit


def test_nerfstudios_reading_of_a_scene_gives_the_datasets_points(dataset: MultiViewDataset, tmp_path: Path):
    scene = exported(dataset, tmp_path / "out", "--frames", "[7]") / "frame_000007"
    transforms = json.loads((scene / "transforms.json").read_text())
    assert transforms["camera_model"] == "OPENCV"
    assert [Path(entry["file_path"]).stem for entry in transforms["frames"]] == list(dataset.camera_names)
    for view, entry in enumerate(transforms["frames"]):
        rgb = cv2.imread(str(scene / entry["file_path"]))[..., ::-1]
        np.testing.assert_array_equal(rgb, dataset.read("rgb", [7])[0, view])
        labels = cv2.imread(str(scene / entry["semantic_path"]), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(labels, dataset.read("semantic", [7])[0, view])
        units = cv2.imread(str(scene / entry["depth_file_path"]), cv2.IMREAD_ANYDEPTH)
        assert units.dtype == np.uint16 and units.shape == (entry["h"], entry["w"])
        # as documented: rays leave pixel centres, the camera looks along -z with y up, matrices lead to the world
        row, column = np.mgrid[0 : entry["h"], 0 : entry["w"]]
        x = (column + 0.5 - entry["cx"]) / entry["fl_x"]
        y = -(row + 0.5 - entry["cy"]) / entry["fl_y"]
        local = np.stack([x, y, -np.ones_like(x)], -1) * (units * transforms["depth_unit_scale_factor"])[..., None]
        pose = np.array(entry["transform_matrix"])
        points = (local @ pose[:3, :3].T + pose[:3, 3]).reshape(-1, 3)
        expected, hit = points_of(dataset, 7, view)
        np.testing.assert_array_equal(units.ravel() > 0, hit)
        assert hit.sum() > 200
        np.testing.assert_allclose(points[hit], expected[hit], atol=1.2e-3)  # depth is in whole millimetres


def test_a_scenes_split_is_that_of_the_cameras(dataset: MultiViewDataset, tmp_path: Path):
    scene = exported(dataset, tmp_path / "out", "--frames", "[0]") / "frame_000000"
    transforms = json.loads((scene / "transforms.json").read_text())
    assert transforms["test_filenames"] == transforms["val_filenames"] == ["images/top.png"]
    assert transforms["train_filenames"] == [f"images/{name}.png" for name in dataset.camera_names[1:]]
    assert trimesh.load(scene / transforms["ply_file_path"]).vertices.shape[0] > 500


def test_a_cloud_holds_the_points_and_colours_of_all_views_without_the_background(
    dataset: MultiViewDataset, tmp_path: Path
):
    out = exported(dataset, tmp_path / "out", "--format", "pointcloud", "--frames", "[5]", "--episodes", "[2]")
    frames = sorted({5, *np.flatnonzero(dataset.read("episode") == 2).tolist()})
    assert sorted(path.name for path in out.glob("*.ply")) == [f"frame_{index:06d}.ply" for index in frames]
    cloud = trimesh.load(out / "frame_000005.ply")
    views = [points_of(dataset, 5, view) for view in range(len(dataset.camera_names))]
    np.testing.assert_allclose(cloud.vertices, np.concatenate([points[hit] for points, hit in views]), atol=1e-5)
    rgb = dataset.read("rgb", [5])[0].reshape(len(views), -1, 3)
    colours = np.concatenate([rgb[view][hit] for view, (_, hit) in enumerate(views)])
    np.testing.assert_array_equal(cloud.colors[:, :3], colours)


def test_classes_left_out_are_masked_in_scenes_and_absent_from_clouds(dataset: MultiViewDataset, tmp_path: Path):
    out = exported(dataset, tmp_path / "scene", "--frames", "[2]", "--exclude", "[robot]")
    semantic = dataset.read("semantic", [2])[0]
    robot = dataset.class_names.index("robot")
    assert (semantic == robot).any()
    kept = 0
    for view, name in enumerate(dataset.camera_names):
        mask = cv2.imread(str(out / "frame_000002" / "masks" / f"{name}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, np.where(semantic[view] == robot, 0, 255))
        kept += int((points_of(dataset, 2, view)[1] & (semantic[view] != robot).ravel()).sum())
    cloud = exported(dataset, tmp_path / "cloud", "--format=pointcloud", "--frames", "[2]", "--exclude", "[robot]")
    assert len(trimesh.load(cloud / "frame_000002.ply").vertices) == kept


@needs_open3d
def test_a_meshs_surface_is_where_the_depth_says(dataset: MultiViewDataset, tmp_path: Path):
    arguments = ["--format", "mesh", "--frames", "[4]", "--reach", "1.5", "--voxel", "0.02"]
    path = exported(dataset, tmp_path / "out", *arguments) / "frame_000004.ply"
    import open3d

    mesh = trimesh.load(path)
    assert len(open3d.io.read_triangle_mesh(str(path)).triangles) == len(mesh.faces) > 500
    points = []
    for view in range(len(dataset.camera_names)):
        seen, hit = points_of(dataset, 4, view)
        points.append(seen[hit & (dataset.read("depth", [4])[0, view].ravel() < 1.5)])
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(open3d.io.read_triangle_mesh(str(path))))
    distance = scene.compute_distance(np.concatenate(points).astype(np.float32)).numpy()
    assert np.median(distance) < 0.005 and (distance < 0.02).mean() > 0.8  # a pixel covers 3 cm and a voxel 2 cm
    assert mesh.visual.vertex_colors[:, :3].std() > 10


@needs_open3d
@pytest.mark.parametrize("voxel", [0.02, 0.005])
def test_a_mesh_has_what_every_pixel_shows_however_fine_its_voxels(
    dataset: MultiViewDataset, tmp_path: Path, voxel: float
):
    arguments = ["--format", "mesh", "--frames", "[4]", "--voxel", str(voxel)]
    path = exported(dataset, tmp_path / "out", *arguments) / "frame_000004.ply"
    import open3d

    shown = [points_of(dataset, 4, view) for view in range(len(dataset.camera_names))]
    points = np.concatenate([points[hit] for points, hit in shown]).astype(np.float32)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(open3d.t.geometry.TriangleMesh.from_legacy(open3d.io.read_triangle_mesh(str(path))))
    assert (scene.compute_distance(points).numpy() < 0.02).mean() > 0.9


def ball_on_a_floor(radius: float, size: int = 96) -> Frame:
    """Return what eight cameras see of a ball at the origin (class 1) on a floor (class 0)."""
    corners = np.stack(np.meshgrid([-0.4, 0.4], [-0.4, 0.4], [0.1, 0.5]), -1).reshape(-1, 3)
    poses = np.stack([look_from(eye, np.zeros(3)) for eye in corners])
    K = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]])
    depth, label = np.empty((2, len(poses), size * size))
    for view, (eye, pose) in enumerate(zip(corners, poses, strict=True)):
        way = pixel_directions(K, pose, pixel_centres(size, size))  # as far as a metre of depth
        a, b, c = (way**2).sum(1), way @ eye, eye @ eye - radius**2
        under = b**2 - a * c
        ball = np.where(under > 0, (-b - np.sqrt(np.maximum(under, 0))) / a, 9.0)
        floor = np.where(way[:, 2] < 0, (-radius - eye[2]) / np.minimum(way[:, 2], -1e-9), 9.0)
        depth[view], label[view] = np.minimum(np.minimum(ball, floor), 9.0), ball < floor
    shape = len(poses), size, size
    return Frame(
        0, 0, 0, "train", False, np.full((*shape, 3), 99, np.uint8), label.reshape(shape).astype(np.uint8),
        depth.reshape(shape).astype(np.float32), np.stack([K] * len(poses)), poses, 9.0, {}, np.zeros(3),
    )  # fmt: skip


@needs_open3d
@pytest.mark.parametrize("classes", [(0, 1), (1,)])
def test_a_mesh_of_a_small_thing_is_as_large_as_the_thing(tmp_path: Path, classes: tuple[int, ...]):
    write_mesh(tmp_path / "ball.ply", Seen(ball_on_a_floor(0.04), 1.0, classes), 0.01)
    vertices = trimesh.load(tmp_path / "ball.ply").vertices
    outside = np.linalg.norm(vertices[vertices[:, 2] > -0.02], axis=1) - 0.04
    outside = outside[outside < 0.1]  # the floor beside
    assert abs(outside.mean()) < 0.002 and np.quantile(np.abs(outside), 0.95) < 0.006


@needs_open3d
def test_a_mesh_that_the_disk_cannot_hold_leaves_no_file(tmp_path: Path):
    seen = Seen(ball_on_a_floor(0.04), 1.0, (0, 1))
    write_mesh(tmp_path / "ball.ply", seen, 0.01)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / "ball.ply").stat().st_size - 1, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_mesh(tmp_path / "cut.ply", seen, 0.01)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == ["ball.ply"]


@needs_open3d
def test_a_mesh_of_a_thing_of_few_pixels_is_fused_or_refused_in_a_sentence(
    dataset: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    few = min(range(1, len(dataset.class_names)), key=lambda i: (dataset.read("semantic", [4]) == i).sum())
    exclude = ",".join(name for i, name in enumerate(dataset.class_names) if i != few)
    arguments = ["--format", "mesh", "--frames", "[4]", "--exclude", f"[{exclude}]", "--voxel"]
    for voxel, code in (("0.01", 0), ("2.0", 2)):
        assert cli.main(["export", str(dataset.folder), "--out", str(tmp_path / voxel), *arguments, voxel]) == code
    assert "frame 4 shows no surface to fuse" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["--frames", "[99]"], "has no frame 99; available: 0 to 11"),
        (["--episodes", "[7]"], "has no episode 7; available: 0 to 3"),
        (["--exclude", "[robto]"], "unknown class 'robto' (did you mean robot?"),
        (["--format", "usd"], "unknown format 'usd'; available: lerobot, mesh, nerfstudio, pointcloud"),
        (["--voxel", "0"], "--voxel must be positive"),
        (["--format", "pointcloud", "--voxel", "0.1"], "--voxel is for --format mesh, and means nothing to pointcloud"),
        (["--format", "mesh", "--cameras", "[top]"], "--cameras is for --format lerobot, and means nothing to mesh"),
        (["--depth", "false"], "--depth is for --format lerobot, and means nothing to nerfstudio"),
        (["--task", "open it"], "--task is for --format lerobot"),
        (["--fps", "3"], "--fps is for --format lerobot"),
    ],
)
def test_mistakes_are_told_in_a_sentence_and_nothing_is_written(
    dataset: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
):
    assert cli.main(["export", str(dataset.folder), "--out", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_depth_that_is_too_far_for_nerfstudio_is_told_of(
    dataset: MultiViewDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    exported(dataset, tmp_path / "near", "--frames", "[0]")
    assert "warning" not in capsys.readouterr().err
    frame = read_frame(dataset, 0)
    depth, pixels = frame.depth.copy(), frame.depth[0].size
    depth[0] = 70.0  # one camera of four sees nothing but what is farther than 65.5 m
    monkeypatch.setattr(export, "read_frame", lambda *_: dataclasses.replace(frame, depth=depth))
    monkeypatch.setitem(dataset.manifest, "far", 100.0)
    monkeypatch.setattr(export, "MultiViewDataset", lambda _: dataset)
    exported(dataset, tmp_path / "far", "--frames", "[0]")
    share = f"{pixels / depth.size:.1%} of the pixels show what is more than 65.5 m away"
    assert share in capsys.readouterr().err and share.startswith("25.0%")


@pytest.mark.parametrize("kind", ["nerfstudio", "pointcloud"])
def test_a_full_disk_is_told_in_a_sentence(
    dataset: MultiViewDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kind
):
    def full(*_: object, **__: object):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)  # of pictures
    monkeypatch.setattr(export, "write_point_cloud", full)
    out = tmp_path / "out"
    assert cli.main(["export", str(dataset.folder), "--out", str(out), "--format", kind, "--frames", "[0]"]) == 1
    said = capsys.readouterr().err.splitlines()[-1]
    assert f"the disk of {out} is full: " in said and "export with --overwrite true" in said and "--resume" not in said
    monkeypatch.undo()
    exported(dataset, out, "--frames", "[0]", "--overwrite", "true")


def test_without_open3d_a_mesh_is_refused_with_what_to_install(
    dataset: MultiViewDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from nerf_rl.datasets.export import mesh

    def absent(*_: str):
        raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setattr(mesh, "import_extra", absent)
    with pytest.raises(UserError, match=r"libusb-1\.0\.so\.0.*apt install libusb-1\.0-0"):
        mesh.load_open3d()
    assert cli.main(["export", str(dataset.folder), "--out", str(tmp_path / "out"), "--format", "mesh"]) == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("form", ["pointcloud", pytest.param("mesh", marks=needs_open3d)])
def test_frames_that_show_nothing_of_what_is_asked_for_are_told_and_the_others_written(
    form: str, dataset: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    shows = dataset.read("depth").min((1, 2, 3))
    nearest, farthest = int(shows.argmin()), int(shows.argmax())
    reach = (np.sort(shows)[0] + np.sort(shows)[-1]) / 2
    words = ["export", str(dataset.folder), "--format", form, "--frames", f"[{nearest},{farthest}]"]
    words += ["--voxel", "0.001"] if form == "mesh" else []
    out = tmp_path / "some"
    assert cli.main([*words, "--reach", str(reach), "--out", str(out)]) == 0
    told = capsys.readouterr().err
    assert f"warning: frame {farthest} shows no" in told and "raise --reach or --exclude fewer classes" in told
    assert [path.name for path in out.glob("*.ply")] == [f"frame_{nearest:06d}.ply"]
    assert json.loads((out / "summary.json").read_text())["frames"] == 1
    assert cli.main([*words, "--reach", "0.001", "--out", str(tmp_path / "none")]) == 2
    assert f"2 of 2 frames ({min(nearest, farthest)}, {max(nearest, farthest)}) show no" in capsys.readouterr().err
