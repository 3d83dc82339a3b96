"""Compares a map's picture with a camera's: errors, exposure, figures. Pure.

Pictures are float32 (height, width, 3) of RGB, 0 to 1; masks are bool (height, width), true of
pixels that count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.rendering import psnr_of

Picture = NDArray[np.float32]
Mask = NDArray[np.bool_]

EXPLAINED_WITHIN = 0.1  # as Comparison.EXPLAINED_WITHIN
FULL_HEAT = 0.5  # error whose heat is white
LEFT_OUT = (0, 0, 64)  # colour of what a mask leaves out

CLIPPED = 1 / 255  # values this near to 0 and 1 say nothing of an exposure
HUBER = 0.05  # larger errors count less in the fit of an exposure
FIT_STEPS = 5
FIT_PIXELS = 20_000  # that the fit uses, at most

# Wang et al. 2004.
SIGMA, TRUNCATE = 1.5, 3.5  # of their window of 11 pixels
C1, C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Figures:
    """How near two pictures are, as Comparison has it."""

    psnr: float
    ssim: float
    explained: float


@dataclass(frozen=True)
class Exposure:
    """By channel: the camera's values are about gain * the map's + bias."""

    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def apply(self, picture: Picture) -> Picture:
        """The picture with this exposure, clipped to 0 to 1 as a camera's is."""
        exposed = picture * np.array(self.gain, np.float32) + np.array(self.bias, np.float32)
        clipped: Picture = np.clip(exposed, 0, 1)
        return clipped


def fit_exposure(rendered: Picture, real: Picture, mask: Mask) -> Exposure:
    """The exposure that takes one picture to the other, by least squares with Huber's weights.

    Pixels at either end of the camera's range don't count. A channel that is rendered
    the same everywhere keeps a gain of 1.
    """
    gains, biases = [], []
    for channel in range(3):
        camera_s = real[..., channel]
        counts = mask & (camera_s > CLIPPED) & (camera_s < 1 - CLIPPED)
        some = slice(None, None, 1 + int(counts.sum()) // FIT_PIXELS)
        x, y = (a[counts][some].astype(np.float64) for a in (rendered[..., channel], camera_s))
        gain, bias = 1.0, 0.0
        for _ in range(FIT_STEPS if len(x) > 1 else 0):
            error = np.abs(gain * x + bias - y)
            weight = HUBER / np.maximum(error, HUBER)
            weight /= weight.sum()
            mean_x, mean_y = weight @ x, weight @ y
            spread = float(weight @ (x - mean_x) ** 2)
            together = float(weight @ ((x - mean_x) * (y - mean_y)))
            gain = together / spread if spread > 1e-8 else 1.0
            bias = float(mean_y - gain * mean_x)
        gains.append(gain)
        biases.append(bias)
    return Exposure(tuple(gains), tuple(biases))  # type: ignore[arg-type]


def errors(rendered: Picture, real: Picture) -> NDArray[np.float32]:
    """(height, width) root mean square of the errors of red, green and blue."""
    rms: NDArray[np.float32] = np.sqrt(np.mean((rendered - real) ** 2, axis=-1))
    return rms


def figures(rendered: Picture, real: Picture, mask: Mask) -> Figures:
    """Figures of the pixels that count. Raises ValueError if none does."""
    if not mask.any():
        raise ValueError("the mask leaves no pixel")
    rms = errors(rendered, real)[mask].astype(np.float64)
    psnr = psnr_of(float(np.mean(rms**2)))
    return Figures(psnr, _ssim(rendered, real, mask), float(np.mean(rms <= EXPLAINED_WITHIN)))


def _ssim(rendered: Picture, real: Picture, mask: Mask) -> float:
    """Takes masked pixels as equal, so that they don't lower the values of their neighbours."""
    from scipy.ndimage import gaussian_filter  # takes its time

    total = 0.0
    for channel in range(3):
        b = real[..., channel]
        a = np.where(mask, rendered[..., channel], b)

        def blurred(values: NDArray[np.float32]) -> NDArray[np.float32]:
            blur: NDArray[np.float32] = gaussian_filter(values, SIGMA, truncate=TRUNCATE)
            return blur

        mean_a, mean_b = blurred(a), blurred(b)
        var_a, var_b = blurred(a * a) - mean_a**2, blurred(b * b) - mean_b**2
        covariance = blurred(a * b) - mean_a * mean_b
        similarity = (2 * mean_a * mean_b + C1) * (2 * covariance + C2)
        similarity /= (mean_a**2 + mean_b**2 + C1) * (var_a + var_b + C2)
        total += float(similarity[mask].mean(dtype=np.float64))
    return total / 3


def heat(rms: NDArray[np.float32], mask: Mask) -> NDArray[np.uint8]:
    """Errors (height, width) as colours, black, red, yellow, white: a difference picture, RGB."""
    t = 3 * rms[..., None] / FULL_HEAT - np.arange(3, dtype=np.float32)
    colours = (255 * np.clip(t, 0, 1) + 0.5).astype(np.uint8)
    colours[~mask] = LEFT_OUT
    return colours
