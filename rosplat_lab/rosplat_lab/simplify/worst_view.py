"""The picture of the view in which a simplified scene differs most."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rosplat_core.splats import InputError

ENDINGS = (".png", ".jpg")
WIDTH = 640  # of each of the three parts [px]
TIMES = 8  # by which differences are shown


def write(path: Path, whole: NDArray[np.float32], left: NDArray[np.float32]) -> None:
    """Writes, side by side, a view of the whole scene, of what is left, and TIMES the difference.

    whole, left: (height, width, 3), 0 to 1. Raises InputError when the file can't be written.
    """
    height = round(WIDTH * whole.shape[0] / whole.shape[1])
    parts = [
        cv2.resize(part, (WIDTH, height), interpolation=cv2.INTER_AREA)
        for part in (whole, left, np.minimum(TIMES * np.abs(left - whole), 1))
    ]
    rgb = np.rint(255 * np.hstack(parts)).astype(np.uint8)
    try:
        path.write_bytes(cv2.imencode(path.suffix, rgb[..., ::-1])[1].tobytes())
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from error
