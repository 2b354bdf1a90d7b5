"""Measure what finished radiance fields render, by one revision or another: a result file and a page's table.

Run from a checkout's root, with finished runs of pretrain whose datasets are still there; rows of other names stay:

    .venv/bin/python -m tools.compare.renderings NAME RUN [RUN ...] [--stratified 48]

A field does not change, only how it is rendered, so the figures of two revisions are of the same weights and frames.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.versions import git_revision, package_versions, processor
from nerf_rl.pretrain.config import SamplingConfig
from nerf_rl.pretrain.measures.picture_measures import PictureMeasures
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.ray_rendering import render_images
from tools.compare.tasks import things
from tools.page_tables import ENCODERS_PAGE, markdown_table, probe_errors, task_name, write_tables
from tools.record.full_size import ROLES as OTHER_ROLES

RESULT = Path("pretrain/results/renderings.json")
COMMAND = "python -m tools.compare.renderings NAME RUNS --frames FRAMES --stratified STRATIFIED"
ROLES = {"encoder": "the encoder's cameras", **OTHER_ROLES}
MOST_OTHER_VIEWS = 2  # of a role, as in validation


def main() -> None:
    """Measure the runs one after another; write what is known after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="what the table calls this rendering")
    parser.add_argument("runs", nargs="+", type=Path, help="folders of finished runs")
    parser.add_argument("--frames", type=int, default=24, help="held-out frames")
    parser.add_argument("--stratified", type=int, help="even samples a ray; the run's own if it is left out")
    arguments = parser.parse_args()
    for run in arguments.runs:
        known = read_json(RESULT)["rows"] if RESULT.exists() else []
        own = measure(run, arguments)
        keys = {key(row) for row in own}
        rows = sorted([*own, *(row for row in known if key(row) not in keys)], key=key)
        write_json(RESULT, {"command": COMMAND, "rows": rows})
        write_tables(ENCODERS_PAGE, {"renderings": table(rows)})


def measure(run: Path, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the figures of held-out frames from the cameras of each role."""
    config = yaml.safe_load((run / "config.yaml").read_text())
    dataset = MultiViewDataset(Path(config["data"]))
    encoder, field = Encoder.load(run), RadianceField.load(run)
    held_out = np.asarray(dataset.split("validation"))
    frames = held_out[np.linspace(0, len(held_out) - 1, min(arguments.frames, len(held_out))).astype(int)].tolist()
    sampling = SamplingConfig(**config["sampling"])
    if arguments.stratified:
        sampling = replace(sampling, rendering_stratified=arguments.stratified)
    summary = read_json(run / SUMMARY)
    about = {
        "scene": dataset.manifest["scene"]["name"],
        "size": dataset.manifest["height"],
        "seed": config["seed"],
        "steps": summary["steps"],
        "rendering": arguments.name,
        "samples": f"{sampling.rendering_stratified} + {sampling.rendering_importance}",
        "frames": len(frames),
    }
    made_by = {"git_revision": git_revision(), "packages": package_versions(), "processor": processor()}
    rows = []
    for role in (role for role in ROLES if dataset.views(role)):
        measures = PictureMeasures(dataset.class_names, field.bounds.far)
        views = dataset.views(role)[: None if role == "encoder" else MOST_OTHER_VIEWS]
        for frame in frames:
            add_frame(measures, dataset, frame, views, encoder, field, sampling)
        found = measures.compute()
        assert found is not None
        rows.append({**about, "role": role, **found.figures, "class_iou": found.class_iou, **made_by})
    rows[0]["probe"] = summary["probe"]
    return rows


@torch.no_grad()
def add_frame(
    measures: PictureMeasures,
    dataset: MultiViewDataset,
    frame: int,
    views: list[int],
    encoder: Encoder,
    field: RadianceField,
    sampling: SamplingConfig,
) -> None:
    """Encode a frame, render it from some cameras and compare."""
    latent = encoder.encode(torch.from_numpy(dataset.read("rgb", [frame])[:, dataset.views("encoder")]))[0]
    intrinsics, poses = dataset.cameras([frame])
    size = dataset.manifest["height"], dataset.manifest["width"]
    rgb, depth = (dataset.read(name, [frame])[0, views] for name in ("rgb", "depth"))
    semantic = dataset.read_labels([frame])[0, views].astype(np.int64)
    rendered = render_images(field, latent, intrinsics[views], poses[0, views], *size, sampling)
    measures.update(rendered, {"rgb": rgb.astype(np.float32) / 255.0, "semantic": semantic, "depth": depth})


def key(row: dict[str, Any]) -> tuple[Any, ...]:
    """Return by what rows are told apart and sorted."""
    roles = list(ROLES)
    return row["scene"], row["size"], row["seed"], row["steps"], roles.index(row["role"]), row["rendering"]


def table(rows: list[dict[str, Any]]) -> str:
    """Return a row for the cameras of each role of each run by each rendering."""
    header = ["scene", "size", "seed", "steps", "seen from", "rendering", "samples", "PSNR [dB]", "SSIM", "mIoU"]
    lines = []
    for row in rows:
        about = [task_name(row["scene"]), row["size"], row["seed"], f"{row['steps']:,}", ROLES[row["role"]]]
        about += [row["rendering"], row["samples"]]
        figures = [f"{row['psnr_db']:.1f}", f"{row['ssim']:.3f}", f"{row['miou']:.3f}"]
        lines.append(
            [*about, *figures, f"{100 * row['depth_mae_m']:.1f}", things(row), probe_errors(row.get("probe", {}))]
        )
    return markdown_table([*header, "depth error [cm]", "IoU of the classes", "probe [mm]"], lines)


if __name__ == "__main__":
    main()
