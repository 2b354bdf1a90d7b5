"""Pages of datasets whose cameras, points and classes are called alike, or strangely."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from nerf_rl import cli
from nerf_rl.datasets.storage.frames import EpisodeColumns, read_frame
from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.checksummed_json import write_checksummed
from nerf_rl.viewer.drawing.charts import columns_chart
from nerf_rl.viewer.node_names import node_name
from nerf_rl.viewer.panels.scene_panel import ScenePanel
from nerf_rl.viewer.server import serve

NASTY = ["a", "a/b", "a%2Fb", "/", "%", "", "..", "world", "cloud", "$\\frac{$", "Käse 奶酪"]


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped recipe, small: a camera and a point of the state are both called ``hand``."""
    out = tmp_path_factory.mktemp("blocks") / "dataset"
    keys = ["--episodes", "4", "--size", "48", "--frames_per_episode", "2", "--workers", "1", "--out", str(out)]
    assert cli.main(["gen-dataset", "--config", "datasets/blocks.yaml", *keys]) == 0
    return out


def called(dataset: Path, folder: Path, cameras: list[str], points: list[str], classes: list[str]) -> Path:
    """Return a copy of a dataset in which the first cameras, points and classes have other names."""
    shutil.copytree(dataset, folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    for kind, names in (("cameras", cameras), ("classes", classes)):
        for entry, name in zip(manifest[kind], names, strict=False):
            entry["name"] = name
    columns = [f"{name}_{axis}" for name in points for axis in "xyz"]
    manifest["columns"]["privileged"][: len(columns)] = columns
    write_checksummed(folder / "manifest.json", manifest)
    return folder


def test_a_camera_and_a_point_of_one_name_stand_in_the_scene_together(blocks: Path) -> None:
    dataset = MultiViewDataset(blocks)
    first = read_frame(dataset, 0)
    assert set(dataset.camera_names) & set(first.points), "the recipe has no such pair any more"
    with serve("127.0.0.1", 0, "test") as server:
        panel = ScenePanel(server, dataset, first, lambda: None)
        for index in (0, 5):
            frame = read_frame(dataset, index)
            panel.show(frame)
        for view in range(len(dataset.camera_names)):
            assert np.allclose(panel._names[view].position, panel._frusta[view].position)
        assert {name: tuple(handle.position) for name, handle in panel._labels.items()} == frame.points


@pytest.mark.parametrize("start", range(0, len(NASTY), 4))
def test_a_dataset_of_strange_names_becomes_a_page(tiny_dataset: Path, tmp_path: Path, start: int) -> None:
    names = (NASTY + NASTY)[start : start + 4]
    folder = called(tiny_dataset, tmp_path / "dataset", names, names[:3], names)
    assert cli.main(["view", str(folder), "--frames", "2", "--save", str(tmp_path / "x.html")]) == 0
    assert "__VISER_EMBED_DATA__" in (tmp_path / "x.html").read_text()


def test_the_shipped_recipe_becomes_a_page(blocks: Path, tmp_path: Path) -> None:
    assert cli.main(["view", str(blocks), "--frames", "2", "--save", str(tmp_path / "x.html")]) == 0
    assert "__VISER_EMBED_DATA__" in (tmp_path / "x.html").read_text()


def test_no_two_things_share_a_node_and_none_lies_below_another() -> None:
    kinds = ("cameras", "camera names", "points", "point names")
    nodes = [node_name(kind, name) for kind in kinds for name in NASTY]
    assert len(set(nodes)) == len(nodes) == len(kinds) * len(NASTY)
    assert all(node.count("/") == 2 for node in nodes)


def test_a_dollar_in_a_name_is_drawn_and_an_underscore_hides_no_line() -> None:
    frame = EpisodeColumns(np.arange(3.0), {"$\\frac{$_x": np.arange(3.0)})
    assert columns_chart(frame).std() > 5
    charts = [columns_chart(EpisodeColumns(frame.steps, {name: np.arange(3.0)})) for name in ("_i", "_iiiiiiii")]
    assert not np.array_equal(*charts)  # the title tells them apart
