"""Where a picture was taken, without a start: found among places from which the map was drawn.

Thumbnails of the map are drawn at the places, once, wider than the camera's view. A picture's
thumbnail is laid over each of them at every shift; normalised cross-correlation (Lewis 1995), which
knows no gain and no bias, tells where it fits best, and the shift how the camera was turned. From
the best few, a small picture is aligned, and the first that converges is aligned as it is. A place
that looks alike has many edges of its own: the gradients of both pictures must agree.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rosplat_core.alignment import (
    Alignment,
    _checked,
    _gradients,
    _masked_means,
    _means,
    _reduced,
    align,
)
from rosplat_core.cameras import Camera, look_at
from rosplat_core.rendering import CpuRenderer
from rosplat_core.splats import Splats

THUMBNAIL = 40  # longer side of a picture's thumbnail, at least [px]
MARGIN = 0.25  # by which the map's are wider on each side, as a share of that
FINER = 2  # pixels of the map's drawing that make one of a thumbnail, along each axis
SMALL = 80  # longer side of the picture in which candidates are aligned first, at least [px]
CANDIDATES = 16  # places that are aligned in the small picture, at most
LEAST_AGREEMENT = 0.75  # of the gradients of the small picture and the map's: their correlation
FLAT = 1e-4  # variance, below which a thumbnail shows nothing

Array = NDArray[np.float64]


class Relocaliser:
    """Thumbnails of a map from many places, to find where pictures of one camera were taken."""

    def __init__(
        self, scene: Splats | CpuRenderer, camera: Camera, places: Sequence[Array]
    ) -> None:
        """camera: its lens counts, not its pose. places: (4, 4) world to camera, each. [m]

        Raises ValueError for no place, or for what is none.
        """
        if not len(places):
            raise ValueError("places: expected one or more")
        if any(np.shape(each) != (4, 4) for each in places):
            raise ValueError("places: expected transforms (4, 4)")
        self._renderer = scene if isinstance(scene, CpuRenderer) else CpuRenderer(scene)
        self._camera, self._places = camera, [np.asarray(each, np.float64) for each in places]
        self._size = max(max(camera.width, camera.height) // THUMBNAIL, 1)
        self._thumbnail = _reduced(camera, self._size)
        self._margins = tuple(
            max(round(MARGIN * side), 1) for side in (self._thumbnail.height, self._thumbnail.width)
        )
        self._wide = wide = _widened(self._thumbnail, self._margins)
        thumbnails = np.stack(
            [self._drawn(replace(wide, world_to_camera=place))[..., :3] for place in self._places]
        )
        self._spectra = np.fft.rfft2(thumbnails, axes=(1, 2))
        self._spectra_of_squares = np.fft.rfft2(thumbnails**2, axes=(1, 2))

    def relocalise(
        self, picture: ArrayLike, mask: ArrayLike | None = None, *, patience: float = math.inf
    ) -> Alignment:
        """Finds where a picture was taken; picture, mask and what it raises: as of align().

        patience: time after which no other place is tried [s].
        """
        until = time.monotonic() + patience
        colours, counts = _checked(picture, self._camera, mask)
        scores = self._scores(*_masked_means(colours, counts, self._size))
        peaks = scores.reshape(len(scores), -1).max(axis=1)
        size = max(max(self._camera.width, self._camera.height) // SMALL, 1)
        small, shares = _masked_means(colours, counts, size)
        small[shares <= 0.5] = np.nan  # doesn't count
        camera = _reduced(self._camera, size)
        best: Alignment | None = None
        for number in np.argsort(-peaks)[:CANDIDATES]:
            shift = np.unravel_index(int(scores[number].argmax()), scores.shape[1:])
            start = replace(camera, world_to_camera=self._turned(number, shift))
            near = align(self._renderer, small, start, tries=1)
            if near.converged:
                start = replace(self._camera, world_to_camera=near.world_to_camera)
                found = align(self._renderer, colours, start, counts > 0, tries=1)
                at = replace(camera, world_to_camera=found.world_to_camera)
                if found.converged and self._agreement(at, small) >= LEAST_AGREEMENT:
                    return found
            if best is None or near.explained > best.explained:
                best = near
            if time.monotonic() > until:
                break
        assert best
        problem = f"none of {len(self._places)} places shows what the picture does"
        return replace(best, problem=problem, covariance=np.diag(np.full(6, np.inf)))

    def _agreement(self, camera: Camera, small: NDArray[np.float32]) -> float:
        """The correlation of the gradients of the map and a picture from a camera, -1 to 1."""
        drawn = self._drawn(camera)
        ours, theirs = (np.stack(_gradients(each)) for each in (drawn[..., :3], small))
        shown = (drawn[..., 3] > 0.5) & np.isfinite(theirs).all(axis=(0, 3))
        ours, theirs = ours[:, shown], theirs[:, shown]
        norms = float(np.linalg.norm(ours)) * float(np.linalg.norm(theirs))
        return float(np.sum(ours * theirs)) / max(norms, 1e-9)

    def _drawn(self, camera: Camera) -> NDArray[np.float32]:
        """(height, width, 4) of a small camera, as means of a finer drawing."""
        finer = replace(
            camera, width=FINER * camera.width, height=FINER * camera.height,
            fx=FINER * camera.fx, fy=FINER * camera.fy, cx=FINER * camera.cx, cy=FINER * camera.cy,
        )  # fmt: skip
        return _means(self._renderer.render(finer), FINER)

    def _scores(self, thumbnail: NDArray[np.float32], shares: NDArray[np.float32]) -> Array:
        """(places, shifts down, shifts right) normalised cross-correlations with a picture's
        thumbnail (height, width, 3), whose pixels count by shares (height, width).
        """
        counts = shares[..., None].astype(np.float64)
        total = max(float(counts.sum()), 1e-6)
        centred = thumbnail - (thumbnail * counts).sum(axis=(0, 1)) / total
        together = self._laid(self._spectra, centred * counts).sum(axis=-1)
        sums = self._laid(self._spectra, counts)
        squares = self._laid(self._spectra_of_squares, counts)
        theirs = np.maximum(squares - sums**2 / total, FLAT * total).sum(axis=-1)
        ours = max(float(np.sum(centred**2 * counts)), FLAT * total)
        return np.asarray(together / np.sqrt(ours * theirs))

    def _laid(self, spectra: NDArray[np.complex128], weights: Array) -> Array:
        """Sums weighted by (height, width, c), laid over each thumbnail at every shift."""
        shape = self._wide.height, self._wide.width
        spectrum = np.conj(np.fft.rfft2(weights, shape, axes=(0, 1)))
        down, right = (2 * margin + 1 for margin in self._margins)
        return np.fft.irfft2(spectra * spectrum, shape, axes=(1, 2))[:, :down, :right]

    def _turned(self, number: int, shift: tuple[np.intp, ...]) -> Array:
        """(4, 4) world to camera of a place's camera, turned to what is at a shift."""
        camera = self._thumbnail
        down, right = (int(s) - margin for s, margin in zip(shift, self._margins, strict=True))
        ray = right / camera.fx, down / camera.fy, 1.0
        return look_at((0.0, 0.0, 0.0), ray, (0.0, -1.0, 0.0)) @ self._places[number]


def relocalise(
    scene: Splats | CpuRenderer,
    picture: ArrayLike,
    camera: Camera,
    places: Sequence[Array],
    mask: ArrayLike | None = None,
) -> Alignment:
    """Finds where a picture was taken, near one of the places; see Relocaliser, which is to be kept
    for further pictures.
    """
    return Relocaliser(scene, camera, places).relocalise(picture, mask)


def _widened(camera: Camera, margins: tuple[int, ...]) -> Camera:
    down, right = margins
    return replace(
        camera, width=camera.width + 2 * right, height=camera.height + 2 * down,
        cx=camera.cx + right, cy=camera.cy + down,
    )  # fmt: skip
