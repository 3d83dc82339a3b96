"""Figures of two pictures, and the exposure between them."""

from __future__ import annotations

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from rosplat_tools.cameras import comparison
from rosplat_tools.cameras.comparison import Exposure

RANDOM = np.random.default_rng(2)


def picture(seed: int = 0) -> np.ndarray:
    """Smooth enough to have a structure."""
    random = np.random.default_rng(seed)
    coarse = random.uniform(0.1, 0.8, (8, 10, 3))
    return np.repeat(np.repeat(coarse, 8, axis=0), 8, axis=1).astype(np.float32)


def everything(of: np.ndarray) -> np.ndarray:
    return np.ones(of.shape[:2], bool)


def test_figures_are_those_of_other_libraries() -> None:
    real = picture()
    rendered = np.clip(real + RANDOM.normal(scale=0.05, size=real.shape), 0, 1).astype(np.float32)
    found = comparison.figures(rendered, real, everything(real))
    assert found.psnr == pytest.approx(-10 * np.log10(np.mean((rendered - real) ** 2)), abs=1e-3)
    _, expected = structural_similarity(
        rendered.astype(float), real.astype(float), data_range=1.0, channel_axis=-1,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        full=True,
    )  # fmt: skip
    assert found.ssim == pytest.approx(expected.mean(), abs=1e-4)
    rms = np.sqrt(np.mean((rendered - real) ** 2, axis=-1))
    assert found.explained == pytest.approx(np.mean(rms <= 0.1))
    assert 0.5 < found.explained < 1


def test_equal_pictures_have_the_most() -> None:
    found = comparison.figures(picture(), picture(), everything(picture()))
    assert (found.psnr, found.explained) == (150.0, 1.0)
    assert found.ssim == pytest.approx(1)


def test_what_a_mask_leaves_out_does_not_count() -> None:
    real, mask = picture(), everything(picture())
    rendered = real.copy()
    rendered[10:30, 20:50] = 1
    mask[10:30, 20:50] = False
    assert comparison.figures(rendered, real, everything(real)).psnr < 20
    found = comparison.figures(rendered, real, mask)
    assert (found.psnr, found.explained) == (150.0, 1.0)
    assert found.ssim == pytest.approx(1)
    with pytest.raises(ValueError, match="the mask leaves no pixel"):
        comparison.figures(rendered, real, np.zeros_like(mask))


def test_an_exposure_is_found_beside_what_the_map_lacks() -> None:
    rendered = picture()
    true = Exposure((0.8, 1.1, 0.95), (0.05, -0.03, 0.02))
    real = true.apply(rendered)
    real[:16, :24] = (0.9, 0.1, 0.5)  # something new: a twelfth of the picture
    found = comparison.fit_exposure(rendered, real, everything(real))
    np.testing.assert_allclose(found.gain, true.gain, atol=0.02)
    np.testing.assert_allclose(found.bias, true.bias, atol=0.01)


def test_clipped_values_say_nothing_of_an_exposure() -> None:
    rendered = picture()
    real = Exposure((2.0, 2.0, 2.0)).apply(rendered)
    assert (real == 1).mean() > 0.2
    found = comparison.fit_exposure(rendered, real, everything(real))
    np.testing.assert_allclose(found.gain, 2, rtol=1e-3)


def test_a_flat_channel_keeps_its_gain() -> None:
    flat = np.full((20, 20, 3), 0.25, np.float32)
    found = comparison.fit_exposure(flat, flat + np.float32(0.5), everything(flat))
    np.testing.assert_allclose(found.gain, 1)
    np.testing.assert_allclose(found.bias, 0.5, rtol=1e-5)
    nothing = comparison.fit_exposure(flat, flat, ~everything(flat))
    assert nothing == Exposure()


def test_heat_goes_from_black_by_red_and_yellow_to_white() -> None:
    rms = np.array([[0, 1 / 6, 1 / 3, 0.5, 2.0, 0.3]], np.float32)
    mask = np.array([[True] * 5 + [False]])
    found = comparison.heat(rms, mask)[0].tolist()
    assert found == [
        [0, 0, 0], [255, 0, 0], [255, 255, 0], [255, 255, 255], [255, 255, 255], [0, 0, 64],
    ]  # fmt: skip
