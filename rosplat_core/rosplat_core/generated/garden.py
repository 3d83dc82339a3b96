"""A raked sand garden under a floating, iridescent knot.

Surfaces are covered by lattices of flat splats that grow as their number shrinks; sheen, highlights
and the knot's film of colours live in the bands of the spherical harmonics. z is up, units are
metres, the garden is four metres wide and its middle lies on the origin.
"""

from __future__ import annotations

import numpy as np

from rosplat_core.generated.surfaces import (
    GOLDEN,
    Array,
    Noise,
    Numbers,
    Part,
    Patch,
    constant,
    highlight,
    legendre_coefficients,
    surface,
    unit,
    zonal,
)

SUN = np.array([0.62, -0.38, 0.69]) / np.linalg.norm([0.62, -0.38, 0.69])
SUNLIGHT = np.array([1.0, 0.93, 0.80])
SKYLIGHT = np.array([0.36, 0.42, 0.55])

GARDEN_RADIUS = 2.0
RIPPLE = 0.105  # from crest to crest of the raked sand [m]
RIPPLE_HEIGHT = 0.013

KNOT_CENTER = np.array([0.0, 0.0, 0.98])
KNOT_TUBE = 0.115

# Rocks: centre x, y and half axes x, y, z. [m]
ROCKS = np.array(
    [
        [-1.02, 0.62, 0.40, 0.30, 0.42],
        [-0.62, 0.98, 0.20, 0.23, 0.20],
        [1.12, -0.72, 0.30, 0.24, 0.24],
        [0.95, 1.02, 0.17, 0.21, 0.13],
    ]
)


