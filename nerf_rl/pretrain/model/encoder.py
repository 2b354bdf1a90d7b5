"""The multi-view encoder and its exported artefact."""

from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy import ndarray
from torch import Tensor, nn

from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.files.json_files import write_json
from nerf_rl.files.tensor_files import filled, read_tensors, write_tensors
from nerf_rl.files.versions import package_versions
from nerf_rl.pretrain.config import EncoderConfig
from nerf_rl.pretrain.model.checkpoint_file import encoder_weights
from nerf_rl.pretrain.model.encoder_file import (
    DESCRIPTION,
    FORMAT,
    SIMULATORS,
    WEIGHTS,
    is_checkpoint,
    read_description,
)
from nerf_rl.pretrain.model.encoder_rig import EncoderRig
from nerf_rl.pretrain.model.landmarks import READ_MAPS, FoundLandmarks, Landmarks
from nerf_rl.pretrain.model.precision import in_full_precision

_LAYERS_PER_BLOCK = 3  # a convolution, its normalisation, its non-linearity


class Encoding(NamedTuple):
    """What an encoder makes of B scenes."""

    latent: Float[Tensor, "B Z"]
    """z"""
    landmarks: FoundLandmarks | None
    """what z has of them, if the encoder looks for any"""


class Encoder(nn.Module):
    """z = h(mean_i g(CNN(o_i), K_i)) over views i (SNeRL, section 4.1), and where landmarks are, as a linear part of z.

    There are non-linearities after the camera matrix has joined, so that a view's pose can change how its image is
    read.

    Args:
        config: sizes.
        rig: the cameras that it is trained on.
        landmarks: how many classes it looks for (:class:`~nerf_rl.pretrain.model.landmarks.Landmarks`); none if
            ``config.landmarks`` is false.

    Attributes:
        scene, quality, pixels_per_metre: what is rendered for it, and how.
        renderer: the OpenGL implementation that made its dataset, as that says; empty if it is not known.
        simulators: versions of the packages that decide what its dataset's pictures show, by name.
    """

    latent_mean: Tensor
    latent_std: Tensor

    def __init__(self, config: EncoderConfig, rig: EncoderRig, landmarks: int = 0):
        super().__init__()
        self.config, self.rig = config, rig
        self.scene, self.quality = "", "fast"
        self.pixels_per_metre: float | None = None
        self.renderer = ""
        self.simulators: dict[str, str] = {}
        patch, widths = config.patch, config.channels
        blocks: list[nn.Module] = [nn.Conv2d(3, widths[0], patch, stride=patch), _ChannelNorm(widths[0]), nn.ReLU()]
        for before, after in pairwise(widths):
            blocks += [nn.Conv2d(before, after, 3, stride=2, padding=1), _ChannelNorm(after), nn.ReLU()]
        self.convolutions = nn.Sequential(*blocks)
        flat, width = widths[-1] * config.cells(rig.height) * config.cells(rig.width), config.hidden
        self.per_view = nn.Sequential(*_hidden(flat + 12, width), *_hidden(width, width))
        self.merged = nn.Sequential(*_hidden(width, width), nn.Linear(width, config.latent))
        looks = config.landmarks and landmarks > 0
        self.landmarks = Landmarks(widths, landmarks, config.latent) if looks else None
        self.register_buffer("latent_mean", torch.zeros(config.latent))
        self.register_buffer("latent_std", torch.ones(config.latent))

    @property
    def latent_size(self) -> int:
        """Size of z."""
        return self.config.latent

    def forward(
        self, images: UInt8[Tensor, "B V H W 3"], projections: Float[Tensor, "B V 3 4"]
    ) -> Float[Tensor, "B Z"]:
        """Return z of B scenes from V views each.

        Args:
            images: RGB.
            projections: P = K [R | t] of each view [pixels, m], in the tracking frame if the rig follows a body.
        """
        return self.read(images, projections).latent

    def read(self, images: UInt8[Tensor, "B V H W 3"], projections: Float[Tensor, "B V 3 4"]) -> Encoding:
        """Return z as :meth:`forward` does, with the landmarks that it was made of."""
        batch, views = images.shape[:2]
        pixels = images.flatten(0, 1).permute(0, 3, 1, 2).to(projections.dtype) / 255.0 - 0.5
        maps = [pixels.contiguous(memory_format=torch.channels_last)]
        for block in range(0, len(self.convolutions), _LAYERS_PER_BLOCK):
            maps.append(self.convolutions[block : block + _LAYERS_PER_BLOCK](maps[-1]))
        seen = maps[-1].flatten(1)
        cameras = _in_parts(projections, self.rig.width, self.rig.height)
        each = self.per_view(torch.cat([seen, cameras.reshape(batch * views, 12).to(seen.dtype)], dim=-1))
        found = None
        if self.landmarks is not None:
            # of the pixels that are read; sizes are tensors while operations are recorded
            height, width = (self.config.patch * int(cells) for cells in maps[1].shape[-2:])
            found = self.landmarks(maps[1 : 1 + READ_MAPS], _in_parts(projections, width, height))
        with in_full_precision(each.device):
            latent = self.merged(each.to(projections.dtype).reshape(batch, views, -1).mean(1))
            if self.landmarks is not None and found is not None:
                latent = latent + self.landmarks.latent(found)
        return Encoding(latent, found)

    def encode(self, images: UInt8[Tensor, "B V H W 3"] | UInt8[ndarray, "B V H W 3"]) -> Float[Tensor, "B Z"]:
        """Return z of what the rig's own cameras saw; the images may be NumPy's, or on another device.

        Raises:
            UserError: they are of another size or kind, or not one of each camera.
        """
        pictures = torch.as_tensor(np.array(images) if isinstance(images, ndarray) else images)  # whatever its strides
        rig = self.rig
        seen, shape = tuple(map(int, pictures.shape)), (len(rig.names), rig.height, rig.width, 3)
        if seen[1:] != shape or pictures.dtype != torch.uint8:
            kind = str(pictures.dtype).removeprefix("torch.")
            told = f"{len(rig.names)} cameras, {rig.height} pixels high and {rig.width} wide"
            raise UserError(f"the encoder takes uint8 [B, {', '.join(map(str, shape))}] ({told}), got {kind} {[*seen]}")
        if not seen[0]:
            raise UserError("the encoder takes pictures of one moment at least, got those of none")
        device = self.latent_mean.device
        projections = torch.from_numpy(self.rig.projections).to(device)
        return self(pictures.to(device), projections.expand(len(pictures), -1, -1, -1))

    def standardise(self, latent: Float[Tensor, "B Z"]) -> Float[Tensor, "B Z"]:
        """Return latents with zero mean and unit deviation over the training data."""
        return (latent - self.latent_mean) / self.latent_std

    def untrained(self, seed: int = 0) -> "Encoder":
        """Return an encoder of the same architecture, rig and place with weights as at the beginning of a training."""
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            copy = self.anew().to(self.latent_mean.device)
        for name in ("scene", "quality", "pixels_per_metre", "renderer", "simulators"):
            setattr(copy, name, getattr(self, name))
        return copy.eval().requires_grad_(False)

    def anew(self) -> "Encoder":
        """Return an encoder of the same architecture and rig, with new weights, that looks for the same landmarks."""
        count = 0 if self.landmarks is None else len(self.landmarks.spread)
        copy = Encoder(self.config, self.rig, count)
        if self.landmarks is not None and copy.landmarks is not None:
            copy.landmarks.place(self.landmarks.usual_places, self.landmarks.spread)
        return copy

    def describe(self) -> dict[str, Any]:
        """Return what ``encoder.json`` says of the encoder itself; :meth:`described` reads it."""
        return {
            "format": FORMAT,
            "architecture": asdict(self.config),
            "landmarks": 0 if self.landmarks is None else len(self.landmarks.spread),
            "rig": self.rig.to_json(),
            "scene": {"name": self.scene, "quality": self.quality, "detail": self.pixels_per_metre},
            "renderer": self.renderer,
            "packages": {**package_versions(), **self.simulators},
        }

    def save(self, folder: Path, extra: dict[str, Any]) -> None:
        """Write ``encoder.safetensors`` and ``encoder.json``; ``extra`` joins the description."""
        write_tensors(folder / WEIGHTS, self.state_dict())
        write_json(folder / DESCRIPTION, {**self.describe(), **extra})

    @classmethod
    def described(cls, description: dict[str, Any]) -> "Encoder":
        """Return an untrained encoder that is otherwise the one described."""
        rig, landmarks = EncoderRig.from_json(description["rig"]), description.get("landmarks", 0)
        encoder = cls(EncoderConfig(**description["architecture"]), rig, landmarks)
        scene, packages = description["scene"], description.get("packages", {})
        encoder.scene, encoder.quality = scene["name"], scene["quality"]
        encoder.pixels_per_metre = scene.get("detail")
        encoder.renderer = description.get("renderer", "")
        encoder.simulators = {name: packages[name] for name in SIMULATORS if name in packages}
        return encoder

    @classmethod
    def load(cls, path: Path | str) -> "Encoder":
        """Read a frozen encoder.

        Args:
            path: a run folder, the folder or a file of an exported encoder, a Lightning checkpoint of a run, or an
                address on the Hub: ``hf://USER/NAME``, or ``hf://USER/NAME@REVISION`` (extra ``hub``).

        Raises:
            MissingFileError: there is no encoder at the path, or it is damaged.
            UserError: an address that nothing can be fetched from.
        """
        folder, description = read_description(path)
        file = Path(path) if is_checkpoint(path) else folder / WEIGHTS
        weights = encoder_weights(file) if is_checkpoint(path) else read_tensors(file)
        encoder = filled(lambda: cls.described(description), weights, file)
        if not bool((encoder.latent_std > 0).all()):
            raise MissingFileError("an encoder", file, "a deviation of its latents is not positive", "train it again")
        return encoder.eval().requires_grad_(False)


def _in_parts(projections: Float[Tensor, "B V 3 4"], width: int, height: int) -> Float[Tensor, "B V 3 4"]:
    """Return camera matrices that project to parts of a picture's width and height instead of pixels."""
    across, down, depth = projections.unbind(2)
    return torch.stack([across / width, down / height, depth], 2)


def _hidden(before: int, after: int) -> list[nn.Module]:
    """Return a hidden layer; normalised, since units of a plain one die while the field is still far off."""
    return [nn.Linear(before, after), nn.LayerNorm(after), nn.SiLU()]


class _ChannelNorm(nn.LayerNorm):
    """Normalises the channels of each place of an image; half the time of GroupNorm where channels come last."""

    def forward(self, maps: Float[Tensor, "B C H W"]) -> Float[Tensor, "B C H W"]:
        return super().forward(maps.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
