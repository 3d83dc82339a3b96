"""The picture of the view in which a simplified scene differs most."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rosplat_core.splats import InputError

ENDINGS = (".png", ".jpg")
WIDTH = 640  # of each of the three parts [px]
TIMES = 8  # by which differences are shown


def write(path: Path, whole: NDArray[np.float32], left: NDArray[np.float32]) -> None:
    """Writes, side by side, a view of the whole scene, of what is left, and TIMES the difference.

    whole, left: (height, width, 3), 0 to 1. Raises InputError when the file can't be written.
    """
    size = WIDTH, round(WIDTH * whole.shape[0] / whole.shape[1])
    bytes_of = (
        np.rint(255 * part.clip(0, 1)).astype(np.uint8)
        for part in (whole, left, TIMES * np.abs(left - whole))
    )
    parts = [Image.fromarray(part).resize(size, Image.Resampling.BOX) for part in bytes_of]
    try:
        Image.fromarray(np.hstack([np.asarray(part) for part in parts])).save(path)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