class Garden:
    """Each method of parts() makes one thing: its splats of the given numbers, out of a total."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._noise = Noise(rng)
        # A table of lengths along the knot, to look up the turn at which a share of it ends.
        turns = np.linspace(0, 2 * np.pi, 8193)
        lengths = np.linalg.norm(np.diff(_knot_curve(turns), axis=0), axis=1)
        self._knot_turns = turns
        self._knot_lengths = np.concatenate([[0], np.cumsum(lengths)])
        self._shadow = self._shadow_map()

    def parts(self) -> list[Part]:
        """Each thing's share of the splats, and the method that makes it."""
        return [
            (0.4605, self.sand),
            (0.31, self.knot),
            (0.13, self.rocks),
            (0.09, self.rim),
            (0.009, self.petals),
            (0.0005, self.motes),
        ]

    # --- Things --------------------------------------------------------------------------------

    def sand(self, numbers: Numbers, total: int) -> Patch:
        """The ground: a sunflower lattice, lifted into ripples."""
        radius = GARDEN_RADIUS * np.sqrt((numbers + 0.5) / total)
        angle = 2 * np.pi * GOLDEN * numbers
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        z, slope_x, slope_y, nearness = self._sand_height(x, y)
        points = np.column_stack([x, y, z])
        normals = unit(np.column_stack([-slope_x, -slope_y, np.ones_like(x)]))
        tangents = unit(np.cross(normals, np.column_stack([slope_x, slope_y, 0.02 + 0 * x])))
        spacing = np.sqrt(np.pi * GARDEN_RADIUS**2 / total)
        grain = 1 + 0.05 * self._rng.normal(size=len(x)) + 0.05 * self._noise.at(points * 0.7)
        albedo = np.array([0.93, 0.84, 0.69]) * grain[:, None]
        sunlit = 1 - 0.85 * self._shadow_at(points)
        open_sky = (1 - 0.55 * nearness) * (0.75 + 0.25 * (z / RIPPLE_HEIGHT + 1) / 2)
        color = _lit(albedo, normals, sunlit, open_sky)
        sh = constant(color) + highlight(normals, SUN, 0.10 * sunlit[:, None] * SUNLIGHT, 3.0)
        return surface(points, tangents, normals, spacing, sh, stretch=1.3)

    def knot(self, numbers: Numbers, total: int) -> Patch:
        """A trefoil with a film of colours that changes with the view, as a soap bubble's does."""
        length = self._knot_lengths[-1]
        share = (numbers + 0.5) / total
        turn = np.interp(share * length, self._knot_lengths, self._knot_turns)
        around = 2 * np.pi * GOLDEN * numbers
        center = _knot_curve(turn)
        along = unit(_knot_curve(turn + 1e-4) - _knot_curve(turn - 1e-4))
        side = unit(np.cross(along, center - KNOT_CENTER + [0, 0, 1e-3]))
        normals = np.cos(around)[:, None] * side + np.sin(around)[:, None] * np.cross(along, side)
        points = center + KNOT_TUBE * normals
        spacing = np.sqrt(length * 2 * np.pi * KNOT_TUBE / total)
        # Sides that face the knot's own middle see less of the sky.
        inward = 0.5 - 0.5 * (normals * unit(center - KNOT_CENTER)).sum(axis=1)
        light = 0.50 + 0.50 * np.clip(normals @ SUN, 0, 1) + 0.16 * normals[:, 2] - 0.22 * inward
        bounce = np.clip(-normals[:, 2], 0, 1)[:, None] * [0.16, 0.12, 0.07]
        sh = constant(bounce) + _film(normals, 0.5 + share + 0.05 * self._noise.at(points), light)
        sh += highlight(normals, SUN, np.tile([0.95, 0.90, 0.80], (len(points), 1)), 14.0)
        sh += _fresnel(normals, 0.30 * SKYLIGHT)
        return surface(points, along, normals, spacing, sh, stretch=1.6)

    def rocks(self, numbers: Numbers, total: int) -> Patch:
        """Basalt with moss on top: spheres by the golden angle, stretched and roughened."""
        areas = (ROCKS[:, 2] * ROCKS[:, 3] + ROCKS[:, 4] * (ROCKS[:, 2] + ROCKS[:, 3])) / 3
        ends = np.round(np.cumsum(areas / areas.sum()) * total).astype(int)
        rock = np.searchsorted(ends, numbers, side="right")
        firsts = np.concatenate([[0], ends[:-1]])
        number, per_rock = numbers - firsts[rock], (ends - firsts)[rock]
        # From just below the sand to the top.
        z = 1 - 1.35 * (number + 0.5) / per_rock
        angle = 2 * np.pi * GOLDEN * number
        ring = np.sqrt(1 - z**2)
        sphere = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])

        def shape(direction: Array) -> Array:
            rough = 1 + 0.13 * self._noise.at(direction * 0.8 + 7.0 * rock[:, None])
            center = np.column_stack([ROCKS[rock, :2], 0 * z])
            return center + ROCKS[rock, 2:] * direction * rough[:, None]

        points = shape(sphere)
        first = unit(np.cross(sphere, [0.3, 0.5, 0.81]))
        second = np.cross(sphere, first)
        step = 1e-3
        normals = unit(
            np.cross(
                shape(unit(sphere + step * first)) - points,
                shape(unit(sphere + step * second)) - points,
            )
        )
        spacing = np.sqrt(4 * np.pi * areas[rock] * 0.68 / per_rock)
        fine = self._noise.at(points * 3.0)
        moss = np.clip(2.2 * (normals[:, 2] + 0.35 * fine - 0.55), 0, 1)[:, None]
        speckle = 1 + 0.12 * self._rng.normal(size=(len(z), 1)) + 0.25 * fine[:, None]
        stone = np.array([0.30, 0.31, 0.34]) * speckle
        green = np.array([0.33, 0.40, 0.15]) * (speckle + 0.15)
        albedo = stone + moss * (green - stone)
        foot = np.clip(points[:, 2] / 0.12, 0, 1)
        color = _lit(albedo, normals, np.ones(len(z)), 0.35 + 0.65 * foot)
        gloss = 0.16 * (1 - moss) * SUNLIGHT
        sh = constant(color) + highlight(normals, SUN, gloss, 5.0)
        return surface(points, first, normals, spacing, sh, stretch=1.2)

    def rim(self, numbers: Numbers, total: int) -> Patch:
        """A lacquered frame around the sand."""
        turn = 2 * np.pi * (numbers + 0.5) / total
        around = 2 * np.pi * GOLDEN * numbers
        outward = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
        along = np.column_stack([-np.sin(turn), np.cos(turn), 0 * turn])
        up = np.array([0, 0, 1.0])
        width, height = 0.075, 0.095
        middle = GARDEN_RADIUS + 0.03
        across, rise = np.cos(around)[:, None], np.sin(around)[:, None]
        points = middle * outward + width * across * outward + height * rise * up
        normals = unit(across / width * outward + rise / height * up)
        spacing = np.sqrt(2 * np.pi * middle * np.pi * (width + height) / total)
        albedo = np.array([0.34, 0.055, 0.04]) * (1 + 0.08 * self._noise.at(points))[:, None]
        color = _lit(albedo, normals, 1 - 0.8 * self._shadow_at(points), np.full(len(turn), 0.8))
        gloss = np.tile(0.42 * SUNLIGHT, (len(turn), 1))
        sh = (
            constant(color)
            + highlight(normals, SUN, gloss, 8.0)
            + _fresnel(normals, 0.16 * SKYLIGHT)
        )
        return surface(points, along, normals, spacing, sh, stretch=1.5)

    def petals(self, numbers: Numbers, total: int) -> Patch:
        """Cherry petals: some drift down in a spiral, most lie on the sand already."""
        n = len(numbers)
        falling = self._rng.uniform(size=n) < 0.36
        angle = self._rng.uniform(0, 2 * np.pi, n)
        radius = GARDEN_RADIUS * np.sqrt(self._rng.uniform(0.02, 0.98, n))
        height = self._rng.uniform(0.1, 2.1, n)
        spiral = 2.4 * height + 2 * np.pi * self._rng.integers(0, 3, n) / 3
        angle = np.where(falling, spiral + 0.25 * self._rng.normal(size=n), angle)
        radius = np.where(falling, 0.55 + 0.5 * height + 0.1 * self._rng.normal(size=n), radius)
        x, y = radius * np.cos(angle), radius * np.sin(angle)
        ground, slope_x, slope_y, _ = self._sand_height(x, y)
        lying = unit(np.column_stack([-slope_x, -slope_y, np.ones(n)]))
        turned = unit(self._rng.normal(size=(n, 3)))
        normals = np.where(falling[:, None], turned, unit(lying + 0.15 * turned))
        points = np.column_stack([x, y, np.where(falling, height, ground + 0.006)])
        tangents = unit(np.cross(normals, self._rng.normal(size=(n, 3))))
        # A larger scene has more petals rather than finer ones, within limits.
        size = 0.0105 * self._rng.uniform(0.7, 1.2, n) * np.clip(3000 / total, 0.12, 4) ** 0.4
        white = self._rng.uniform(0, 1, (n, 1)) ** 2
        albedo = np.array([0.98, 0.55, 0.66]) + white * np.array([0.02, 0.33, 0.27])
        sunlit = 1 - 0.8 * np.where(falling, 0, self._shadow_at(points))
        # Falling petals are thin enough for light from the other side to shine through.
        facing_sun = np.where(falling[:, None], SUN, normals)
        color = _lit(albedo, facing_sun, sunlit, np.ones(n))
        scales = size[:, None] * np.array([1.0, 0.62, 0.08])
        sh = constant(color) + _fresnel(normals, np.array([0.10, 0.05, 0.06]))
        return Patch(points, tangents, normals, scales, np.full(n, 0.93), sh)

    def motes(self, numbers: Numbers, total: int) -> Patch:
        """Soft lights that hang in the air."""
        n = len(numbers)
        angle = self._rng.uniform(0, 2 * np.pi, n)
        radius = self._rng.uniform(0.7, 1.9, n)
        points = np.column_stack(
            [radius * np.cos(angle), radius * np.sin(angle), self._rng.uniform(0.25, 1.9, n)]
        )
        size = self._rng.uniform(0.004, 0.011, n) * np.clip(200 / total, 0.2, 4) ** 0.4
        color = np.array([1.0, 0.85, 0.5]) + self._rng.uniform(-0.1, 0.15, (n, 3))
        up = np.tile([0.0, 0.0, 1.0], (n, 1))
        along = np.tile([1.0, 0.0, 0.0], (n, 1))
        scales = np.repeat(size[:, None], 3, axis=1)
        return Patch(points, along, up, scales, self._rng.uniform(0.1, 0.45, n), constant(color))

    # --- Shape and light -----------------------------------------------------------------------

    def _sand_height(self, x: Array, y: Array) -> tuple[Array, Array, Array, Array]:
        """Height [m], its two slopes, and how close (0 to 1) the nearest rock is."""

        def height(x: Array, y: Array) -> tuple[Array, Array]:
            rings = np.hypot(x, y)  # around the knot in the middle
            phase, weight = rings, np.clip(1.5 - 1.6 * rings, 0, 1)
            nearest = np.full_like(x, np.inf)
            for rock_x, rock_y, half_x, half_y, _ in ROCKS:
                away = np.hypot(x - rock_x, y - rock_y)
                edge = away - half_x * half_y / np.maximum(
                    1e-9,
                    np.hypot(half_y * (x - rock_x), half_x * (y - rock_y)) / np.maximum(away, 1e-9),
                )
                closer = edge < nearest
                nearest = np.where(closer, edge, nearest)
            near_rock = np.clip(1.6 - 3.6 * nearest, 0, 1)
            phase = np.where(near_rock > 0, nearest, phase)
            weight = np.maximum(weight, near_rock)
            lines = 0.5 * (1 + np.cos(2 * np.pi * (y + 0.05 * np.sin(1.7 * x)) / RIPPLE))
            circles = 0.5 * (1 + np.cos(2 * np.pi * phase / RIPPLE))
            smooth = weight**2 * (3 - 2 * weight)
            return RIPPLE_HEIGHT * (smooth * circles + (1 - smooth) * lines), nearest

        step = 2e-3
        middle, nearest = height(x, y)
        slope_x = (height(x + step, y)[0] - height(x - step, y)[0]) / (2 * step)
        slope_y = (height(x, y + step)[0] - height(x, y - step)[0]) / (2 * step)
        return middle, slope_x, slope_y, np.exp(-np.maximum(nearest, 0) / 0.07)

    def _shadow_map(self) -> Array:
        """(256, 256) how much of the sun is hidden from the ground, over the garden's square."""
        turn = self._knot_turns
        around = 2 * np.pi * GOLDEN * np.arange(len(turn))
        blockers = [_knot_curve(turn)]
        along = unit(_knot_curve(turn + 1e-4) - _knot_curve(turn - 1e-4))
        side = unit(np.cross(along, [0.1, 0.2, 0.97]))
        for reach in (0.45, 0.9):
            ring = np.cos(around)[:, None] * side + np.sin(around)[:, None] * np.cross(along, side)
            blockers.append(blockers[0] + reach * KNOT_TUBE * ring)
        sphere = unit(np.random.default_rng(0).normal(size=(16384, 3)))
        for x, y, half_x, half_y, half_z in ROCKS:
            blockers.append(np.array([x, y, 0]) + np.abs([half_x, half_y, half_z]) * sphere)
        points = np.concatenate([b[b[:, 2] > 0] for b in blockers])
        ground = points[:, :2] - points[:, 2:] * SUN[:2] / SUN[2]
        edges = np.linspace(-1.1 * GARDEN_RADIUS, 1.1 * GARDEN_RADIUS, 257)
        hits, _, _ = np.histogram2d(ground[:, 0], ground[:, 1], bins=[edges, edges])
        frequency = np.fft.fftfreq(256)
        blur = np.exp(-2 * (np.pi * 1.6 * frequency) ** 2)
        blurred = np.fft.ifft2(np.fft.fft2(np.minimum(hits, 2)) * np.outer(blur, blur)).real
        return np.clip(blurred, 0, 1)

    def _shadow_at(self, points: Array) -> Array:
        """(n,) shadow at points (n, 3), bilinear, of the ground behind each, seen from the sun."""
        ground = points[:, :2] - points[:, 2:] * SUN[:2] / SUN[2]
        cells = (ground / (1.1 * GARDEN_RADIUS) + 1) * 128 - 0.5
        low = np.clip(np.floor(cells), 0, 254).astype(int)
        u, v = np.clip(cells - low, 0, 1).T
        x, y = low.T
        this = (1 - v) * self._shadow[x, y] + v * self._shadow[x, y + 1]
        next_ = (1 - v) * self._shadow[x + 1, y] + v * self._shadow[x + 1, y + 1]
        shadow: Array = (1 - u) * this + u * next_
        return shadow


