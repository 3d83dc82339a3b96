"""Pictures as messages, and masks from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture
from sensor_msgs.msg import Image

from rosplat_core.splats import InputError
from rosplat_ros.images import from_image, read_mask, to_bytes, to_image

PIXELS = np.random.default_rng(0).integers(0, 256, (3, 5, 3), dtype=np.uint8)


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("rgb8", PIXELS),
        ("bgr8", PIXELS[..., ::-1]),
        ("rgba8", np.dstack([PIXELS, PIXELS[..., :1]])),
        ("bgra8", np.dstack([PIXELS[..., ::-1], PIXELS[..., :1]])),
    ],
)
def test_pixels_come_back_as_red_green_blue(encoding: str, pixels: np.ndarray) -> None:
    np.testing.assert_array_equal(from_image(to_image(pixels, encoding)), PIXELS)


def test_grey_is_all_three() -> None:
    grey = from_image(to_image(PIXELS[..., 0], "mono8"))
    np.testing.assert_array_equal(grey, np.repeat(PIXELS[..., :1], 3, axis=2))


def test_rows_may_be_padded() -> None:
    image = to_image(np.pad(PIXELS.reshape(3, 15), ((0, 0), (0, 4))), "rgb8")
    image.width = 5
    np.testing.assert_array_equal(from_image(image), PIXELS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoding": "yuv422"}, "encoding is 'yuv422', known are rgb8, bgr8"),
        ({"step": 14}, "45 bytes in steps of 14 are no rgb8 picture of 5 x 3"),
        ({"height": 4}, "45 bytes in steps of 15 are no rgb8 picture of 5 x 4"),
        ({"width": 0}, "are no rgb8 picture of 0 x 3"),
        ({"height": 0}, "are no rgb8 picture of 5 x 0"),
    ],
)
def test_what_is_no_picture_names_the_field(change: dict[str, object], said: str) -> None:
    image: Image = to_image(PIXELS, "rgb8")
    for field, value in change.items():
        setattr(image, field, value)
    with pytest.raises(ValueError, match=said):
        from_image(image)


def test_bytes_are_rounded_and_clamped() -> None:
    values = np.array([-1, 0, 0.5, 1, 7, 1 / 510 + 1e-6], np.float32)
    assert to_bytes(values).tolist() == [0, 0, 128, 255, 255, 1]


def test_a_mask_is_what_is_not_black(tmp_path: Path) -> None:
    mask = PIXELS[..., 0] > 100
    Picture.fromarray(mask.astype(np.uint8) * 9).save(tmp_path / "mask.png")
    np.testing.assert_array_equal(read_mask(str(tmp_path / "mask.png")), mask)


def test_a_mask_that_is_too_large_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Picture.new("L", (5, 5)).save(tmp_path / "mask.png")
    monkeypatch.setattr(Picture, "MAX_IMAGE_PIXELS", 12)
    with pytest.raises(InputError, match=r"mask\.png: no picture, or too large a one"):
        read_mask(str(tmp_path / "mask.png"))
