"""Sources that somebody handed in, damaged or worse: one sentence with the file, and never a file from elsewhere."""

import json
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.cameras.geometry import look_from
from nerf_rl.datasets.export.nerfstudio import world_from_opengl_camera

SIZE = 12


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Two moments, seen by two cameras with depth, labels and masks."""
    rng = np.random.default_rng(0)
    for moment in range(2):
        scene = tmp_path / "source" / f"moment_{moment}"
        frames = []
        for view, eye in enumerate(([1.0, 0, 0.5], [0, 1.0, 0.5])):
            name, kinds = f"camera_{view}", ("images", "depths", "semantics", "masks")
            pictures = (
                rng.integers(0, 255, (SIZE, SIZE, 3), np.uint8),
                rng.integers(800, 1500, (SIZE, SIZE), np.uint16),
                rng.integers(0, 2, (SIZE, SIZE), np.uint8),
                np.full((SIZE, SIZE), 255, np.uint8),
            )
            for kind, picture in zip(kinds, pictures, strict=True):
                (scene / kind).mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(scene / kind / f"{name}.png"), picture)
            keys = ("file_path", "depth_file_path", "semantic_path", "mask_path")
            pose = world_from_opengl_camera(look_from(np.array(eye), np.zeros(3)))
            entry = {key: f"{kind}/{name}.png" for key, kind in zip(keys, kinds, strict=True)}
            frames.append({**entry, "transform_matrix": pose.tolist()})
        classes = [{"name": name, "colour": [0, 9, 9]} for name in ("background", "thing")]
        camera = {"fl_x": 10.0, "fl_y": 10.0, "cx": 6.0, "cy": 6.0, "w": SIZE, "h": SIZE}
        (scene / "transforms.json").write_text(json.dumps({**camera, "semantic_classes": classes, "frames": frames}))
    return tmp_path / "source"


def transforms(source: Path, moment: int = 1) -> Path:
    return source / f"moment_{moment}" / "transforms.json"


def edit(change: Callable[[dict], Any]) -> Callable[[Path], None]:
    """Return what changes the second scene's description."""

    def apply(source: Path) -> None:
        content = json.loads(transforms(source).read_text())
        change(content)
        transforms(source).write_text(json.dumps(content))

    return apply


def first(**keys: Any) -> Callable[[Path], None]:
    """Return what changes keys of the second scene's first view."""
    return edit(lambda content: content["frames"][0].update(keys))


def pose(change: Callable[[np.ndarray], Any]) -> Callable[[Path], None]:
    def apply(content: dict) -> None:
        matrix = np.array(content["frames"][0]["transform_matrix"])
        change(matrix)
        content["frames"][0]["transform_matrix"] = matrix.tolist()

    return edit(apply)


def raw(content: bytes) -> Callable[[Path], None]:
    return lambda source: transforms(source).write_bytes(content) and None


def picture(kind: str, content: bytes | np.ndarray) -> Callable[[Path], None]:
    def apply(source: Path) -> None:
        path = source / "moment_1" / kind / "camera_0.png"
        path.write_bytes(content if isinstance(content, bytes) else cv2.imencode(".png", content)[1].tobytes())

    return apply


def link(target: str) -> Callable[[Path], None]:
    def apply(source: Path) -> None:
        path = source / "moment_1" / "images" / "camera_0.png"
        path.unlink()
        path.symlink_to(target)

    return apply


def png_head(width: int, height: int) -> bytes:
    """Return a PNG file that claims a size and holds nothing of it."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))


def cut(source: Path) -> None:
    path = source / "moment_1" / "images" / "camera_0.png"
    path.write_bytes(path.read_bytes()[:-200])


def jpeg(change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Return what makes the second scene's first picture a JPEG file with a smaller one in its head."""

    def apply(source: Path) -> None:
        pixels = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3), np.uint8)
        whole, small = (cv2.imencode(".jpg", each)[1].tobytes() for each in (pixels, pixels[:4, :4]))
        head = b"\xff\xe1" + struct.pack(">H", len(small) + 2) + small
        picture("images", change(whole[:2] + head + whole[2:]))(source)

    return apply


