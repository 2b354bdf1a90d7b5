"""What validation measures of pictures, against formulas written out in NumPy and OpenCV."""

import cv2
import numpy as np
import pytest

from nerf_rl.pretrain.measures.picture_measures import PictureFigures, PictureMeasures
from nerf_rl.pretrain.model.ray_rendering import RenderedImages

CLASSES, FAR = ("background", "drawer", "nowhere"), 2.0
FRAMES, VIEWS, SIZE = 4, 3, 17


def some_frames(size: int = SIZE) -> list[tuple[RenderedImages, dict[str, np.ndarray]]]:
    """Return pictures beside the truth; depth is beyond ``far`` here and there, and in all of the last frame."""
    rng = np.random.default_rng(0)
    shape, frames = (VIEWS, size, size), []
    for frame in range(FRAMES):
        rgb = cv2.GaussianBlur(rng.random((size, size, VIEWS * 3)), (5, 5), 1.0).reshape(size, size, VIEWS, 3)
        rgb = rgb.transpose(2, 0, 1, 3).astype(np.float32)
        depth = rng.uniform(0.5, 2.5, shape).astype(np.float32) + (5.0 if frame == FRAMES - 1 else 0.0)
        truth = {"rgb": rgb, "semantic": rng.integers(0, 2, shape), "depth": depth.astype(np.float32)}
        noise = rng.normal(size=rgb.shape) * np.linspace(0.02, 0.2, VIEWS)[:, None, None, None]
        labels = np.where(rng.random(shape) < 0.2, 1 - truth["semantic"], truth["semantic"])
        seen = (rgb + noise).clip(0, 1).astype(np.float32), labels, (depth + 0.1 * rng.random(shape)).astype(np.float32)
        frames.append((RenderedImages(*seen), truth))
    return frames


def measured(frames: list[tuple[RenderedImages, dict[str, np.ndarray]]]) -> PictureFigures:
    measures = PictureMeasures(CLASSES, FAR)
    for rendered, truth in frames:
        measures.update(rendered, truth)
    figures = measures.compute()
    assert figures is not None
    return figures


def structural_similarity(image: np.ndarray, other: np.ndarray) -> float:
    """Return SSIM of two images in [0, 1] by Wang et al. (2004), equation 13, as a mean over pixels and channels."""

    def local(values: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(values, (11, 11), 1.5, borderType=cv2.BORDER_REFLECT_101)

    image, other = image.astype(np.float64), other.astype(np.float64)
    mean, other_mean = local(image), local(other)
    variance, other_variance = local(image**2) - mean**2, local(other**2) - other_mean**2
    covariance = local(image * other) - mean * other_mean
    alike = (2 * mean * other_mean + 0.01**2) * (2 * covariance + 0.03**2)
    return float((alike / ((mean**2 + other_mean**2 + 0.01**2) * (variance + other_variance + 0.03**2))).mean())


def test_figures_are_those_of_the_formulas():
    frames = some_frames()
    figures, class_iou, class_share = measured(frames)
    pairs = [(rendered.rgb[v], truth["rgb"][v]) for rendered, truth in frames for v in range(VIEWS)]
    decibels = [-10 * np.log10(((image.astype(float) - true) ** 2).mean()) for image, true in pairs]
    assert figures["psnr_db"] == pytest.approx(np.mean(decibels), abs=1e-5)
    assert figures["ssim"] == pytest.approx(np.mean([structural_similarity(*pair) for pair in pairs]), abs=1e-5)
    found, true = (np.stack([labels(frame) for frame in frames]) for labels in (found_labels, true_labels))
    for label, name in enumerate(CLASSES[:2]):
        expected = ((found == label) & (true == label)).sum() / ((found == label) | (true == label)).sum()
        assert class_iou[name] == pytest.approx(expected, abs=1e-6)
        assert class_share[name] == pytest.approx((true == label).mean(), abs=1e-9)
    assert class_iou["nowhere"] is None and class_share["nowhere"] == 0.0
    assert figures["miou"] == pytest.approx((class_iou["background"] + class_iou["drawer"]) / 2)  # type: ignore[operator]
    errors = [
        np.abs(rendered.depth - truth["depth"])[truth["depth"] < FAR].mean() for rendered, truth in frames[: FRAMES - 1]
    ]
    assert figures["depth_mae_m"] == pytest.approx(np.mean(errors), abs=1e-6)


def found_labels(frame: tuple[RenderedImages, dict[str, np.ndarray]]) -> np.ndarray:
    return frame[0].semantic


def true_labels(frame: tuple[RenderedImages, dict[str, np.ndarray]]) -> np.ndarray:
    return frame[1]["semantic"]


def test_a_perfect_picture_has_a_hundred_decibels_and_one_of_everything_else():
    (_, truth), *_ = some_frames()
    figures, *_ = measured([(RenderedImages(truth["rgb"], truth["semantic"], truth["depth"]), truth)])
    assert figures == pytest.approx({"psnr_db": 100.0, "ssim": 1.0, "miou": 1.0, "depth_mae_m": 0.0})


def test_what_pictures_do_not_tell_is_unknown():
    figures, *_ = measured(some_frames(size=5)[-1:])
    assert figures["depth_mae_m"] is None and figures["ssim"] is None
    assert figures["psnr_db"] is not None and figures["miou"] is not None


def test_a_reset_forgets_all_frames():
    first, second, *_ = some_frames()
    measures = PictureMeasures(CLASSES, FAR)
    measures.update(*first)
    measures.compute()
    measures.reset()
    with pytest.warns(UserWarning, match="before the"):
        assert measures.compute() is None
    measures.update(*second)
    assert measures.compute() == measured([second])
