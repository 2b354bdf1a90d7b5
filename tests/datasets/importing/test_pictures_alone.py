"""Of pictures without depth, labels and state, nothing is shown or exported that nobody knows."""

import json
import re
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from captures import HEIGHT, NAMES, TINY, WIDTH, read, write_capture

from nerf_rl import cli
from nerf_rl.datasets.storage.frames import read_columns, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.pretrain.objectives.snerl_module import SnerlModule
from nerf_rl.viewer.drawing.charts import statistics_charts
from nerf_rl.viewer.drawing.pictures import camera_strip, magnify
from nerf_rl.viewer.drawing.statistics import sample_statistics
from nerf_rl.viewer.pages.dataset_view import DatasetView
from nerf_rl.viewer.server import serve

PRETRAIN = Path(__file__).parents[3] / "pretrain"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> MultiViewDataset:
    folder = tmp_path_factory.mktemp("alone")
    write_capture(folder / "capture")
    return read(folder / "capture", folder / "data")


def test_pictures_alone_are_enough_for_a_field_of_colours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    write_capture(tmp_path / "capture")
    dataset = read(tmp_path / "capture", tmp_path / "data")
    assert dataset.absent == ("depth", "labels", "state") and dataset.views("encoder") == [0, 1, 2]
    assert "warning" not in capsys.readouterr().err  # of cameras that see nothing, of which labels tell
    assert (dataset.manifest["height"], dataset.manifest["width"]) == (HEIGHT, WIDTH)
    assert dataset.read("split").sum() == 1 and len(set(dataset.read("episode").tolist())) == 4
    command = ["pretrain", "--config", str(PRETRAIN / "demo.yaml"), "--data", str(dataset.folder)]
    assert cli.main([*command, *TINY, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "needs training and validation frames" in said  # one held-out moment is too few to measure on
    dataset = read(tmp_path / "capture", tmp_path / "data", "--validation_fraction", "0.5", "--overwrite", "true")
    assert cli.main([*command, *TINY, "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert "has no depth and no labels, which --losses.depth, --losses.anchor" in said
    assert "field-rgb.yaml" in said and said.count("\n") == 1 and not (tmp_path / "run").exists()
    anchors = [*command, "--config", str(PRETRAIN / "objectives" / "anchors.yaml"), *TINY]
    assert cli.main([*anchors, "--out", str(tmp_path / "run")]) == 2
    assert "has no depth and no labels, which --objective anchors learns from" in capsys.readouterr().err
    rgb = [*command, "--config", str(PRETRAIN / "objectives" / "field-rgb.yaml"), *TINY, "--log_every", "1"]
    rgb += ["--sampling.near", "0.5", "--sampling.far", "2000"]  # beyond what stands for unknown depth
    idle: set[str] = set()  # would be refused where processes exchange gradients

    def note_idle(module: SnerlModule) -> None:
        parameters = module.named_parameters()
        idle.update(name for name, parameter in parameters if parameter.requires_grad and parameter.grad is None)

    monkeypatch.setattr(SnerlModule, "on_after_backward", note_idle)
    assert cli.main([*rgb, "--out", str(tmp_path / "run")]) == 0 and not idle
    (grid,) = [cv2.imread(str(path)) for path in sorted((tmp_path / "run" / "reconstructions").iterdir())[-1:]]
    truth, rendering = (
        grid[: 2 * HEIGHT, 3 * (2 * WIDTH + 2) :],
        grid[2 * HEIGHT + 2 : 4 * HEIGHT + 2, 3 * (2 * WIDTH + 2) :],
    )
    assert grid.shape[1] == 6 * (2 * WIDTH + 2) and (truth == 255).all() and rendering[:, :WIDTH].std() > 0  # no labels
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    figures = summary["validation"]
    assert figures["psnr_db"] > 5 and figures["miou"] is figures["depth_mae_m"] is None and summary["class_iou"] == {}
    logged = (tmp_path / "run" / "logs" / "metrics.csv").read_text().splitlines()[0]
    assert "train/rgb" in logged and "train/semantic" not in logged and "train/depth" not in logged
    assert cli.main(["view", str(tmp_path / "run"), "--png", str(tmp_path / "a.png"), "--frames", "1"]) == 0
    assert cli.main(["view", str(dataset.folder), "--save", str(tmp_path / "a.html"), "--frames", "1"]) == 0


def test_a_cameras_picture_shows_colours_alone(dataset: MultiViewDataset):
    frame = read_frame(dataset, 0)
    strip = camera_strip(frame, 1, dataset.palette, (0.0, 1.0), 2 * HEIGHT)
    np.testing.assert_array_equal(strip, magnify(frame.rgb[1], 2 * HEIGHT))


def test_a_page_has_neither_classes_nor_charts(dataset: MultiViewDataset, tmp_path: Path):
    assert cli.main(["view", str(dataset.folder), "--save", str(tmp_path / "a.html"), "--frames", "1"]) == 0
    page = re.sub(r'srcdoc="[^"]*"', "", (tmp_path / "a.html").read_text())  # without the 3-D recording
    assert "background<" not in page and "Charts" not in page and page.count("data:image") == 1
    assert read_columns(dataset, range(1)).columns == {}
    assert statistics_charts(sample_statistics(dataset), dataset.palette) == []


def test_the_viewer_has_no_cloud_and_looks_where_the_cameras_look(dataset: MultiViewDataset):
    with serve("127.0.0.1", 0, "pictures") as server:
        page = DatasetView(server, dataset)
        page.gather_statistics()
        page.timeline.close()
        assert page.scene.colouring.options == ("hidden",) and page.columns is None and page.statistics_tab is None
        np.testing.assert_allclose(server.initial_camera.look_at, 0.0, atol=1e-6)
        page.close()


def test_a_scene_that_is_exported_comes_back_with_what_it_had(dataset: MultiViewDataset, tmp_path: Path):
    assert cli.main(["export", str(dataset.folder), "--out", str(tmp_path / "scenes")]) == 0
    scene = tmp_path / "scenes" / "frame_000000"
    assert {path.name for path in scene.iterdir()} == {"images", "transforms.json"}
    transforms = json.loads((scene / "transforms.json").read_text())
    assert not {"semantic_classes", "depth_unit_scale_factor", "ply_file_path"} & set(transforms)
    assert not {"depth_file_path", "semantic_path"} & set(transforms["frames"][0])
    back = read(tmp_path / "scenes", tmp_path / "back")
    assert back.absent == dataset.absent and back.camera_names == NAMES
    np.testing.assert_array_equal(back.read("rgb"), dataset.read("rgb"))


def grey_png(grey: np.ndarray, bits: int, transparent: int) -> bytes:
    """Return a PNG file of grey pixels, of which those of one value are transparent."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    height, width = grey.shape
    digits = np.unpackbits(grey[..., None], axis=-1)[..., 8 - bits :].reshape(height, -1)
    rows = np.pad(np.packbits(digits, axis=1), ((0, 0), (1, 0)))  # each begins with the filter's number
    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    parts = [(b"IHDR", header), (b"tRNS", struct.pack(">H", transparent)), (b"IDAT", zlib.compress(rows.tobytes()))]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in [*parts, (b"IEND", b"")])


@pytest.mark.parametrize("kind", ["rgba", "rgba of 16 bits", "palette", "grey", "grey of 2 bits"])
def test_pixels_that_are_transparent_by_more_than_half_do_not_count(tmp_path: Path, kind: str):
    write_capture(tmp_path / "capture", moments=2)
    scene = tmp_path / "capture" / "moment_1"
    alpha = np.tile(np.linspace(0, 255, WIDTH).astype(np.uint8), (HEIGHT, 1))
    colours = cv2.imread(str(scene / "images" / "b.jpg"))
    if kind == "palette":
        indices = pytest.importorskip("PIL.Image").fromarray(colours).quantize(16)
        alpha = np.where(np.array(indices) < 5, 0, 255)
        indices.save(scene / "images" / "b.png", transparency=bytes([0] * 5))
    elif "grey" in kind:
        bits = 2 if "2" in kind else 8
        grey = np.random.default_rng(0).integers(0, 3, (HEIGHT, WIDTH)).astype(np.uint8)
        alpha = np.where(grey == 1, 0, 255)
        (scene / "images" / "b.png").write_bytes(grey_png(grey, bits, transparent=1))
    else:
        depth = np.uint16 if "16" in kind else np.uint8
        scale = np.iinfo(depth).max // 255
        picture = np.dstack([colours, alpha]).astype(depth) * scale
        cv2.imwrite(str(scene / "images" / "b.png"), picture.astype(depth))
    description = scene / "transforms.json"
    description.write_text(description.read_text().replace("images/b.jpg", "images/b.png"))
    dataset = read(tmp_path / "capture", tmp_path / "data")
    valid = dataset.read_valid([0, 1])
    assert valid is not None
    np.testing.assert_array_equal(valid[1, 1], alpha >= 128)
    assert valid[0].all() and valid[1, [0, 2]].all() and 0.1 < valid[1, 1].mean() < 0.9


@pytest.mark.parametrize("kind", ["pointcloud", "mesh"])
def test_no_points_are_made_up(
    dataset: MultiViewDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
):
    assert cli.main(["export", str(dataset.folder), "--out", str(tmp_path / "out"), "--format", kind]) == 2
    said = capsys.readouterr().err
    assert f"has no depth, which --format {kind} is made of" in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()
