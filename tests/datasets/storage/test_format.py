"""The format as datasets/README.md describes it, read by h5py and NumPy alone, with none of our code."""

import hashlib
import json
from pathlib import Path

import h5py
import numpy as np


def test_a_reader_written_from_the_description_alone_finds_the_handle_where_the_drawer_is(tiny_dataset: Path):
    manifest = json.loads((tiny_dataset / "manifest.json").read_text())
    classes = [entry["name"] for entry in manifest["classes"]]
    columns = manifest["columns"]["privileged"]
    first, hits, frames = 0, 0, 0
    for entry in manifest["shards"]:
        content = (tiny_dataset / entry["file"]).read_bytes()
        assert hashlib.sha256(content).hexdigest() == entry["sha256"]
        with h5py.File(tiny_dataset / entry["file"], "r") as shard:
            rgb, depth, semantic = shard["rgb"][:], shard["depth"][:], shard["semantic"][:]
            K, pose = shard["cameras/intrinsics"][:], shard["cameras/camera_from_world"][:]
            projection, privileged = shard["cameras/projection"][:], shard["state/privileged"][:]
            episode = shard["episode"][:]
            for name in ("rgb", "depth", "semantic", "state/qpos", "reward"):
                assert shard[name].chunks is None and shard[name].compression is None
        count, views = len(rgb), len(manifest["cameras"])
        assert count == entry["frames"]
        assert rgb.shape == (count, views, manifest["height"], manifest["width"], 3)
        assert depth.shape == semantic.shape == rgb.shape[:-1] and (depth <= manifest["far"] * (1 + 1e-5)).all()
        assert semantic.max() < len(classes) and classes[0] == "background"
        assert (np.diff(episode) >= 0).all() and episode[0] == first // 3
        assert pose.shape == (count, views, 4, 4)  # a random camera moves, so there is one for each frame
        K = np.broadcast_to(K, (count, views, 3, 3))
        np.testing.assert_allclose(projection, K @ pose[..., :3, :], atol=1e-9)
        for frame in range(count):
            point = np.array([privileged[frame, columns.index(f"handle_{axis}")] for axis in "xyz"])
            for view in range(views):
                u, v, w = projection[frame, view] @ np.append(point, 1.0)
                column, row = int(np.floor(u / w)), int(np.floor(v / w))
                if w <= 0 or not (1 <= column < rgb.shape[3] - 1 and 1 <= row < rgb.shape[2] - 1):
                    continue
                # unless something is in front of it: the pixel shows the drawer or its cabinet, at the handle's depth
                if depth[frame, view, row, column] > w - 0.1:
                    around = semantic[frame, view, row - 1 : row + 2, column - 1 : column + 2].ravel()
                    assert any(classes[label].startswith("drawer") for label in around)
                    hits += abs(depth[frame, view, row, column] - w) < 0.1
                frames += 1
        first += count
    assert first == manifest["frames"] and frames > 20 and hits > 10


def test_the_description_names_every_array_and_every_key_that_there_is(tiny_dataset: Path):
    text = (Path(__file__).parents[3] / "datasets" / "README.md").read_text()
    arrays, manifest = (text.partition(header)[2].partition("\n\n")[0] for header in ("| array in a shard", "| key in"))
    with h5py.File(tiny_dataset / "shards" / "000000.h5") as shard:
        found: set[str] = set()
        shard.visititems(lambda name, item: found.add(name) if isinstance(item, h5py.Dataset) else None)
    assert {name for name in found if f"`{name}`" not in described(arrays)} == set()
    assert found == {name for name in described(arrays).replace("`", "").split() if name in found}
    keys = json.loads((tiny_dataset / "manifest.json").read_text())
    assert {key for key in keys if f"`{key}`" not in described(manifest)} == set()


def described(table: str) -> str:
    """Return the first column of a Markdown table, where names of arrays of one group may share a row."""
    names = " ".join(line.split("|")[1] for line in table.splitlines()[2:])
    return names.replace(",", " ")
