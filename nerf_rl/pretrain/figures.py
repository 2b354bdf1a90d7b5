"""What validation found, in words."""

from collections.abc import Mapping

UNKNOWN = "unknown"


def describe_validation(figures: Mapping[str, float | None]) -> str:
    """Return the figures of held-out frames as part of a sentence; what could not be measured is unknown."""
    depth = figures["depth_mae_m"]
    return (
        f"PSNR {figures['psnr_db']:.1f} dB, mIoU {figures['miou']:.2f}, "
        f"depth error {UNKNOWN if depth is None else f'{100 * depth:.1f} cm'}"
    )


def describe_iou(value: float | None) -> str:
    """Return the IoU of a class in words; that of a class which no held-out frame shows is unknown."""
    return UNKNOWN if value is None else f"{value:.2f}"
