"""A clip of an episode with what the radiance field renders from each latent beside what the camera saw."""

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray

from nerf_rl.pictures.images import colour_depth, colour_labels, surface_limits
from nerf_rl.pretrain.config import SamplingConfig
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.pretrain.model.ray_rendering import render_images

_SAMPLING = SamplingConfig(rendering_stratified=24, rendering_importance=16)  # for the eye; figures take the run's own


def decoded_clip(
    view: UInt8[ndarray, "T S S 3"],
    images: UInt8[ndarray, "T V H W 3"],
    latents: Float[ndarray, "T Z"],
    field: RadianceField,
    rig: EncoderRig,
    palette: UInt8[ndarray, "C 3"],
) -> UInt8[ndarray, "T S W2 3"]:
    """Return frames: a view for people, the first encoder camera's image above its decoded colours, labels above depth.

    Args:
        view: what a camera for people saw.
        images: what the encoder's cameras saw.
        latents: as the encoder gave them, not standardised.
        field: trained with that encoder.
        rig: the encoder's cameras.
        palette: colours of the classes.
    """
    half = view.shape[1] // 2
    decoded = []
    for latent in torch.from_numpy(latents):
        pose = rig.camera_from_world[:1]
        decoded.append(render_images(field, latent, rig.intrinsics[:1], pose, rig.height, rig.width, _SAMPLING))
    limits = surface_limits(np.stack([images.depth for images in decoded]), field.bounds.far)
    frames = []
    for seen, image, rendered in zip(view, images[:, 0], decoded, strict=True):
        colours = (255 * rendered.rgb[0]).round().astype(np.uint8)
        depth = colour_depth(rendered.depth[0], *limits)
        left = np.concatenate([_scaled(image, half), _scaled(colours, half)])
        right = np.concatenate([_scaled(colour_labels(rendered.semantic[0], palette), half), _scaled(depth, half)])
        frames.append(np.concatenate([seen[: 2 * half], left, right], axis=1))
    return np.stack(frames)


def _scaled(image: UInt8[ndarray, "H W 3"], size: int) -> UInt8[ndarray, "S S 3"]:
    rows, columns = np.arange(size) * image.shape[0] // size, np.arange(size) * image.shape[1] // size
    return image[rows][:, columns]
