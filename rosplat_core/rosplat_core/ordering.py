"""The order in which splats are blended for a camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rosplat_core import _core
from rosplat_core.cameras import Camera
from rosplat_core.depth import INVISIBLE, splat_extents
from rosplat_core.posed_camera import PosedCamera
from rosplat_core.rendering import pose
from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.splats import Splats, check_splats
from rosplat_core.view import SortView, unmoved


def depth_order(splats: Splats, camera: Camera, *, threads: int = 0) -> NDArray[np.uint32]:
    """The splats that a camera may see, back to front, uint32 (m,); of equal depths, later first.

    threads: to sort with, 0 for as many as the machine runs at once. The same as depth.order to the
    bit. Raises CameraError for a camera that float32 can't hold.
    """
    check_splats(splats)
    page = np.arange(-(-len(splats) // SLOTS_PER_PAGE), dtype=np.uint32)
    rows = len(page) * SLOTS_PER_PAGE
    positions = np.zeros((rows, 3), np.float32)
    positions[: len(splats)] = splats.positions
    extents = np.full(rows, INVISIBLE, np.float32)
    extents[: len(splats)] = splat_extents(splats.scales, splats.opacities)
    view = view_of(camera, splats)
    pages = np.stack([page * SLOTS_PER_PAGE, page, np.zeros_like(page)], axis=1)  # see SortMap
    sorter = _core.DepthOrder(threads)
    return sorter.sort(view, positions, extents, pages, lambda count: np.empty(count, np.uint32))


def view_of(camera: Camera, splats: Splats) -> SortView:
    """A sorter's view of a camera that looks at these splats. Raises CameraError as depth_order."""
    return SortView.of(PosedCamera(*pose(camera)), unmoved(splats.origin))
