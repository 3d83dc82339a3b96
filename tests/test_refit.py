"""Refitting against the float64 reference: gradients by central differences of its pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rosplat_core._core import Refit, RefitRates
from rosplat_core.cameras import Camera, look_at, resized
from rosplat_core.generated import generate
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer, Instructions, posed
from rosplat_core.simplification.judging import Judge, Trial
from rosplat_core.simplification.refitting import RATES, picture
from rosplat_core.simplification.views import Around
from rosplat_core.splats import Splats
from rosplat_lab.reference import render

Array = NDArray[np.float64]
STEP = 1e-6
COUNT = 14


@dataclass
class Exact:
    """Splats in float64, as trainers have them: what Splats would round."""

    positions: Array
    log_scales: Array
    orientations: Array
    logits: Array
    sh: Array
    model: Model
    origin: Array

    def __len__(self) -> int:
        return len(self.logits)

    def __getitem__(self, index: object) -> Exact:
        arrays = ("positions", "log_scales", "orientations", "logits", "sh")
        return replace(self, **{name: getattr(self, name)[index] for name in arrays})

    @property
    def scales(self) -> Array:
        return np.exp(self.log_scales)

    @property
    def opacities(self) -> Array:
        return 1 / (1 + np.exp(-self.logits))

    def values(self) -> Array:
        """(n, values) in the order of Refit's gradients."""
        n = len(self)
        parts = (self.positions, self.log_scales, self.orientations, self.logits[:, None])
        return np.hstack([*parts, self.sh.reshape(n, -1)])

    def with_values(self, values: Array) -> Exact:
        return replace(
            self, positions=values[:, :3], log_scales=values[:, 3:6], orientations=values[:, 6:10],
            logits=values[:, 10], sh=values[:, 11:].reshape(self.sh.shape),
        )  # fmt: skip


def scene(degree: int, model: Model) -> Exact:
    random = np.random.default_rng(degree)
    orientations = random.normal(size=(COUNT, 4))
    return Exact(
        positions=random.uniform(-0.5, 0.5, (COUNT, 3)),
        log_scales=np.log(random.uniform(0.03, 0.2, (COUNT, 3))),
        orientations=orientations / np.linalg.norm(orientations, axis=1, keepdims=True),
        logits=random.uniform(-1, 3, COUNT),
        sh=random.normal(size=(COUNT, (degree + 1) ** 2, 3)) * 0.3,
        model=model,
        origin=np.array([3.0, -2.0, 1.0]),
    )


def camera(orthographic: bool) -> Camera:
    focal = 24.0 if orthographic else 40.0
    view = look_at((3.4, -4.0, 1.3), (3.0, -2.0, 1.0))
    return Camera(0, 44, 36, focal, focal + 2, 21.0, 19.0, view, orthographic=orthographic)


def rounded(splats: Exact) -> Splats:
    return Splats(
        splats.positions.astype(np.float32), splats.orientations, splats.scales, splats.opacities,
        splats.sh, model=splats.model, origin=splats.origin,
    )  # fmt: skip


def refit_of(splats: Exact, instructions: Instructions = Instructions.BEST) -> Refit:
    return Refit(rounded(splats), instructions=instructions)


# Each two of them together.
@pytest.mark.parametrize(
    ("degree", "model", "orthographic"),
    [
        (0, Model.EWA, False), (0, Model.EWA_ANTIALIASED, True),
        (3, Model.EWA, True), (3, Model.EWA_ANTIALIASED, False),
    ],
)  # fmt: skip
def test_gradients_are_those_of_the_reference(
    degree: int, model: Model, orthographic: bool
) -> None:
    splats, seen = scene(degree, model), camera(orthographic)
    target = np.random.default_rng(7).uniform(0, 1, (seen.height, seen.width, 3))

    def error(values: Array) -> float:
        picture = render(splats.with_values(values), seen).rgba[..., :3]
        return float(np.mean(np.square(np.minimum(picture, 1) - target)))

    values = splats.values()
    rows, columns = np.indices(values.shape)
    # Of each splat a fifth of its harmonics, another fifth of the next one's.
    checked = (columns < 11) | ((rows + columns) % 5 == 0)
    if degree:
        checked[:, :3] = False  # colours change with the direction, which positions leave out
    expected = np.zeros_like(values)
    for index in map(tuple, np.argwhere(checked)):
        moved = [values.copy(), values.copy()]
        for side, sign in enumerate((1, -1)):
            moved[side][index] += sign * STEP
        expected[index] = (error(moved[0]) - error(moved[1])) / (2 * STEP)
    found_error, found = refit_of(splats).gradient_at(posed(seen), target.astype(np.float32))
    assert found_error == pytest.approx(error(values), rel=1e-5)
    found = np.where(checked, found, 0)
    for part in (slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 11), slice(11, None)):
        largest = np.abs(expected[:, part]).max()
        np.testing.assert_allclose(
            found[:, part], expected[:, part], rtol=2e-3, atol=2e-4 * largest
        )


