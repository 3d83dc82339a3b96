"""Metrics: known values, known limits, and pictures that can't be compared."""

import sys

import numpy as np
import pytest

from rosplat_core.rendering import MOST_PSNR
from rosplat_lab.metrics import Image, compare, flip, psnr, ssim, worst


def picture() -> Image:
    return np.random.default_rng(0).uniform(0.2, 0.8, (32, 40, 3))


def test_equal_pictures() -> None:
    expected = {"psnr": MOST_PSNR, "ssim": pytest.approx(1), "flip": 0, "worst": 0}
    assert compare(picture(), picture()) == expected


@pytest.mark.parametrize(("offset", "decibels"), [(0.1, 20), (0.01, 40), (-0.001, 60)])
def test_psnr_of_a_constant_error(offset: float, decibels: float) -> None:
    assert psnr(picture() + offset, picture()) == pytest.approx(decibels)


def test_more_noise_is_worse_by_every_metric() -> None:
    noise = np.random.default_rng(1).normal(size=picture().shape)
    little, much = (compare(picture() + s * noise, picture()) for s in (0.01, 0.1))
    assert little["psnr"] > much["psnr"]
    assert little["ssim"] > much["ssim"]
    assert little["flip"] < much["flip"] < 1


def test_the_worst_pixel_hides_in_no_mean() -> None:
    changed = picture()
    changed[3, 5, 1] += 0.15
    assert worst(changed, picture()) == pytest.approx(0.15)
    assert psnr(changed, picture()) > 50


def test_without_flip_evaluator_the_rest_works(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    assert psnr(picture(), picture()) == MOST_PSNR
    with pytest.raises(RuntimeError, match="pip install flip-evaluator"):
        compare(picture(), picture())


def test_what_a_screen_cannot_show_does_not_count() -> None:
    bright = np.full((16, 16, 3), 1.0)
    assert compare(bright + 3, bright)["psnr"] == MOST_PSNR
    assert psnr(bright + 3, bright) < 0


def test_black_against_white() -> None:
    black, white = np.zeros((16, 16, 3)), np.ones((16, 16, 3))
    assert psnr(black, white) == 0
    assert ssim(black, white) < 0.01
    assert flip(black, white) > 0.9


@pytest.mark.parametrize(
    ("test", "reason"),
    [
        (np.zeros((32, 41, 3)), "differ in shape"),
        (np.full((32, 40, 3), np.nan), "not finite"),
    ],
)
def test_pictures_that_cannot_be_compared(test: Image, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        compare(test, picture())
    with pytest.raises(ValueError, match="height, width, 3"):
        compare(np.zeros((4, 4)), np.zeros((4, 4)))
