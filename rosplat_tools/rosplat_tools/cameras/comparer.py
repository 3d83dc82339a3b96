"""A picture of a camera held against the map's, drawn for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image

from rosplat_core.lens_pictures import take_picture
from rosplat_core.lenses import LensError, Warp
from rosplat_core.log_text import shown
from rosplat_core.rendering import CpuRenderer
from rosplat_msgs.msg import Comparison
from rosplat_tools.cameras import calibrations, comparison
from rosplat_tools.cameras.health import NoPicture
from rosplat_tools.cameras.pose_history import Pose
from rosplat_tools.images import from_image, to_bytes


@dataclass(frozen=True, eq=False)
class Compared:
    """What came out."""

    figures: Comparison
    rendered: NDArray[np.uint8]
    """(height, width, 3) RGB of the map."""
    errors: NDArray[np.float32]
    """(height, width) of pixels, as comparison.errors."""
    mask: NDArray[np.bool_]
    """(height, width) the pixels that count."""
    warp: Warp
    world_to_lens: NDArray[np.float64]


class Comparer:
    """Draws a renderer's map for pictures. Keeps the lens from one to the next."""

    def __init__(
        self,
        renderer: CpuRenderer,
        *,
        rectified: bool = False,
        mask: NDArray[np.bool_] | None = None,
        near: float = 0.01,
        far: float = 1e6,
    ) -> None:
        """rectified: pictures are, by r and p of their CameraInfo. mask (height, width): false of
        pixels that don't count. near, far: splats between these depths are drawn [m].
        """
        self._renderer, self._rectified = renderer, rectified
        self.mask, self.near, self.far = mask, near, far
        self._lens: tuple[CameraInfo, Warp, NDArray[np.float64]] | None = None

    def compare(self, image: Image, info: CameraInfo | None, pose: Pose) -> Compared:
        """pose: of the optical frame in the map's. Raises NoPicture."""
        warp, rotation = self._warp_of(image, info)
        try:
            real = from_image(image)
        except ValueError as error:
            raise NoPicture("not read", error) from error
        mask = self._mask_of(warp)
        turned = np.eye(4)
        turned[:3, :3] = rotation
        world_to_lens = turned @ np.linalg.inv(pose)
        try:
            colour = take_picture(
                self._renderer, warp, world_to_lens, near=self.near, far=self.far
            ).colour
        except (RuntimeError, MemoryError) as error:
            raise NoPicture("not drawn", shown(error, 300) or "out of memory") from error
        rendered = to_bytes(colour)  # as a camera has it
        figures, errors = _measured(rendered, real, mask)
        figures.header = image.header
        figures.map_id, figures.revision = self._renderer.map.map_id, self._renderer.map.revision
        return Compared(figures, rendered, errors, mask, warp, world_to_lens)

    def _warp_of(self, image: Image, info: CameraInfo | None) -> tuple[Warp, NDArray[np.float64]]:
        if info is None:
            raise NoPicture("without a lens", "no CameraInfo has come on camera_info")
        if (image.width, image.height) != (info.width, info.height):
            raise NoPicture(
                "of another size",
                f"a picture is {image.width} x {image.height}, camera_info says "
                f"{info.width} x {info.height}",
            )
        if not self._lens or self._lens[0] is not info:
            try:
                if self._rectified:
                    lens, rotation = calibrations.rectified(info)
                else:
                    lens, rotation = calibrations.lens_of(info), np.eye(3)
                self._lens = info, Warp(lens), rotation
            except LensError as error:
                raise NoPicture("without a lens", f"camera_info is refused: {error}") from error
        return self._lens[1:]

    def _mask_of(self, warp: Warp) -> NDArray[np.bool_]:
        mask = self.mask
        if mask is None:
            return warp.met
        if mask.shape != warp.met.shape:
            raise NoPicture("of another size", "the mask has another size than pictures")
        if not (mask & warp.met).any():
            raise NoPicture("masked", "the mask leaves no pixel")
        return mask & warp.met


def _measured(
    rendered: NDArray[np.uint8], real: NDArray[np.uint8], mask: NDArray[np.bool_]
) -> tuple[Comparison, NDArray[np.float32]]:
    """The figures of two pictures, and the errors of pixels, (height, width)."""
    ours, theirs = (picture.astype(np.float32) / np.float32(255) for picture in (rendered, real))
    exposure = comparison.fit_exposure(ours, theirs, mask)
    plain = comparison.figures(ours, theirs, mask)
    fitted = comparison.figures(exposure.apply(ours), theirs, mask)
    message = Comparison(
        pixels=int(mask.sum()),
        psnr=plain.psnr,
        ssim=plain.ssim,
        explained=plain.explained,
        gain=exposure.gain,
        bias=exposure.bias,
        fitted_psnr=fitted.psnr,
        fitted_ssim=fitted.ssim,
        fitted_explained=fitted.explained,
    )
    return message, comparison.errors(ours, theirs)
