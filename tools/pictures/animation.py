"""Make README's moving picture from a finished `make demo`: a policy at work, what it sees and what its latent holds.

Run from the root of the checkout that made the demo:

    .venv/bin/python -m tools.pictures.animation --agent runs/demo/agent --out rl/results/drawer_open.webp
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from numpy import ndarray

from nerf_rl.files.atomic import atomic_write
from nerf_rl.pictures.images import colour_depth, colour_labels, surface_limits
from nerf_rl.pretrain.model.conditioned_field import ConditionedField
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import read_description
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.ray_rendering import RenderedImages
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.rollout import Rollout, rollout
from nerf_rl.viewer.drawing.pictures import caption, magnify, stack
from nerf_rl.viewer.pages.agent_pictures import decode_views

CELL = 112  # pixels of each camera's picture
GAP = 4  # pixels
SCENE = 3 * CELL + 2 * GAP  # pixels of the view for people, as high as the cameras' pictures together
HEADS = ("a camera sees", "colours from z", "labels from z", "depth from z")
QUALITY = 35


def main() -> None:
    """Act the episodes, decode their latents and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--agent", required=True, help="a run folder of train-rl, from an encoder with a field")
    parser.add_argument("--encoder", default="", help="where its encoder is now, if it has moved")
    parser.add_argument("--out", type=Path, required=True, help="the WebP")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 3], help="of the episodes")
    parser.add_argument("--every", type=int, default=2, help="show each n-th observation of an episode")
    parser.add_argument("--fps", type=float, default=4.0, help="pictures a second")
    parser.add_argument("--hold", type=float, default=1.0, help="for how long an episode's last picture stays [s]")
    options = parser.parse_args()

    policy = Policy.load(Path(options.agent), options.encoder)
    if policy.spec.encoder is None:
        raise SystemExit(f"{options.agent} acts on the true state: there is no latent to decode")
    folder, description = read_description(policy.spec.encoder)
    field, rig = RadianceField.load(folder).requires_grad_(False), Encoder.load(policy.spec.encoder).rig
    palette = np.array(description["palette"], np.uint8)
    frames: list[ndarray] = []
    for seed in options.seeds:
        episode = rollout(options.agent, seed, view_size=SCENE, policy=policy)
        print(f"seed {seed}: {episode.outcome()}", flush=True)
        frames += episode_frames(episode, seed, field, rig, palette, options.every)
        frames += frames[-1:] * round(options.hold * options.fps)
    write_webp(options.out, np.stack(frames), options.fps)
    print(f"{options.out}: {options.out.stat().st_size // 1000} kB, {len(frames)} pictures")


def episode_frames(
    episode: Rollout, seed: int, field: RadianceField, rig: EncoderRig, palette: UInt8[ndarray, "C 3"], every: int
) -> Iterator[UInt8[ndarray, "A B 3"]]:
    """Yield an episode's pictures, the last one always: the scene, and a row for each camera of the encoder.

    A row holds what the camera saw, and colours, labels and depth that the field renders for it from the latent.
    """
    assert episode.images is not None and episode.latents is not None  # the agent has an encoder
    last = len(episode.view) - 1
    steps = sorted({*range(0, last, every), last})
    decoded = [_decode(field, rig, episode.latents[step]) for step in steps]
    limits = surface_limits(np.stack([view.depth for views in decoded for view in views]), field.bounds.far)
    for step, views in zip(steps, decoded, strict=True):
        rows = [
            [
                seen,
                (255 * view.rgb[0]).round().astype(np.uint8),
                colour_labels(view.semantic[0], palette),
                colour_depth(view.depth[0], *limits),
            ]
            for seen, view in zip(episode.images[step], views, strict=True)
        ]
        succeeded = episode.success is not None and bool(episode.success[:step].any())
        outcome = ": success" if succeeded else ""
        left = stack([caption("the scene, for you to see", SCENE), magnify(episode.view[step], SCENE)], GAP)
        yield _beside(left, _table(rows), f"seed {seed}, action {step}{outcome}")


def write_webp(path: Path, frames: UInt8[ndarray, "T H W 3"], frames_per_second: float) -> None:
    """Write a WebP that plays in a loop: all colours, at a quarter of a GIF's bytes."""
    film = cv2.Animation()
    film.frames = [np.ascontiguousarray(frame[..., ::-1]) for frame in frames]
    film.durations = [round(1000 / frames_per_second)] * len(frames)
    film.loop_count = 0
    done, content = cv2.imencodeanimation(".webp", film, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    assert done
    with atomic_write(path) as aside:
        aside.write_bytes(content.tobytes())


def _decode(field: RadianceField, rig: EncoderRig, latent: ndarray) -> list[RenderedImages]:
    decoded = decode_views(ConditionedField(field, torch.from_numpy(latent)), rig)
    assert decoded is not None  # nothing newer is ever wanted here
    return decoded


def _table(rows: Sequence[Sequence[ndarray]]) -> UInt8[ndarray, "A B 3"]:
    lines = [_in_a_row([caption(head, CELL) for head in HEADS])]
    lines += [_in_a_row([magnify(picture, CELL) for picture in row]) for row in rows]
    return stack(lines, GAP)


def _in_a_row(pictures: Sequence[ndarray]) -> UInt8[ndarray, "A B 3"]:
    space = np.full((pictures[0].shape[0], GAP, 3), 255, np.uint8)
    return np.concatenate([part for picture in pictures for part in (picture, space)][:-1], axis=1)


def _beside(left: ndarray, right: ndarray, text: str) -> UInt8[ndarray, "A B 3"]:
    height = max(left.shape[0], right.shape[0])
    padded = [np.pad(p, ((0, height - p.shape[0]), (0, 2 * GAP), (0, 0)), constant_values=255) for p in (left, right)]
    picture = np.concatenate(padded, axis=1)
    return stack([picture, caption(text, picture.shape[1])])


if __name__ == "__main__":
    main()
