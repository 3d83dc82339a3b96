"""What `simplify --psnr` promises, at views that it never saw."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from rosplat_core.cameras import orbit
from rosplat_core.formats import load, save
from rosplat_core.rendering import CpuRenderer, psnr_of
from rosplat_lab.bench.scenes import fence
from rosplat_tools.simplify.command import main


def test_a_fence_keeps_its_bound_in_views_that_nobody_chose(tmp_path: Path) -> None:
    """Over the pixels that show it: most of these pictures is black."""
    scene, out, report = (tmp_path / name for name in ("fence.ply", "out.ply", "report.json"))
    save(scene, fence())
    assert main([str(scene), str(out), "--psnr", "40", "--report", str(report)]) == 0
    whole, fewer = CpuRenderer(fence()), CpuRenderer(load(out))
    assert len(load(out)) < 0.97 * len(fence())
    errors = []
    for elevation in (0.05, 0.3, 0.6, 0.9):
        for camera in orbit(
            [[-2, -1, 0], [2, 1, 2]], 4, width=640, height=360, elevation=elevation, azimuth=0.4
        ):
            one, other = whole.render(camera), fewer.render(camera)
            shown = one[..., 3] > 0.1
            differs = np.clip(one[..., :3], 0, 1) - np.clip(other[..., :3], 0, 1)
            errors.append(np.square(differs[shown]).mean())
    assert psnr_of(float(np.mean(errors))) >= 40 - 0.3
    assert psnr_of(float(np.max(errors))) >= json.loads(report.read_text())["worst"] - 1