def rename_camera(source: Path) -> None:
    (source / "moment_1" / "images" / "camera_0.png").rename(source / "moment_1" / "images" / "other.png")
    first(file_path="images/other.png")(source)


FAULTS = [
    (first(file_path="../../secret.png"), "names '../../secret.png', which is no path below its folder"),
    (first(file_path="/etc/passwd"), "names '/etc/passwd', which is no path below its folder"),
    (first(file_path=""), "names '', which is no path below its folder"),
    (first(depth_file_path="depths/../../x.png"), "which is no path below its folder"),
    (first(mask_path="nothing.png"), "names nothing.png, which is not there"),
    (first(file_path="x" * 5000), "is not there|cannot be read"),
    (link("/etc/passwd"), "a link that leads out of its folder"),
    (link("camera_0.png"), "it names images/camera_0.png"),
    (raw(b"{"), "moment_1/transforms.json cannot be imported"),
    (raw(b"[" * 100_000), "nested too deeply"),
    (raw(b'{"frames": []}'), "frames is a list of 0 instead of a list of 1 to 256"),
    (raw(b'{"frames": [{"file_path": "a", "transform_matrix": [[NaN]]}]}'), "NaN"),
    (edit(lambda content: content.pop("fl_x")), "it gives no fl_x, of images/camera_0.png"),
    (edit(lambda content: content.update(w=1e9)), "w is 1000000000.0 instead of a whole number"),
    (edit(lambda content: content.update(fl_x=-3.0)), "a focal length is -3"),
    (edit(lambda content: content.update(cx=99.0)), "a principal point, 99, 6, is outside of its picture"),
    (edit(lambda content: content.update(camera_model="OPENCV_FISHEYE")), "its camera model is OPENCV_FISHEYE"),
    (edit(lambda content: content.update(is_fisheye=True)), "it is marked is_fisheye, and only pictures of pinhole"),
    (first(is_fisheye=1), "is_fisheye is 1 instead of true or false"),
    (edit(lambda content: content.update(k4=0.1)), "a fourth radial term"),
    (edit(lambda content: content.update(camera=5, mask_path=7, fl_x=11.0)), "camera_0 has other intrinsics than in"),
    (
        edit(lambda content: content.update(semantic_classes=[{"name": "a", "colour": [0, 0, 0]}])),
        "other semantic_classes",
    ),
    (edit(lambda content: content.pop("semantic_classes")), "other semantic_classes"),
    (edit(lambda content: content["frames"].pop()), "only one has a camera camera_1; all scenes need the same"),
    (edit(lambda content: content["frames"].append(content["frames"][0])), "two pictures of a camera camera_0"),
    (edit(lambda content: content["frames"][0].pop("depth_file_path")), "all views need depth or none"),
    (rename_camera, "only one has a camera"),
    (pose(lambda m: m.__imul__(2.0)), "last row of a camera's pose"),
    (pose(lambda m: m[:3, :3].__imul__(1.1)), "is not rigid"),
    (pose(lambda m: m[:, 0].__imul__(-1.0)), "is not rigid"),
    (pose(lambda m: m[0].__setitem__(3, 1e9)), "farther than 1e+06 m"),
    (first(transform_matrix=[[1, 0, 0]] * 3), "transform_matrix is a list of 3 instead of a list of 4"),
    (first(transform_matrix=[[1e400] * 4] * 4), "Infinity"),
    (picture("images", b"no picture"), "it is neither a PNG nor a JPEG file"),
    (picture("images", np.zeros((8, 8, 3), np.uint8)), "it is 8 x 8 pixels large instead of 12 x 12"),
    (picture("images", png_head(60000, 60000)), "it claims 60000 x 60000 pixels"),
    (picture("images", png_head(SIZE, SIZE)), "its picture is damaged"),
    (picture("images", np.zeros((SIZE, SIZE, 3), np.uint8)), "its picture is black"),
    (cut, "its picture is damaged"),
    (jpeg(lambda content: content[:-2]), "its picture is damaged"),
    (jpeg(lambda content: content[:-100]), "its picture is damaged"),
    (jpeg(lambda content: content[: content.rindex(b"\xff\xda") + 4]), "its picture is damaged"),
    (picture("depths", np.zeros((SIZE, SIZE), np.uint8)), "1 channels of 8 bits instead of one of 16"),
    (picture("semantics", np.zeros((SIZE, SIZE, 3), np.uint8)), "3 channels of 8 bits instead of one of 8"),
    (picture("semantics", np.full((SIZE, SIZE), 7, np.uint8)), "it shows the class 7, and transforms.json names 2"),
    (picture("masks", np.zeros((SIZE, SIZE), np.uint8)), "camera_0 has no pixel that counts"),
]


