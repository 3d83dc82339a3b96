"""Where blending fails: layers, faint splats, opaque ones, colours beyond 1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rosplat_lab.lab import fragments
from rosplat_lab.lab.atlas.case import Cases, Curves
from rosplat_lab.lab.atlas.stage import (
    HEIGHT,
    WIDTH,
    ahead,
    balls,
    cloud,
    decibels,
    outside,
    shown,
    some,
    truth,
)
from rosplat_lab.lab.bench import Bench, Image

CASES = Cases()


@CASES.enter("Layers of fog", "layers")
def layers(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    counts = [10, 1000] if quick else [10, 100, 1000, 10_000]
    curves: Curves = {"RGBA32F": [], "RGBA16F": [], "RGBA8 (model)": []}
    random = np.random.default_rng(0)
    for count in map(int, counts):
        positions = np.column_stack(
            [random.normal(scale=0.05, size=(count, 2)), np.linspace(2, 3, count)]
        )
        fog = balls(positions, 0.5, min(0.5, 3 / count), random.uniform(0.2, 1, (count, 3)))
        # Below 1/255 nothing is drawn: fewer, stronger layers where the fog would be thinner.
        fog = replace(fog, opacities=np.maximum(fog.opacities, np.float32(0.01)))
        camera = replace(ahead(), width=64, height=48, fx=60, fy=60, cx=32, cy=24)
        expected = truth(fog, camera)
        curves["RGBA32F"].append(decibels(shown(bench, fog, camera), expected))
        half = shown(bench, fog, camera, float_blending=False)
        curves["RGBA16F"].append(decibels(half, expected))
        coarse = fragments.picture(fog, camera, fragments.rounded(255))
        curves["RGBA8 (model)"].append(decibels(coarse, expected))
    return counts, curves


@CASES.enter("Faint splats and the cut at 1/255", "peak opacity")
def faint(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    opacities = some([0.003, 0.004, 0.006, 0.01, 0.03, 0.1, 0.3], quick)
    curves: Curves = {"ours against fog without a cut": [], "ours against the reference": []}
    camera = replace(ahead(), width=64, height=48, fx=60, fy=60, cx=32, cy=24)
    for opacity in opacities:
        count = round(1.5 / opacity)
        fog = balls(np.tile([0, 0, 2.0], (count, 1)), 0.3, opacity, 0.8)
        picture = shown(bench, fog, camera)
        y, x = np.mgrid[:48, :64] + 0.5
        variance = (60 * 0.3 / 2) ** 2 + 0.3
        gauss = np.exp(-((x - 32) ** 2 + (y - 24) ** 2) / (2 * variance))
        uncut = 0.8 * (1 - (1 - np.float32(opacity) * gauss) ** count)
        uncut_rgb = np.repeat(uncut[..., None], 3, axis=2)
        curves["ours against fog without a cut"].append(decibels(picture, uncut_rgb))
        curves["ours against the reference"].append(decibels(picture, truth(fog, camera)))
    return opacities, curves


@CASES.enter("Opaque walls and the cap at 0.99", "opaque layers before a white lamp", "lamp's leak")
def opaque(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    counts = some([1, 2, 3, 4], quick)
    curves: Curves = {"ours, 32F": [], "0.01^layers": []}
    for count in map(int, counts):
        positions = [[0, 0, 2 + 0.1 * i] for i in range(count + 1)]
        colors = [[0, 0, 0]] * count + [[1, 1, 1]]
        wall = balls(positions, 0.5, 1.0, np.array(colors))
        picture = shown(bench, wall, ahead())
        curves["ours, 32F"].append(float(f"{picture[HEIGHT // 2, WIDTH // 2].max():.3g}"))
        curves["0.01^layers"].append(float(f"{0.99 * 0.01**count:.3g}"))
    return counts, curves


@CASES.enter("Harmonics that overshoot", "amplitude of the bands above 0")
def overshoot(bench: Bench, quick: bool) -> tuple[Sequence[float], Curves]:
    amplitudes = some([0, 0.1, 0.3, 1, 3, 10], quick)
    curves: Curves = {"clamped at 0 (ours)": [], "clamped at 0 and 1 (model)": []}

    def clamped(band: fragments.Fragments) -> Image:
        return fragments.over(replace(band, colors=np.minimum(1, band.colors)))

    for amplitude in amplitudes:
        splats = cloud(400, degree=3)
        splats.sh[:, 1:] *= np.float32(amplitude / 0.3)
        expected = truth(splats, outside())
        curves["clamped at 0 (ours)"].append(decibels(shown(bench, splats, outside()), expected))
        curves["clamped at 0 and 1 (model)"].append(
            decibels(fragments.picture(splats, outside(), clamped), expected)
        )
    return amplitudes, curves
