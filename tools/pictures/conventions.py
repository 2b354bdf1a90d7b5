"""Draw the conventions of cameras, pixels, depth and labels, with the code that the datasets are made with.

Everything drawn over a rendered picture is put there by nerf_rl.cameras.geometry, so a wrong axis would show as one.

    .venv/bin/python -m tools.pictures.conventions        # writes docs/pictures/conventions.png
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle
from numpy import ndarray

from nerf_rl.cameras.geometry import (
    camera_position,
    intrinsics_from_fovy,
    look_at,
    pixel_directions,
    project,
    projection_matrix,
)
from nerf_rl.files.atomic import atomic_write
from nerf_rl.pictures.images import surface_limits
from nerf_rl.rendering.renderer import MultiViewRenderer, Views
from nerf_rl.rendering.semantics import SemanticClasses, palette, semantic_classes
from nerf_rl.scenes.make import make_scene

OUT = Path("docs/pictures/conventions.png")
SCENE, BODY = "datasets/scenes/blocks.xml", "red_block"
OVERVIEW, CAMERA = 480, 32  # [pixels], of the picture from outside and of the camera that is explained
MOST_BYTES = 300_000
WHITE, COLOURS = "white", ("#e33", "#2c2", "#48f")  # of the axes x, y and z, as usual

Pinhole = tuple[Float[ndarray, "3 3"], Float[ndarray, "4 4"]]
"""Intrinsics K [pixels] and camera_from_world."""


def main() -> None:
    """Render the scene twice and draw what the numbers mean."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=OUT)
    out = parser.parse_args().out
    scene = make_scene(SCENE)
    scene.env.reset(seed=0)
    data = scene.render_data()
    centre = np.array([0.28, 0.0, 0.08])
    outside = (intrinsics_from_fovy(45.0, OVERVIEW, OVERVIEW), look_at(np.array([0.58, 0.0, 0.21]), 1.9, 75.0, -22.0))
    camera = (intrinsics_from_fovy(45.0, CAMERA, CAMERA), look_at(centre, 0.75, 140.0, -35.0))
    renderers = [MultiViewRenderer(scene.model, size, size, 1, quality="full") for size in (OVERVIEW, CAMERA)]
    around, seen = (
        renderer.render(data, intrinsics[None], pose[None])
        for renderer, (intrinsics, pose) in zip(renderers, (outside, camera), strict=True)
    )
    point = data.body(BODY).xpos.copy()
    figure, panels = plt.subplots(2, 3, figsize=(13, 8.6), layout="constrained")
    draw_world(panels[0, 0], around.rgb[0], outside, camera)
    draw_pixels(panels[0, 1], seen.rgb[0], camera, point)
    draw_one_pixel(panels[0, 2], seen.rgb[0], camera, point)
    draw_depth(panels[1, 0], seen, renderers[1].far)
    draw_planar_depth(panels[1, 1])
    draw_labels(panels[1, 2], seen, semantic_classes(scene.model, scene.parts))
    with atomic_write(out) as aside:
        figure.savefig(aside, dpi=80)
        if aside.stat().st_size > MOST_BYTES:
            raise SystemExit(f"{out} would have {aside.stat().st_size} bytes, more than {MOST_BYTES}")
    plt.close(figure)
    for renderer in renderers:
        renderer.close()


def draw_world(panel: Axes, picture: UInt8[ndarray, "H W 3"], outside: Pinhole, camera: Pinhole) -> None:
    """Draw the axes of the world and of the camera, and what the camera sees as a pyramid."""
    show(panel, picture, "world: MuJoCo's [m], z up\ncamera: x right, y down, z forward (OpenCV)")
    panel.set_axis_off()
    for axis, colour, name in zip(np.eye(3), COLOURS, "xyz", strict=True):
        arrow(panel, outside, np.zeros(3), 0.35 * axis, colour, f"{name} world")
    intrinsics, pose = camera
    position = camera_position(pose)
    for axis, colour, name in zip(pose[:3, :3], COLOURS, "xyz", strict=True):  # rows of R are its axes in the world
        arrow(panel, outside, position, 0.2 * axis, colour, f"{name} camera")
    corners = np.array([[0.0, 0.0], [CAMERA, 0.0], [CAMERA, CAMERA], [0.0, CAMERA]])
    plane = position + 0.3 * pixel_directions(intrinsics, pose, corners)
    for first, second in zip(plane, np.roll(plane, -1, axis=0), strict=True):
        line(panel, outside, np.stack([first, second]))
        line(panel, outside, np.stack([position, first]))
    (pixel,), _ = project(projection_matrix(*outside), plane[:1])
    panel.annotate("pixel (0, 0)", pixel, color=WHITE, fontsize=8, ha="right", va="bottom")


def draw_pixels(panel: Axes, picture: UInt8[ndarray, "H W 3"], camera: Pinhole, point: Float[ndarray, "3"]) -> None:
    """Draw the axes of the image and where a known point lies in it."""
    show(panel, picture, "pixels: (u, v, w) = K [R | t] (X, 1)\nX lies at (u / w, v / w), w is its depth")
    panel.set(xlabel="column, x [pixels]", ylabel="row, y [pixels]")
    (pixel,), (depth,) = project(projection_matrix(*camera), point[None])
    for tip, name, shift in (((8.0, 0.7), "x", (1.0, 0.4)), ((0.7, 8.0), "y", (0.0, 1.5))):
        panel.annotate("", tip, (0.7, 0.7), arrowprops={"arrowstyle": "-|>", "color": WHITE, "lw": 2})
        panel.text(tip[0] + shift[0], tip[1] + shift[1], name, color=WHITE, ha="center", va="center", fontsize=11)
    principal = camera[0][:2, 2]
    panel.plot(*principal, "+", color=WHITE, ms=11, mew=2)
    panel.annotate("(W/2, H/2)", principal, (4, 6), textcoords="offset points", color=WHITE, fontsize=9)
    panel.plot(*pixel, "o", mfc="none", color=WHITE, ms=10, mew=2)
    place, where = (", ".join(f"{value:.{digits}f}" for value in values) for values, digits in ((point, 2), (pixel, 1)))
    told = f"{BODY}: X = ({place}) m\nat ({where}), {depth:.2f} m deep"
    panel.text(0.5, 0.03, told, transform=panel.transAxes, color=WHITE, ha="center", va="bottom", fontsize=9)