def test_vector_instructions_make_no_difference() -> None:
    splats, seen = scene(3, Model.EWA), camera(orthographic=False)
    target = np.full((seen.height, seen.width, 3), 0.3, np.float32)
    plain, best = (
        refit_of(splats, instructions).gradient_at(posed(seen), target)
        for instructions in (Instructions.PLAIN, Instructions.BEST)
    )
    assert best[0] == pytest.approx(plain[0], rel=1e-5)
    np.testing.assert_allclose(best[1], plain[1], rtol=1e-3, atol=1e-5 * np.abs(plain[1]).max())


def test_a_gradient_is_the_sum_of_its_parts() -> None:
    """Whatever width a part has: nothing counts beyond its edge, where vectors of pixels reach."""
    splats, seen = scene(1, Model.EWA), camera(orthographic=False)
    target = np.full((seen.height, seen.width, 3), 0.3, np.float32)
    _, whole = refit_of(splats).gradient_at(posed(seen), target)
    parts = np.zeros_like(whole)
    for left, width in ((0, 19), (19, seen.width - 19)):
        part = posed(seen).crop(left, 0, width, seen.height)
        _, gradient = refit_of(splats).gradient_at(part, target[:, :width].copy())
        parts += gradient * (width / seen.width)
    np.testing.assert_allclose(parts, whole, rtol=1e-3, atol=1e-5 * np.abs(whole).max())


def test_a_part_of_a_view_has_that_view_s_pixels() -> None:
    splats, seen = scene(1, Model.EWA), posed(camera(orthographic=False))
    whole = picture(CpuRenderer(rounded(splats)), seen)
    part = seen.crop(9, 5, 20, 16)
    error, _ = refit_of(splats).gradient_at(part, np.ascontiguousarray(whole[5:21, 9:29]))
    assert error < 1e-5


def test_steps_bring_back_what_was_changed() -> None:
    """In views that no step was made towards."""
    full = generate(2000)
    start = replace(
        full, scales=1.3 * full.scales, opacities=0.8 * full.opacities, sh=full.sh + np.float32(0.1)
    )
    cameras = [resized(seen, 160 * 90) for seen in Around(full).cameras(240, 3)]
    renderer = CpuRenderer(full)
    fitting = Refit(start)
    rates = RefitRates(**{name: 3 * rate for name, rate in RATES.items()})
    for seen in map(posed, cameras):
        fitting.step(seen, picture(renderer, seen), rates)
    judge = Judge(Trial(full), [resized(seen, 160 * 90) for seen in Around(full).cameras(6, 4)])
    fitted = replace(start, **fitting.splats())
    assert judge(fitted).psnr > judge(start).psnr + 6


def test_arrays_of_different_lengths_are_refused() -> None:
    splats = scene(1, Model.EWA)
    torn = rounded(splats)
    object.__setattr__(torn, "opacities", torn.opacities[1:])
    with pytest.raises(ValueError, match="opacities: expected 1 values for each of 14 splats"):
        Refit(torn)
    with pytest.raises(ValueError, match="splat 2 has values that draw nothing"):
        splats.positions[2, 1] = np.nan
        refit_of(splats)
    target = np.zeros((2, 2, 3), np.float32)
    with pytest.raises(ValueError, match="target: expected RGB in each of the camera's pixels"):
        refit_of(scene(1, Model.EWA)).gradient_at(posed(camera(orthographic=False)), target)
