"""What validation and probes found, in words."""

from collections.abc import Mapping

UNKNOWN = "unknown"
UNITS = {"mm": " mm", "deg": "°"}
"""what the names of a probe's errors end with, and how that is written"""
RMSE, MEDIAN = "rmse", "median"
"""kinds of errors: the root of the mean square, and the middle one of all sizes, which a few frames cannot move"""
NETWORK = "network_"
"""what begins the names of a network probe's figures; those of the linear probe stand without it"""
_LEAST_SHARE = 0.002  # of the pixels, below which a class is too small to be judged by its IoU
_LEAST_IOU = 0.3


def describe_validation(figures: Mapping[str, float | None]) -> str:
    """Return the figures of held-out frames as part of a sentence; what could not be measured is unknown.

    An encoder without a radiance field has none, and earlier runs have no SSIM.
    """
    if not figures:
        return "no field to validate"
    depth, ssim, miou = figures["depth_mae_m"], figures.get("ssim"), figures["miou"]
    structure = "" if ssim is None else f"SSIM {ssim:.2f}, "
    return (
        f"PSNR {figures['psnr_db']:.1f} dB, {structure}mIoU {describe_iou(miou)}, "
        f"depth error {UNKNOWN if depth is None else f'{100 * depth:.1f} cm'}"
    )


def describe_error(figures: Mapping[str, float], kind: str = "", error: str = RMSE) -> str:
    """Return by how much a probe is off, with its unit; that of a probe which was not fitted is unknown.

    Args:
        figures: of one thing that was probed; earlier runs have no median.
        kind: of the probe, what the names of its figures begin with: :data:`NETWORK`, or nothing for the linear one.
        error: :data:`RMSE` or :data:`MEDIAN`.
    """
    for name, unit in UNITS.items():
        if (value := figures.get(f"{kind}{error}_{name}")) is not None:
            return f"{value:.1f}{unit}"
    return UNKNOWN


def describe_iou(value: float | None) -> str:
    """Return the IoU of a class in words; that of a class which no held-out frame shows is unknown."""
    return UNKNOWN if value is None else f"{value:.2f}"


def hardly_shown(class_iou: Mapping[str, float | None], class_share: Mapping[str, float]) -> list[str]:
    """Return the classes that held-out frames show and the field hardly does, so that z may not carry them."""
    return [
        name
        for name, iou in class_iou.items()
        if iou is not None and iou < _LEAST_IOU and class_share[name] >= _LEAST_SHARE
    ]


def describe_hardly_shown(names: list[str], class_iou: Mapping[str, float | None]) -> str:
    """Return what that means, as a sentence."""
    each = ", ".join(f"{name} (IoU {describe_iou(class_iou[name])})" for name in names)
    return f"the field hardly shows {each}: look at the probe before you trust the latent with it"