@pytest.mark.parametrize("damage, fault", FAULTS)
def test_a_fault_is_one_sentence_that_names_the_file(
    source: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], damage: Callable[[Path], None], fault: str
):
    damage(source)
    assert cli.main(["import", str(source), "--out", str(tmp_path / "out")]) in (1, 2)
    said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nerf-rl")]
    assert len(said) == 1 and "moment_1" in said[0]
    assert any(part in said[0] for part in fault.split("|"))
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_the_source_is_good_without_a_fault(source: Path, tmp_path: Path):
    assert cli.main(["import", str(source), "--out", str(tmp_path / "out")]) == 0


def test_a_source_may_say_that_it_is_of_pinhole_cameras(source: Path, tmp_path: Path):
    edit(lambda content: content.update(is_fisheye=False))(source)
    assert cli.main(["import", str(source), "--out", str(tmp_path / "out")]) == 0


def test_a_scene_that_is_a_link_to_elsewhere_is_not_read_and_not_left_out_without_a_word(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    shutil.move(source / "moment_1", tmp_path / "elsewhere")
    os.symlink(tmp_path / "elsewhere", source / "moment_1")
    assert cli.main(["import", str(source), "--out", str(tmp_path / "out")]) == 2
    assert "moment_1 cannot be imported: it is a link that leads out of" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["nowhere"], "is not a source of pictures: there is no such folder"),
        (["."], "it holds neither scenes nor meta/info.json; give a folder of nerfstudio scenes"),
        (["source", "--format", "lerobot"], "it has no meta/info.json"),
        (["source", "--format", "colmap"], "unknown format 'colmap'; available: auto, lerobot, nerfstudio"),
        (["source", "--encoder", "[camera_9]"], "unknown camera 'camera_9' (did you mean camera_"),
        (["source", "--encoder", "[camera_0]", "--test", "[camera_0]"], "--encoder and --test both name camera_0"),
        (["source", "--test", "[camera_0, camera_1]"], "leaves no camera to the encoder"),
        (["source", "--shrink", "13"], "--shrink 13 leaves nothing of pictures of 12 x 12 pixels"),
        (["source", "--scale", "0"], "--scale must be in (0, 1000000], got 0.0"),
        (["source", "--empty_depth", "far"], "unknown empty_depth 'far'; available: nothing, unknown"),
        (["source", "--validation_fraction", "1"], "--validation_fraction must be in [0, 1)"),
    ],
)
def test_mistakes_are_told_in_a_sentence_and_nothing_is_written(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
):
    folder, keys = tmp_path / arguments[0], arguments[1:]
    out = tmp_path / "outputs" / "out"
    assert cli.main(["import", str(folder), "--out", str(out), *keys]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1 and not out.exists()


def test_a_source_is_never_overwritten(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (source / "provenance.json").write_text("{}")  # as an export has it
    for out in (source, tmp_path):
        assert cli.main(["import", str(source), "--out", str(out), "--overwrite", "true"]) == 2
        assert "lies in the output folder" in capsys.readouterr().err
    assert transforms(source).is_file()


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_whole_jpeg_file_is_read_whatever_comes_after_it(progressive: int, source: Path, tmp_path: Path):
    """Some cameras append what others do not know of; a progressive file has a scan for each refinement."""
    pixels = np.random.default_rng(0).integers(0, 255, (SIZE, SIZE, 3), np.uint8)
    content = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1].tobytes()
    picture("images", content + b"more")(source)
    assert cli.main(["import", str(source), "--out", str(tmp_path / "out")]) == 0


def test_a_folder_below_a_file_is_refused_in_a_sentence(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").touch()
    assert cli.main(["import", str(source), "--out", str(tmp_path / "file" / "data")]) == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'file'} is a file and no folder" in said and said.count("\n") == 1