def draw_one_pixel(panel: Axes, picture: UInt8[ndarray, "H W 3"], camera: Pinhole, point: Float[ndarray, "3"]) -> None:
    """Draw a few pixels with their corners and centres."""
    (pixel,), _ = project(projection_matrix(*camera), point[None])
    column, row = np.floor(pixel).astype(int)
    show(panel, picture, "pixel (column i, row j) covers [i, i + 1) x [j, j + 1)\nits centre is (i + 0.5, j + 0.5)")
    panel.set(xlim=(column - 2, column + 3), ylim=(row + 3, row - 2))
    panel.set(xticks=range(column - 2, column + 4), yticks=range(row - 2, row + 4), xlabel="x", ylabel="y")
    panel.grid(color=WHITE, lw=0.7)
    panel.plot(column + 0.5, row + 0.5, ".", color=WHITE, ms=9)
    panel.add_patch(Rectangle((column, row), 1, 1, fill=False, ec=WHITE, lw=2.5))
    panel.text(column + 0.5, row - 0.15, f"rgb[{row}, {column}]", color=WHITE, ha="center", va="bottom", weight="bold")
    panel.text(column + 0.5, row + 1.15, f"({column}.5, {row}.5)", color=WHITE, ha="center", va="top", weight="bold")


def draw_depth(panel: Axes, seen: Views, far: float) -> None:
    """Draw planar depth."""
    near, most = surface_limits(seen.depth[0], far)
    show(panel, np.where(seen.depth[0] < most, seen.depth[0], most), "depth [m]; where nothing is hit, the far plane's")
    panel.images[0].set(cmap="viridis_r", clim=(near, most))
    panel.figure.colorbar(panel.images[0], ax=panel, shrink=0.75, location="bottom")


def draw_planar_depth(panel: Axes) -> None:
    """Draw, from the side, that depth is measured along the optical axis."""
    panel.set_title("depth is planar: z in the camera's frame,\nnot the distance along the ray", fontsize=10)
    panel.plot([0, 4.6], [0, 0], color="0.5", ls="--")
    panel.text(4.6, 0.1, "z: optical axis", ha="right", va="bottom", color="0.4", fontsize=9)
    panel.plot([0, 4], [0, -2], color="#e33")
    panel.text(1.75, -1.05, "distance: no", color="#e33", rotation=-26.6, ha="center", va="top", fontsize=10)
    panel.plot([4, 4], [0, -2], color="0.5", ls=":")
    panel.annotate("", (4, -2.35), (0, -2.35), arrowprops={"arrowstyle": "<->", "color": "#26c", "lw": 2})
    panel.text(2, -2.45, "depth: yes", color="#26c", ha="center", va="top", fontsize=10)
    panel.plot([0, 0], [0, -2.35], color="0.85", lw=1)
    panel.add_patch(Circle((0, 0), 0.08, color="black"))
    panel.add_patch(Circle((4, -2), 0.08, color="black"))
    panel.text(0, 0.15, "camera", ha="center", va="bottom", fontsize=9)
    panel.text(4.12, -2, "surface", va="center", fontsize=9)
    panel.set(xlim=(-0.7, 5.2), ylim=(-3.1, 0.8), aspect="equal")
    panel.set_axis_off()


def draw_labels(panel: Axes, seen: Views, classes: SemanticClasses) -> None:
    """Draw class ids with their names."""
    labels, colours = classes.label(seen.geom[0]), palette(len(classes.names))
    show(panel, colours[labels], "labels: class ids; 0 is the background")
    for label in np.unique(labels):
        name = f"{label} {classes.names[label]}"
        panel.plot([], [], "s", color=colours[label] / 255, label=name, ms=8)
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=3, fontsize=8, frameon=False, handletextpad=0.1)
    panel.set_axis_off()


def show(panel: Axes, picture: ndarray, title: str) -> None:
    """Show a picture so that pixel (i, j) covers [i, i + 1) x [j, j + 1), with the top row above."""
    panel.imshow(picture, extent=(0, picture.shape[1], picture.shape[0], 0), interpolation="nearest")
    panel.set_title(title, fontsize=10)
    panel.autoscale(False)


def arrow(
    panel: Axes, outside: Pinhole, start: Float[ndarray, "3"], along: Float[ndarray, "3"], colour: str, name: str
) -> None:
    """Draw an arrow of the world [m], with its name at the tip."""
    (first, tip), _ = project(projection_matrix(*outside), np.stack([start, start + along]))
    panel.annotate("", tip, first, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2.5, "shrinkA": 0})
    panel.annotate(name, tip, (5, -3), textcoords="offset points", color=WHITE, fontsize=8)


def line(panel: Axes, outside: Pinhole, ends: Float[ndarray, "2 3"]) -> None:
    """Draw a line of the world [m]."""
    pixels, _ = project(projection_matrix(*outside), ends)
    panel.plot(*pixels.T, color=WHITE, lw=1)


if __name__ == "__main__":
    main()