def _knot_curve(turn: Array) -> Array:
    """(n, 3) trefoil knot at turns 0 to 2 pi."""
    x = np.sin(turn) + 2 * np.sin(2 * turn)
    y = np.cos(turn) - 2 * np.cos(2 * turn)
    z = -np.sin(3 * turn)
    # Upright, and turned a little so that no arm hides another from the front.
    tilt = np.radians(68)
    points = np.column_stack(
        [x, y * np.cos(tilt) - z * np.sin(tilt), y * np.sin(tilt) + z * np.cos(tilt)]
    )
    return KNOT_CENTER + 0.215 * points


def _lit(albedo: Array, normals: Array, sunlit: Array, open_sky: Array) -> Array:
    """(n, 3) colours of a matt surface under sun and sky."""
    sun = 0.78 * sunlit * np.clip(normals @ SUN, 0, 1)
    sky = open_sky * (0.62 + 0.38 * normals[:, 2])
    color: Array = albedo * (sun[:, None] * SUNLIGHT + sky[:, None] * SKYLIGHT)
    return color


def _fresnel(normals: Array, color: Array) -> Array:
    """(n, 16, 3) a rim of color (3,) where the surface is seen at a grazing angle."""
    rim = legendre_coefficients(lambda x: (1 - np.abs(x)) ** 2)
    return zonal(normals, (rim[:, None] * color)[None])


def _film(normals: Array, shift: Array, light: Array) -> Array:
    """(n, 16, 3) interference colours: each channel's phase moves with the angle of view.

    shift (n,) moves them along the surface by whole periods, light (n,) scales them.
    """
    cosine = legendre_coefficients(lambda x: np.cos(2 * np.pi * 0.55 * x))
    sine = legendre_coefficients(lambda x: np.sin(2 * np.pi * 0.55 * x))
    phase = 2 * np.pi * (shift[:, None] + np.array([0.0, 0.22, 0.42]))
    wave = np.cos(phase)[:, None] * cosine[:, None] - np.sin(phase)[:, None] * sine[:, None]
    profile = 0.30 * wave
    profile[:, 0] += np.array([0.50, 0.46, 0.56])
    return zonal(normals, light[:, None, None] * profile)
