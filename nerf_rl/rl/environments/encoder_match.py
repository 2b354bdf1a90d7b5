"""Whether an encoder belongs to an environment: the scene it was trained on, and how its pictures are rendered."""

import functools
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from nerf_rl.errors import UserError
from nerf_rl.files.versions import package_versions
from nerf_rl.pretrain.model.encoder_file import SIMULATORS, read_description
from nerf_rl.scenes.imported import IMPORTED


def check_encoder_scene(encoder: str | Path, scene: str) -> None:
    """Raise UserError if there is no encoder at the path or it was trained on another scene."""
    compare_scenes(read_description(encoder)[1]["scene"]["name"], scene)


def compare_scenes(trained: str, wanted: str) -> None:
    """Raise UserError if the encoder's scene is not the one to act in."""
    if trained.startswith(IMPORTED):
        raise UserError(
            f"the encoder was trained on {trained}, images that were imported, and no simulator can show it what it "
            f"knows; pretrain one on a dataset of {wanted}"
        )
    if trained != wanted:
        raise UserError(
            f"the encoder was trained on scene {trained}, not {wanted}; use --scene {trained} or its encoder"
        )


def rendering_differences(renderer: str, simulators: Mapping[str, str], here: str) -> list[str]:
    """Return how rendering here differs from that of an encoder's dataset, in words.

    Args:
        renderer: the OpenGL implementations that made the dataset, joined by " and "; empty if they are not known.
        simulators: versions of the packages that made it, by name.
        here: the OpenGL implementation that renders now.
    """
    versions = package_versions()
    differences = [f"{renderer} then, {here} here"] if renderer and here not in renderer.split(" and ") else []
    return differences + [
        f"{name} {then} then, {versions[name]} here"
        for name, then in simulators.items()
        if name in versions and versions[name] != then
    ]


def warn_of_other_rendering(renderer: str, simulators: Mapping[str, str], here: str) -> None:
    """Print a line on what differs, if anything does, once a process; the arguments are as above."""
    differences = rendering_differences(renderer, simulators, here)
    if differences:
        _warn(
            f"warning: the encoder's pictures are not rendered as those it was trained on ({'; '.join(differences)}); "
            "its latents may differ"
        )


def warn_of_workers_rendering(encoder: str, envs: Any) -> None:
    """Print such a line for environments in processes of their own, which render alike.

    Args:
        encoder: the path of the encoder whose latents they give.
        envs: a vector of them.
    """
    _, description = read_description(encoder)
    packages = description.get("packages", {})
    simulators = {name: packages[name] for name in SIMULATORS if name in packages}
    warn_of_other_rendering(description.get("renderer", ""), simulators, envs.get_attr("gl_renderer")[0])


@functools.cache
def _warn(line: str) -> None:
    print(" ".join(line.split()), file=sys.stderr, flush=True)
