"""The reference renderer against gsplat's pictures of trained scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rosplat_core.cameras import load_cameras
from rosplat_core.formats import load
from rosplat_lab.metrics import psnr
from rosplat_lab.reference import render


@pytest.mark.parametrize(
    ("name", "file", "index", "crop"),
    [
        ("wolf", "wolf.spz", 0, (400, 200, 880, 520)),
        ("wolf", "wolf.spz", 1, (400, 200, 880, 520)),
        ("playbot", "playbot", 0, (560, 300, 720, 420)),
    ],
)
def test_gsplat_draws_the_same(
    data_folder: Path,
    reference_folder: Path,
    name: str,
    file: str,
    index: int,
    crop: tuple[int, int, int, int],
) -> None:
    view = load_cameras(reference_folder / name / "cameras.json")[index]
    with Image.open(reference_folder / name / view.image) as image:
        theirs = np.asarray(image.crop(crop)) / 255  # Pillow keeps the upper 8 of 16 bits
    splats = load(data_folder / file)
    # Blending to the very end is not visible: 77 dB and more in 16 bits.
    gsplat: dict[str, Any] = {"min_transmittance": 1e-4}
    for settings in (gsplat, {}):
        ours = render(splats, view, crop=crop, **settings).rgba[..., :3]
        upper_bits = np.round(np.clip(ours, 0, 1) * 65535) // 256
        assert psnr(upper_bits / 255, theirs) > 60
