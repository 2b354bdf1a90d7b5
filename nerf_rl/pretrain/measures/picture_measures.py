"""How pictures that a field renders differ from what the cameras saw, over many frames and all processes."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from numpy import ndarray
from torch import Tensor, nn
from torchmetrics import MeanMetric
from torchmetrics.classification import MulticlassConfusionMatrix, MulticlassJaccardIndex
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from nerf_rl.pretrain.model.precision import in_full_precision
from nerf_rl.pretrain.model.ray_rendering import RenderedImages

_MOST_DB = 100.0  # of a view: one without any error has a mean with others
_LEAST_SIZE = 6  # [pixels] of an image that SSIM's window, mirrored at the edges, fits on


class PictureFigures(NamedTuple):
    """What pictures of held-out frames came to."""

    figures: dict[str, float | None]
    """``psnr_db``, ``ssim``, ``miou`` and ``depth_mae_m``; None for what these pictures do not tell"""
    class_iou: dict[str, float | None]
    """by the class's name; None where neither truth nor rendering shows it"""
    class_share: dict[str, float]
    """of the true pixels, by the class's name"""


class PictureMeasures(nn.Module):
    """Gathers the differences of frames; those that processes share out are gathered from all of them.

    PSNR [dB] and SSIM (Wang et al. 2004, a Gaussian window of 11 pixels) are means over views. IoU is over the pixels
    of all views together. The error of depth [m] is the mean over frames of the mean over pixels whose true depth
    is below ``far``.

    Args:
        classes: names of the semantic classes, by id.
        far: depth beyond which everything is one backdrop [m].
    """

    def __init__(self, classes: Sequence[str], far: float):
        super().__init__()
        self._classes, self._far = tuple(classes), far
        self.psnr, self.ssim, self.depth = (MeanMetric().set_dtype(torch.float64) for _ in range(3))
        self.iou = MulticlassJaccardIndex(len(classes), average="none", validate_args=False)
        self.confusion = MulticlassConfusionMatrix(len(classes), validate_args=False)

    def update(self, rendered: RenderedImages, truth: Mapping[str, ndarray]) -> None:
        """Add a frame: ``rgb`` [V, H, W, 3] in [0, 1], class ids ``semantic`` and ``depth`` [m], both [V, H, W]."""
        device = self.psnr.device
        with in_full_precision(device):
            colours, true_colours = (_channels_first(image, device) for image in (rendered.rgb, truth["rgb"]))
            psnr = peak_signal_noise_ratio(colours, true_colours, data_range=1.0, reduction="none", dim=(1, 2, 3))
            self.psnr.update(psnr.clamp(max=_MOST_DB))
            if min(colours.shape[-2:]) >= _LEAST_SIZE:
                ssim = structural_similarity_index_measure(colours, true_colours, data_range=1.0, reduction="none")
                self.ssim.update(ssim)
            else:
                self.ssim.update(0.0, weight=0.0)
            labels, true_labels = (torch.from_numpy(ids).to(device) for ids in (rendered.semantic, truth["semantic"]))
            self.iou.update(labels, true_labels)
            self.confusion.update(labels, true_labels)
            depth, true_depth = (torch.from_numpy(depth).to(device) for depth in (rendered.depth, truth["depth"]))
            near = true_depth < self._far
            error = (depth - true_depth).abs()[near]
            self.depth.update(error.mean() if len(error) else 0.0, weight=float(len(error) > 0))

    def compute(self) -> PictureFigures | None:
        """Return the figures of all processes, or None if no process has seen a frame; all must call it."""
        count = len(self._classes)
        iou, confusion = self.iou.compute().reshape(count), self.confusion.compute().reshape(count, count)
        means = {"psnr_db": self.psnr, "ssim": self.ssim, "depth_mae_m": self.depth}
        figures = {name: _known(metric.compute()) for name, metric in means.items()}
        pixels = confusion.sum(1)
        if not int(pixels.sum()):
            return None
        seen = pixels + confusion.sum(0) > 0
        figures["miou"] = float(iou[seen].double().mean())
        class_iou = [float(value) if is_seen else None for value, is_seen in zip(iou, seen, strict=True)]
        shares = (pixels.double() / pixels.sum()).tolist()
        return PictureFigures(
            {name: figures[name] for name in ("psnr_db", "ssim", "miou", "depth_mae_m")},
            dict(zip(self._classes, class_iou, strict=True)),
            dict(zip(self._classes, shares, strict=True)),
        )

    def reset(self) -> None:
        """Forget all frames."""
        for metric in (self.psnr, self.ssim, self.depth, self.iou, self.confusion):
            metric.reset()


def _channels_first(image: ndarray, device: torch.device) -> Tensor:
    return torch.from_numpy(image).to(device).movedim(-1, 1)


def _known(mean: Tensor) -> float | None:
    return None if math.isnan(value := float(mean)) else value
