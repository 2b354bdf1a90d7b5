"""What may teach an encoder but a radiance field: its own pictures, where things are in them, and the true state."""

import copy
import math
from abc import ABC, abstractmethod
from itertools import pairwise

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from nerf_rl.pretrain.config import ANCHORS
from nerf_rl.pretrain.data.view_batches import ViewBatch
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.precision import in_full_precision
from nerf_rl.pretrain.objectives.losses import SEGMENTATION, anchor_loss, segmentation_loss

_MOST_SHIFT = 1 / 16  # of an image's size, as CURL's 4 pixels of 64
_KEY_MOMENTUM = 0.99
_HIDDEN_PATCHES, _PATCHES_ACROSS = 0.5, 8
_GREY = 128


class Objective(nn.Module, ABC):
    """Gives the losses of a batch. A subclass may have networks of its own, which are not kept with the encoder.

    Args:
        encoder: to train.
        columns: of the true state that vary.
        classes: that move.
    """

    def __init__(self, encoder: Encoder, columns: int, classes: int):
        super().__init__()

    @abstractmethod
    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return losses by name, which are added.

        Args:
            encoder: to train.
            batch: to train it on.
            generator: of what is random.
        """


class Autoencoder(Objective):
    """All views are painted from z; squared error of colours in [0, 1]."""

    def __init__(self, encoder: Encoder, columns: int, classes: int):
        super().__init__(encoder, columns, classes)
        self.decoder = PictureDecoder(encoder, channels=3)

    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the error of the pictures."""
        painted = self.decoder(encoder(batch.images, batch.projections))
        return {"rgb": F.mse_loss(painted, _colours(batch.images))}


class DepthPrediction(Objective):
    """The depth of all views is painted from z; mean error as a share of the range of depths."""

    def __init__(self, encoder: Encoder, columns: int, classes: int):
        super().__init__(encoder, columns, classes)
        self.decoder = PictureDecoder(encoder, channels=1)

    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the error of depth."""
        painted = self.decoder(encoder(batch.images, batch.projections))
        return {"depth": F.l1_loss(painted[:, :, 0], batch.depth)}


class MaskedAutoencoder(Autoencoder):
    """What is hidden from the encoder is painted from z: one view of each scene, and half of the patches of the others.

    After multi-view masked autoencoding (Seo et al., "Multi-View Masked World Models for Visual Robotic Manipulation",
    ICML 2023), with the convolutional encoder and z as the only way through.
    """

    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the error of hidden pixels."""
        images = batch.images
        scenes, views, height, width = images.shape[:4]
        across = (scenes, views, _PATCHES_ACROSS, _PATCHES_ACROSS)
        hidden = torch.rand(across, generator=generator, device=images.device) < _HIDDEN_PATCHES
        if views > 1:
            view = torch.randint(views, (scenes,), generator=generator, device=images.device)
            hidden[torch.arange(scenes, device=images.device), view] = True
        mask = F.interpolate(hidden.float(), (height, width))[:, :, None]
        shown = torch.where(mask.bool().movedim(2, -1), _GREY, images)
        painted = self.decoder(encoder(shown, batch.projections))
        error = (painted - _colours(images)) ** 2 * mask
        return {"rgb": error.sum() / (3.0 * mask.sum().clamp_min(1.0))}


class Contrastive(Objective):
    """Two shifted copies of a scene know each other among all others of the batch.

    CURL (Laskin et al. 2020): random shifts, a key encoder that follows slowly, a bilinear similarity, InfoNCE.
    """

    def __init__(self, encoder: Encoder, columns: int, classes: int):
        super().__init__(encoder, columns, classes)
        self.key_encoder = copy.deepcopy(encoder).requires_grad_(False)
        self.similarity = nn.Parameter(torch.rand(encoder.latent_size, encoder.latent_size))

    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the cross-entropy of finding one's own copy."""
        with torch.no_grad():
            for key, own in zip(self.key_encoder.parameters(), encoder.parameters(), strict=True):
                key.lerp_(own, 1.0 - _KEY_MOMENTUM)
            keys = self.key_encoder(shifted(batch.images, generator), batch.projections)
        queries = encoder(shifted(batch.images, generator), batch.projections)
        with in_full_precision(queries.device):
            logits = queries @ self.similarity @ keys.T
        return {"contrast": F.cross_entropy(logits, torch.arange(len(logits), device=logits.device))}


