"""Draw the documentation's gallery: a picture of every Meta-World task, on contact sheets with their names.

Run from a checkout's root; it writes docs/pictures/gallery_*.jpg and their lists in docs/gallery.md (minutes):

    .venv/bin/python -m tools.pictures.gallery
    .venv/bin/python -m tools.pictures.gallery drawer-open-v3 soccer-v3 --out sheet.jpg    # these alone, on one sheet
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
from nerf_rl.files.atomic import atomic_write
from nerf_rl.pictures.images import tile
from nerf_rl.rendering.renderer import MultiViewRenderer
from nerf_rl.scenes.base import METAWORLD, Scene
from nerf_rl.scenes.make import make_scene
from tools.bench.scenes import metaworld_tasks
from tools.page_tables import write_tables

PAGE, SHEETS = Path("docs/gallery.md"), "docs/pictures/gallery_{}.jpg"
COLUMNS, ROWS = 5, 2
SIZE, CAPTION = 192, 20  # [pixels] of a picture and of the line below it
SEED, STEPS = 0, 40  # of the episode, and of the task's scripted policy in it before the picture is taken
VIEW = {"distance": 1.15, "azimuth_deg": 150.0, "elevation_deg": -32.0}
QUALITY = 88  # of the JPEGs
MOST_BYTES = 300_000


def main() -> None:
    """Draw all tasks, or those named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", metavar="TASK")
    parser.add_argument("--out", type=Path, help="where the sheet of the named tasks goes")
    chosen = parser.parse_args()
    if bool(chosen.tasks) != bool(chosen.out):
        parser.error("name tasks and --out together, or neither of them")
    if chosen.tasks:
        write_sheet(chosen.out, chosen.tasks)
        return
    tasks = [scene.removeprefix(METAWORLD) for scene in metaworld_tasks()]
    lists = {}
    for number, first in enumerate(range(0, len(tasks), COLUMNS * ROWS), start=1):
        shown = tasks[first : first + COLUMNS * ROWS]
        write_sheet(Path(SHEETS.format(number)), shown)
        lists[f"gallery-{number}"] = ", ".join(f"`{task}`" for task in shown)
    write_tables(PAGE, lists)


def write_sheet(path: Path, tasks: Sequence[str]) -> None:
    """Write a contact sheet of tasks, row by row; the last row is filled up with white."""
    pictures = [with_caption(picture_of(make_scene(METAWORLD + task)), task) for task in tasks]
    pictures += [np.full_like(pictures[0], 255)] * (-len(pictures) % COLUMNS)
    sheet = tile([pictures[first : first + COLUMNS] for first in range(0, len(pictures), COLUMNS)], gap=4)
    with atomic_write(path) as aside:
        cv2.imwrite(str(aside), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        written = aside.stat().st_size
        if written > MOST_BYTES:
            raise SystemExit(f"{path} would have {written} bytes, more than {MOST_BYTES}; lower SIZE or QUALITY")
    print(f"{path}: {written // 1000} kB, {', '.join(tasks)}", flush=True)


def picture_of(scene: Scene) -> UInt8[ndarray, "H W 3"]:
    """Return what one camera sees of a scene when its scripted policy has acted for a while."""
    observation, _ = scene.env.reset(seed=SEED)
    policy = scene.scripted_policy()
    assert policy is not None
    for _ in range(STEPS):
        observation, *_ = scene.env.step(policy(observation))
    renderer = MultiViewRenderer(scene.model, SIZE, SIZE, views=1, quality="full")
    pose = look_at(scene.workspace().centre, **VIEW)
    rgb = renderer.render_rgb(scene.render_data(), intrinsics_from_fovy(45.0, SIZE, SIZE)[None], pose[None])[0]
    renderer.close()
    scene.env.close()
    return rgb


def with_caption(picture: UInt8[ndarray, "H W 3"], text: str) -> UInt8[ndarray, "K W 3"]:
    """Return a picture with a line of text below it."""
    line = np.full((CAPTION, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(line, text, (2, CAPTION - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (40, 40, 40), 1, cv2.LINE_AA)
    return np.concatenate([picture, line])


if __name__ == "__main__":
    main()
