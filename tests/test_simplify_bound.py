"""What `simplify --psnr` promises, at views that it never saw."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from rosplat_core.cameras import orbit
from rosplat_core.formats import load, save
from rosplat_core.harmonics import C0
from rosplat_core.rendering import CpuRenderer, psnr_of
from rosplat_core.splats import Splats
from rosplat_lab.simplify.command import main


def fence() -> Splats:
    """Thin dark wires, across and upright, with bright inlays, above a bare ground."""
    random = np.random.default_rng(0)
    wires, pieces = 60, 80
    number, along = np.divmod(np.arange(wires * pieces), pieces)
    across = number % 2 == 1
    place = (number + 0.5) / wires - 0.5
    along = (along + 0.5) / pieces - 0.5
    wire = np.stack(
        [np.where(across, 4 * along, 4 * place), 0.02 * across,
         1 + np.where(across, 2 * place, 2 * along)], axis=1,
    )  # fmt: skip
    thin = np.full((len(wire), 3), 0.002)
    thin[np.arange(len(wire)), np.where(across, 0, 2)] = np.where(across, 0.025, 0.0125)
    grey = np.where(random.uniform(size=len(wire)) < 0.1, 0.9, 0.25)
    ground = np.hstack([random.uniform(-2.5, 2.5, (1500, 2)), np.zeros((1500, 1))])
    values = np.concatenate([grey, random.uniform(0.2, 0.3, 1500)])
    return Splats(
        np.concatenate([wire, ground]),
        np.tile([0, 0, 0, 1.0], (len(values), 1)),
        np.concatenate([thin, np.tile([0.08, 0.08, 0.005], (1500, 1))]),
        np.full(len(values), 0.9),
        np.repeat((values - 0.5) / C0, 3).reshape(-1, 1, 3),
        up=(0, 0, 1),
    )


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