class StateRegression(Objective):
    """The true state is a linear function of z; squared error in deviations. It shows what pictures let z know."""

    def __init__(self, encoder: Encoder, columns: int, classes: int):
        super().__init__(encoder, columns, classes)
        self.head = nn.Linear(encoder.latent_size, columns)

    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the error of the state."""
        latent = encoder(batch.images, batch.projections)
        with in_full_precision(latent.device):
            return {"state": F.mse_loss(self.head(latent), batch.state)}


class AnchorRegression(Objective):
    """Where the cameras see each class that moves is a linear function of z: the field's anchors, without the field.

    Labels and depth tell it, as in a field's anchor loss; nothing is rendered, and no true state is needed.
    """

    def __init__(self, encoder: Encoder, columns: int, classes: int):
        super().__init__(encoder, columns, classes)
        self.head = nn.Linear(encoder.latent_size, 3 * classes)

    def forward(self, encoder: Encoder, batch: ViewBatch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the error of the places, and of the encoder's own segmentation."""
        latent, landmarks = encoder.read(batch.images, batch.projections)
        with in_full_precision(latent.device):
            places = self.head(latent).reshape(batch.middles.shape)
            named = {"anchor": anchor_loss(places - batch.middles, batch.seen)}
        if landmarks is not None:
            named[SEGMENTATION] = segmentation_loss(landmarks.logits, batch.shares)
        return named


class PictureDecoder(nn.Module):
    """Paints all of an encoder's views from z, at its images' size.

    It mirrors the encoder: the same patches and channels from coarse to fine, so that painting a picture costs about
    what reading it does. With a last layer at full size a step takes nearly twice as long, and in the same time z
    learns less.

    Args:
        encoder: whose views to paint.
        channels: of a picture.
    """

    def __init__(self, encoder: Encoder, channels: int):
        super().__init__()
        rig, patch, widths = encoder.rig, encoder.config.patch, encoder.config.channels[::-1]
        self._size = (rig.height, rig.width)
        cell = patch * 2 ** (len(widths) - 1)  # pixels
        self._coarse = (math.ceil(rig.height / cell), math.ceil(rig.width / cell))
        self._shape = (len(rig.projections), channels)
        self.first = nn.Linear(encoder.latent_size, widths[0] * math.prod(self._coarse))
        blocks: list[nn.Module] = []
        for before, after in pairwise(widths):
            blocks += [nn.ReLU(), nn.Upsample(scale_factor=2), nn.Conv2d(before, after, 3, padding=1)]
        patches = nn.Conv2d(widths[-1], math.prod(self._shape) * patch**2, 3, padding=1)
        self.blocks = nn.Sequential(*blocks, nn.ReLU(), patches, nn.PixelShuffle(patch))

    def forward(self, latent: Float[Tensor, "B Z"]) -> Float[Tensor, "B V C H W"]:
        """Return the pictures."""
        coarse = self.first(latent).reshape(len(latent), -1, *self._coarse)
        height, width = self._size
        painted = self.blocks(coarse.contiguous(memory_format=torch.channels_last))[..., :height, :width]
        return painted.reshape(len(latent), *self._shape, height, width).float()


def shifted(images: UInt8[Tensor, "B V H W 3"], generator: torch.Generator) -> UInt8[Tensor, "B V H W 3"]:
    """Return images that are shifted by up to a sixteenth of their size, each by its own; edges are repeated."""
    scenes, views, height, width = images.shape[:4]

    def places(size: int) -> Tensor:
        most = max(round(_MOST_SHIFT * size), 1)
        drawn = torch.randint(-most, most + 1, (scenes * views, 1), generator=generator, device=images.device)
        return (torch.arange(size, device=images.device) + drawn).clamp(0, size - 1)

    rows, columns = places(height), places(width)
    image = torch.arange(scenes * views, device=images.device)[:, None, None]
    return images.flatten(0, 1)[image, rows[:, :, None], columns[:, None]].reshape(images.shape)


def _colours(images: UInt8[Tensor, "B V H W 3"]) -> Float[Tensor, "B V 3 H W"]:
    return images.movedim(-1, 2).float() / 255.0


OBJECTIVES: dict[str, type[Objective]] = {
    ANCHORS: AnchorRegression,
    "autoencoder": Autoencoder,
    "depth": DepthPrediction,
    "masked": MaskedAutoencoder,
    "contrastive": Contrastive,
    "supervised": StateRegression,
}
"""what :attr:`PretrainConfig.objective` names, beside the radiance field and a random encoder"""
