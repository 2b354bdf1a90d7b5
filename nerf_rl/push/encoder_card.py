"""The card of an encoder: what it sees, what its latent knows, how to load it."""

import json
import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np

from nerf_rl.pretrain.measures.figures import describe_error, describe_iou
from nerf_rl.push.card import (
    NO_SUMMARY,
    UNKNOWN,
    Naming,
    code,
    front_matter,
    installing,
    joined,
    last_sections,
    picture,
    table,
)
from nerf_rl.scenes.base import GYM, METAWORLD


def encoder_card(naming: Naming, description: Mapping[str, Any], summary: Mapping[str, Any]) -> str:
    """Return the card's text.

    Args:
        naming: of the encoder.
        description: content of its ``encoder.json``.
        summary: content of its ``summary.json``, empty if it has none.
    """
    scene, validation = description["scene"]["name"], summary.get("validation") or {}
    address = shlex.quote(naming.address)
    acting = f"nerf-rl train-rl --encoder {address} --scene {scene} --out runs/agent"
    sizes = description["architecture"]
    metrics = {name: validation.get(key) for name, key in _METRICS.items()}
    cameras = description["rig"]
    latent = f"a vector of {sizes['latent']} numbers" if "latent" in sizes else "a vector"
    return joined(
        [
            front_matter(naming, "image-feature-extraction", _TAGS, metrics, scene),
            f"# {naming.name}",
            f"A frozen multi-view encoder for the scene `{scene}`: it turns the pictures of {len(cameras['names'])} "
            f"cameras at one moment into {latent} that carries the scene's state, for an agent to act on. "
            f"{_taught(description)}",
            *picture(naming, "Held-out frames: what the cameras saw, above what the latent decodes to"),
            "## Scene and cameras",
            describe_cameras(description),
            "## Figures",
            *_figures(summary),
            "## How to load it",
            installing(naming),
            code("python", *_PYTHON.format(address=json.dumps(naming.address, ensure_ascii=False)).splitlines()),
            "or, on the command line,",
            code(
                "sh",
                *([acting] if scene.startswith((METAWORLD, GYM)) else []),
                f"nerf-rl probe --encoder {address} --data DATASET",
                f"nerf-rl view {address} --data DATASET",
            ),
            *last_sections(naming, _made(description, summary), description.get("packages", {})),
        ]
    )


def describe_cameras(description: Mapping[str, Any]) -> str:
    """Return a table of an encoder's cameras, and what else belongs to them.

    Args:
        description: content of an ``encoder.json``.
    """
    rig = description["rig"]
    rows = []
    for name, intrinsics, pose in zip(rig["names"], rig["intrinsics"], rig["camera_from_world"], strict=True):
        matrix = np.array(pose)
        rotation, position = matrix[:3, :3], -matrix[:3, :3].T @ matrix[:3, 3]
        fields = [intrinsics[0][0], *position, *rotation[2]]
        size = f"{rig['width']} x {rig['height']}"
        numbers = [f"{round(value, 3) + 0.0:.3f}" for value in fields[1:]]  # no -0.000
        rows.append([name, size, f"{fields[0]:.1f}", ", ".join(numbers[:3]), ", ".join(numbers[3:])])
    heads = ["camera", "pixels", "focal length [pixels]", "position [m]", "looks along"]
    followed = rig.get("tracking_frame")
    where = "in the world" if followed is None else f"relative to the body `{followed['body']}`, which they follow"
    lines = [table(heads, rows), "", f"Positions are {where}; axes are those of OpenCV (x right, y down, z forward)."]
    if description.get("classes"):
        lines.append(f"Classes: {', '.join(description['classes'])}.")
    if description.get("renderer"):
        lines.append(
            f"Pictures were rendered by {description['renderer']}; other renderers give slightly other latents."
        )
    return "\n".join(lines)


def _taught(description: Mapping[str, Any]) -> str:
    objective = description.get("objective", "field")
    if objective == "field":
        return "It was trained through a radiance field that is conditioned on this vector (SNeRL)."
    return "It was not trained." if objective == "random" else f"It was trained by the objective `{objective}`."


def _figures(summary: Mapping[str, Any]) -> list[str]:
    """Return the figures of the run's own summary."""
    if not summary:
        return [NO_SUMMARY]
    parts, validation = [], summary.get("validation") or {}
    if validation:
        told = {title: what for title, what in _VALIDATION.items() if what[0] in validation}
        rows = [[title, _number(validation[key], factor)] for title, (key, factor) in told.items()]
        parts += ["On held-out frames, from its own cameras:", table(["", ""], rows)]
    if summary.get("class_iou"):
        shares = summary.get("class_share", {})
        rows = [
            [name, describe_iou(iou), f"{100 * shares[name]:.1f} %" if name in shares else UNKNOWN]
            for name, iou in summary["class_iou"].items()
        ]
        parts.append(table(["class", "IoU", "share of pixels"], rows))
    for kind, what in (("probe", "state"), ("joint_probe", "joint")):
        untrained = summary.get(f"{kind}_random_encoder", {})
        rows = [
            [name, describe_error(found), f"{found['r2']:.3f}", describe_error(untrained.get(name, {}))]
            for name, found in summary.get(kind, {}).items()
        ]
        if rows:
            parts.append(
                table([f"{what}, by a linear probe of the latent", "RMSE", "R2", "untrained encoder, RMSE"], rows)
            )
    return parts or ["Its run measured nothing."]


def _made(description: Mapping[str, Any], summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    return [
        ("training steps", summary.get("steps")),
        ("seconds", summary.get("training_seconds", summary.get("seconds"))),
        ("device", summary.get("device")),
        ("precision", summary.get("precision")),
        ("sha256 of the dataset", description.get("dataset", {}).get("sha256")),
    ]


def _number(value: float | None, factor: float) -> str:
    return UNKNOWN if value is None else f"{factor * value:.2f}"


_TAGS = ("representation-learning", "neural-radiance-field", "multi-view")
_METRICS = {"psnr": "psnr_db", "mean_iou": "miou", "depth_mae_m": "depth_mae_m"}
_VALIDATION = {
    "PSNR [dB]": ("psnr_db", 1.0),
    "SSIM": ("ssim", 1.0),
    "mean IoU of the classes": ("miou", 1.0),
    "depth error [cm]": ("depth_mae_m", 100.0),
}
_PYTHON = """from nerf_rl.pretrain.model.encoder import Encoder

encoder = Encoder.load({address})
z = encoder.standardise(encoder.encode(images))  # u8 [B, V, H, W, 3] of the cameras above, in their order -> [B, Z]"""
