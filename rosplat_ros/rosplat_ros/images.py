"""Pictures as messages, and masks from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from rosplat_core.log_text import shown
from rosplat_core.splats import InputError, check_kind
from rosplat_ros.messages import as_array

# By encoding, of 8 bits a channel: number of channels, and indices of red, green and blue.
_ENCODINGS = {
    "rgb8": (3, (0, 1, 2)),
    "bgr8": (3, (2, 1, 0)),
    "rgba8": (4, (0, 1, 2)),
    "bgra8": (4, (2, 1, 0)),
    "mono8": (1, (0, 0, 0)),
}


def to_image(pixels: NDArray[np.generic], encoding: str, header: Header | None = None) -> Image:
    """The message of pixels (height, width, ...), which are laid out as the encoding says."""
    height, width = pixels.shape[:2]
    step = pixels.nbytes // height
    return Image(
        header=header or Header(), encoding=encoding, height=height, width=width, step=step,
        data=as_array("B", pixels),
    )  # fmt: skip


def to_bytes(colours: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Values of 0 to 1 as bytes, rounded; values beyond are clamped."""
    return (255 * np.clip(colours, 0, 1) + 0.5).astype(np.uint8)


def from_image(image: Image) -> NDArray[np.uint8]:
    """RGB (height, width, 3) of a message. Raises ValueError, naming the field."""
    check_kind(image, Image, "image")
    if image.encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise ValueError(f"encoding is '{shown(image.encoding, 40)}', known are {known}")
    channels, order = _ENCODINGS[image.encoding]
    size, row = len(image.data), channels * image.width
    if not (image.height and row and image.step >= row and size >= image.step * image.height):
        raise ValueError(
            f"{size} bytes in steps of {image.step} are no {image.encoding} picture of "
            f"{image.width} x {image.height}"
        )
    data = np.frombuffer(image.data, np.uint8)[: image.step * image.height]
    rows = data.reshape(image.height, image.step)[:, :row]
    return rows.reshape(image.height, image.width, channels)[..., order]


def read_mask(path: str) -> NDArray[np.bool_]:
    """(height, width) true where a picture file isn't black. Raises InputError, naming the file."""
    try:
        with Picture.open(Path(path)) as picture:
            return np.asarray(picture.convert("L")) > 0
    except (OSError, SyntaxError, ValueError, Picture.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or "no picture, or too large a one"
        raise InputError(f"mask {shown(path)}: {reason}") from error
