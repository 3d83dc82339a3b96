"""PyTorch: on an NVIDIA GPU where there is one, else on the CPU."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rosplat_core.slot_pages import SLOTS_PER_PAGE
from rosplat_core.view import SortView
from rosplat_sorter.backends import Allocate, Unavailable, new_array, room_for
from rosplat_sorter.map import Rows, SplatMap

ALL_THREADS = torch.get_num_threads()


class TorchBackend:
    """Keeps the map on the device.

    Eager operations round one by one, as the order's definition asks.
    """

    name = "torch"

    def __init__(self, threads: int = 0, gpu_only: bool = False) -> None:
        gpu = torch.cuda.is_available()
        if gpu_only and not gpu:
            raise Unavailable("torch finds no GPU")
        if not gpu:
            torch.set_num_threads(threads or ALL_THREADS)
        self._device = torch.device("cuda" if gpu else "cpu")
        self.device = torch.cuda.get_device_name() if gpu else "CPU"
        self._reserve(0)
        self._first_slots = torch.empty(0, dtype=torch.int32, device=self._device)
        self._groups = torch.empty(0, dtype=torch.int64, device=self._device)
        self._ascending = True

    def _reserve(self, capacity: int) -> None:
        """Makes room for so many rows; those held so far are lost."""
        self._positions = torch.empty((capacity, 3), device=self._device)
        self._extents = torch.empty(capacity, device=self._device)
        self._count = 0

    @torch.inference_mode()
    def update(self, splats: SplatMap, changed: Rows) -> None:
        count = splats.rows
        room = room_for(count, len(self._extents))
        if room != len(self._extents):
            self._reserve(room)
        first_slots, groups = splats.by_place()
        self._first_slots = self._upload(first_slots.view(np.int32))
        self._groups = self._upload(groups.astype(np.int64))
        self._ascending = bool((np.diff(first_slots.astype(np.int64)) > 0).all())
        for rows in (changed, slice(self._count, count)):  # what changed, what is new
            index = rows if isinstance(rows, slice) else self._upload(rows)
            self._positions[index] = self._upload(splats.positions[rows])
            self._extents[index] = self._upload(splats.extents[rows])
        self._count = count

    def close(self) -> None:
        self._reserve(0)
        self._first_slots, self._groups = self._first_slots[:0].clone(), self._groups[:0].clone()
        if self._device.type == "cuda":
            torch.cuda.empty_cache()

    @torch.inference_mode()
    def order(self, view: SortView, allocate: Allocate = new_array) -> NDArray[np.uint32]:
        positions, extents = self._positions[: self._count], self._extents[: self._count]
        rotations, translations = self._upload(view.rotations), self._upload(view.translations)
        if len(rotations) > 1:
            rotations, translations = rotations[self._groups], translations[self._groups]
        pages = positions.reshape(-1, SLOTS_PER_PAGE, 3)
        x, y, z = (
            _transform(pages, rotations[:, axis, :, None], translations[:, axis, None]).ravel()
            for axis in range(3)
        )
        rows = _visible(view, x, y, z, extents).nonzero()[:, 0]
        slots = self._first_slots[rows // SLOTS_PER_PAGE] + (rows % SLOTS_PER_PAGE).to(torch.int32)
        if not self._ascending:
            slots, places = torch.sort(slots)
            rows = rows[places]
        bits = (z[rows] + 0.0).view(torch.int32)  # the sum turns -0 into 0: they are equal
        keys = bits ^ ((bits >> 31) & 0x7FFFFFFF)  # integers that compare as the depths do
        ascending = torch.sort(keys, stable=True).indices
        result = allocate(len(slots))
        torch.from_numpy(result.view(np.int32)).copy_(slots[ascending].flip(0))
        return result

    def _upload(self, array: NDArray[np.generic]) -> Tensor:
        return torch.from_numpy(array).to(self._device)


def _transform(pages: Tensor, rotation: Tensor, translation: Tensor) -> Tensor:
    """A coordinate (p, n) of positions (p, n, 3), by a row of each page's frame, or of one for all.

    rotation: (p or 1, 3, 1). translation: (p or 1, 1).
    """
    r0, r1, r2 = rotation.unbind(1)
    px, py, pz = pages.unbind(2)
    result: Tensor = ((px * r0 + py * r1) + pz * r2) + translation
    return result


def _visible(view: SortView, x: Tensor, y: Tensor, z: Tensor, extents: Tensor) -> Tensor:
    w = torch.ones_like(z) if view.orthographic else z
    in_depth = (extents >= 0) & (z > float(view.near_clip)) & (z < float(view.far_clip))
    in_width = (x * float(view.fx) + w * float(view.offset_x)).abs() <= (
        w * float(view.half_width) + extents * float(view.slope_x)
    )
    in_height = (y * float(view.fy) + w * float(view.offset_y)).abs() <= (
        w * float(view.half_height) + extents * float(view.slope_y)
    )
    return in_depth & in_width & in_height
