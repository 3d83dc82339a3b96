"""What a lidar measures in a map: a range and an intensity along each of its rays. Knows no ROS.

How it works. A lidar's rays are dealt to the faces of a cube around it. A face is a picture that
the rasteriser blends along the rays themselves, not at pixels: splats answer as they do in the
model that was trained along rays, whatever the map's model, so that a splat counts where the ray
comes nearest to its middle, and a flat one where the ray crosses its plane. The range is that of
the splat that leaves half of the light or less. A ray to which no splat does that has none: what is
translucent, or not in the map, answers nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rosplat_core.cameras import Camera
from rosplat_core.lens_warps import Samples
from rosplat_core.models import Model
from rosplat_core.rendering import CpuRenderer, posed

Array = NDArray[np.float64]

FOCAL = 128.0  # of a face: tiles, 7 degrees wide, decide how many splats a ray tries [px]
AXES = np.concatenate([np.eye(3), -np.eye(3)])  # of faces
NEAREST = 0.01  # depth of a splat on a face [m]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Rays of one turn, column by column as they are sent: n = columns * rings of them."""

    azimuths: Array
    """(columns,) from x towards y. [rad]"""
    elevations: Array
    """(rings,) above the plane of x and y, ascending. [rad]"""

    @classmethod
    def of(
        cls, rings: int, columns: int, lowest: float, highest: float, width: float = 2 * np.pi
    ) -> Pattern:
        """Rings from the lowest to the highest elevation [rad], evenly. width: from the first
        column to beyond the last one, around x [rad]; less than a full turn: a solid-state lidar.
        """
        azimuths = width * ((np.arange(columns) + 0.5) / columns - 0.5)
        return cls(azimuths, np.linspace(lowest, highest, rings))

    @property
    def rays(self) -> Array:
        """(n, 3) unit vectors in the lidar's frame: x forward, z up."""
        azimuth, elevation = (
            values.ravel() for values in np.meshgrid(self.azimuths, self.elevations, indexing="ij")
        )
        flat = np.cos(elevation)
        return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True, eq=False)
class Scan:
    """What was measured, (n,) each, in the order of the pattern's rays."""

    ranges: NDArray[np.float32]
    """Along the rays [m]; inf where nothing answers."""
    intensities: NDArray[np.float32]
    """Brightness of what answers, 0 to 255; 0 where nothing does."""


class Lidar:
    """Measures with a pattern of rays, again and again."""

    def __init__(self, pattern: Pattern, nearest: float = 0.05, farthest: float = 100.0) -> None:
        """nearest, farthest: ranges between which something answers. [m]"""
        self.pattern = pattern
        self.limits = nearest, farthest
        """Ranges between which something answers. [m]"""
        rays = pattern.rays
        self._count = len(rays)
        facing = np.argmax(rays @ AXES.T, axis=1)
        self._faces = [
            _Face.of(rays[chosen], chosen, axis, farthest)
            for number, axis in enumerate(AXES)
            if len(chosen := np.flatnonzero(facing == number))
        ]

    def scan(
        self, renderer: CpuRenderer, map_to_lidar: Array, beside: Sequence[CpuRenderer] = ()
    ) -> Scan:
        """Measures the renderer's map, and maps beside it in the same frame.

        map_to_lidar: (4, 4) rigid transform. [m]
        """
        ranges = np.full(self._count, np.inf, np.float32)
        intensities = np.zeros(self._count, np.float32)
        with _along_rays([renderer, *beside]):
            for face in self._faces:
                ranges[face.rays], intensities[face.rays] = face.scan(
                    renderer, map_to_lidar, beside
                )
        missed = ~((ranges >= self.limits[0]) & (ranges <= self.limits[1]))
        ranges[missed], intensities[missed] = np.inf, 0
        return Scan(ranges, intensities)


@contextmanager
def _along_rays(renderers: Sequence[CpuRenderer]) -> Iterator[None]:
    """For the block, these draw by a model that is evaluated along rays."""
    before = [renderer.settings.model for renderer in renderers]
    for renderer in renderers:
        if renderer.model not in (Model.RAY, Model.DISC):
            renderer.settings.model = Model.RAY
    try:
        yield
    finally:
        for renderer, model in zip(renderers, before, strict=True):
            renderer.settings.model = model


@dataclass(frozen=True, eq=False)
class _Face:
    """The rays that a face of the cube takes."""

    camera: Camera  # its world is the lidar's frame
    rays: NDArray[np.intp]  # their numbers, tile by tile
    samples: Samples
    lengths: NDArray[np.float32]  # of rays whose depth on the face is 1

    @classmethod
    def of(cls, rays: Array, numbers: NDArray[np.intp], axis: Array, farthest: float) -> _Face:
        to_face = np.eye(4)
        to_face[0, :3] = AXES[(int(np.abs(axis).argmax()) + 1) % 3]
        to_face[1, :3], to_face[2, :3] = np.cross(axis, to_face[0, :3]), axis
        turned = rays @ to_face[:3, :3].T
        places = FOCAL * turned[:, :2] / turned[:, 2:]
        low = np.floor(places.min(axis=0)) - 1
        width, height = (np.ceil(places.max(axis=0)) + 1 - low).astype(int).tolist()
        order, samples = Samples.of(places - low, width, height, (0.0, 0.0, 1.0))
        left, top = (-low).tolist()
        return cls(
            Camera(0, width, height, FOCAL, FOCAL, left, top, to_face, near=NEAREST, far=farthest),
            numbers[order],
            samples,
            (1 / turned[order, 2]).astype(np.float32),
        )  # fmt: skip

    def scan(
        self, renderer: CpuRenderer, map_to_lidar: Array, beside: Sequence[CpuRenderer]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        pose = self.camera.world_to_camera @ map_to_lidar
        drawn = renderer.draw(
            posed(Camera(**(vars(self.camera) | {"world_to_camera": pose}))),
            beside=list(beside), samples=self.samples, median_depth=True,
        )  # fmt: skip
        depth, colour = drawn["depth"][:, 0], drawn["colour"]
        answers = np.isfinite(depth)
        ranges = np.where(answers, depth * self.lengths, np.float32(np.inf))
        brightness = colour[:, :3].clip(0, 1).mean(axis=1) / np.maximum(colour[:, 3], 1e-6)
        return ranges, np.where(answers, 255 * brightness.clip(0, 1), 0).astype(np.float32)
