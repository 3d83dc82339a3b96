"""How far a picture is from its reference: PSNR, SSIM, FLIP and the worst pixel.

Pictures are (height, width, 3) arrays of display-encoded RGB, 0 to 1, as splats are trained on.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from rosplat_core.rendering import psnr_of

Image = NDArray[np.floating[Any]]
Pixels = NDArray[np.float64]
LEAST_SIDE = 11  # of pictures that SSIM compares [px]


def compare(test: Image, reference: Image) -> dict[str, float]:
    """psnr, ssim, flip and worst of what a screen shows: both pictures are clipped to 0..1 first.

    Raises ValueError for pictures of different shape or with numbers that are not finite.
    """
    test, reference = (np.clip(image, 0, 1) for image in _checked(test, reference))
    return {
        "psnr": psnr(test, reference),
        "ssim": ssim(test, reference),
        "flip": flip(test, reference),
        "worst": worst(test, reference),
    }


def psnr(test: Image, reference: Image) -> float:
    """Peak signal-to-noise ratio over all pixels and channels, peak 1. [dB]"""
    test, reference = _checked(test, reference)
    return psnr_of(float(np.mean((test - reference) ** 2)))


def ssim(test: Image, reference: Image) -> float:
    """Mean structural similarity, 1 if equal (Wang et al. 2004, with their Gaussian window).

    Raises ValueError for pictures smaller than the window of 11 pixels.
    """
    test, reference = _checked(test, reference)
    similarity = structural_similarity(  # type: ignore[no-untyped-call]
        test,
        reference,
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(similarity)


def flip(test: Image, reference: Image) -> float:
    """Mean LDR-FLIP, 0 if equal: what is seen when one flips between the two.

    Andersson et al. 2020, at their tool's default of 67 pixels per degree. Raises RuntimeError
    where that isn't installed.
    """
    try:
        import flip_evaluator
    except ImportError as error:
        raise RuntimeError("FLIP needs flip-evaluator: pip install flip-evaluator") from error
    test, reference = (image.astype(np.float32) for image in _checked(test, reference))
    _, mean, _ = flip_evaluator.evaluate(reference, test, "LDR", applyMagma=False)
    return float(mean)


def worst(test: Image, reference: Image) -> float:
    """The largest difference of any pixel in any channel; 1 is black for white."""
    test, reference = _checked(test, reference)
    return float(np.abs(test - reference).max())


def _checked(test: Image, reference: Image) -> tuple[Pixels, Pixels]:
    a, b = np.asarray(test, np.float64), np.asarray(reference, np.float64)
    if a.shape != b.shape:
        raise ValueError(f"pictures differ in shape: {a.shape}, {b.shape}")
    if a.ndim != 3 or a.shape[2] != 3 or not a.size:
        raise ValueError(f"expected pictures of shape (height, width, 3), got {a.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError("a picture holds numbers that are not finite")
    return a, b
